"""One line of a table of scores: a figure, its bounds, and what is required of it."""

from __future__ import annotations

from dataclasses import dataclass

from stillcal.replay.blind_test.confidence_bounds import Mean, Rate


@dataclass(frozen=True, slots=True)
class Line:
    """One score.

    low, high: 95 % bounds. n: cases. bar: the required value, '' for none. holds: whether it is reached, None
    without a bar, False where nothing was tested.
    """

    what: str
    value: float | None
    low: float | None
    high: float | None
    n: int
    bar: str = ""
    holds: bool | None = None


def at_most(what: str, share: Rate, bar: float) -> Line:
    """Return a rate that must not be above a bar."""
    holds = share.value is not None and share.value <= bar
    return Line(what, share.value, share.low, share.high, share.n, f"<= {bar:.0%}", holds)


def at_least(what: str, share: Rate | Mean, bar: float) -> Line:
    """Return a rate or mean that must not be below a bar."""
    holds = share.value is not None and share.value >= bar
    return Line(what, share.value, share.low, share.high, share.n, f">= {bar:.0%}", holds)


def without_bar(what: str, share: Rate | Mean) -> Line:
    """Return a rate or mean of which nothing is required."""
    return Line(what, share.value, share.low, share.high, share.n)
