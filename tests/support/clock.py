"""A clock that a test sets, in place of the host's."""

from __future__ import annotations


class ManualClock:
    """Returns `now`, s, until the test changes it."""

    def __init__(self, now: float = 1000.0) -> None:
        self.now = now

    def __call__(self) -> float:
        return self.now
