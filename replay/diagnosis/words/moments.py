"""Stamps in words: seconds, or date and time of day where they are counted since 1970."""

from __future__ import annotations

import re
from datetime import UTC, datetime

from stillcal.replay.formats.clock import unit_since_1970

_SPAN = re.compile(r"\b([Ff])rom (-?\d+) to (-?\d+) s\b")


def moment(t: float) -> str:
    """Return a stamp, s."""
    return f"{_dated(t):%Y-%m-%d %H:%M:%S} UTC" if _is_dated(t) else f"{t:z.0f} s"


def span(start: float, end: float) -> str:
    """Return from which to which stamp, s."""
    if not (_is_dated(start) and _is_dated(end)):
        return f"from {start:z.0f} to {end:z.0f} s"
    day, clock = "%Y-%m-%d %H:%M:%S", "%H:%M:%S"
    first, last = _dated(start), _dated(end)
    until = last.strftime(clock if first.date() == last.date() else day)
    return f"from {first.strftime(day)} to {until} UTC"


def with_moments(text: str) -> str:
    """Return sentences in which the spans of stamps, `from 10 to 20 s`, are said as `span` says them."""
    return _SPAN.sub(lambda m: m[1] + span(float(m[2]), float(m[3]))[1:], text)


def _is_dated(t: float) -> bool:
    return unit_since_1970(t) == 1.0


def _dated(t: float) -> datetime:
    return datetime.fromtimestamp(round(t), UTC)
