"""Stamps in words: seconds, or date and time of day where they are counted since 1970."""

from __future__ import annotations

from datetime import UTC, datetime

from stillcal.replay.formats.clock import unit_since_1970


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


def _is_dated(t: float) -> bool:
    return unit_since_1970(t) == 1.0


def _dated(t: float) -> datetime:
    return datetime.fromtimestamp(round(t), UTC)
