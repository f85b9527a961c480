"""Timing side by side: every round runs each case once, so that what disturbs one disturbs all.

Times are of the processor, which other programs on the machine disturb less than the clock's; ratios are
taken within a round. What is reported, of times as of ratios, is median and middle half of the rounds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

Spread = tuple[float, float, float]
"""Median, lower and upper quartile."""


@dataclass(frozen=True, slots=True)
class Timed:
    """Processor seconds of one case, by round; answer: what its last call returned."""

    seconds: np.ndarray
    answer: Any

    @property
    def median(self) -> float:
        """The usual."""
        return float(np.median(self.seconds))

    def spread(self, factor: float) -> Spread:
        """Return the seconds times `factor`, as in nanoseconds a sample."""
        return middle(self.seconds * factor)

    def rate(self, count: float) -> Spread:
        """Return how many of `count` things are done a second."""
        return middle(count / self.seconds)


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table. value, unit: ours; ratio: of the peer's time to ours, median (middle half).

    goal: in words; met: whether it is, None where there is none to meet. accuracy: in words, beside speed.
    margin: by how many times the goal's figure is bettered, below 1 where it is missed.
    """

    item: str
    what: str
    value: float | Spread
    unit: str
    peer: str = ""
    ratio: Spread | None = None
    goal: str = ""
    met: bool | None = None
    accuracy: str = ""
    margin: float | None = None
    more: dict[str, Any] = field(default_factory=dict)

    def at_most(self, most: float, value: float) -> Row:
        """Return it with the goal that a value of its unit, its own or its median, is at most so large."""
        margin = most / value if value else None
        return replace(self, goal=f"{most:g} {self.unit}", met=value <= most, margin=margin)


def rounds(cases: Mapping[str, Callable[[], Any]], count: int, calls: int = 1) -> dict[str, Timed]:
    """Run every case `calls` times a round, after one round that is not counted."""
    taken: dict[str, list[float]] = {name: [] for name in cases}
    answers: dict[str, Any] = {}
    for number in range(count + 1):
        for name, case in cases.items():
            began = time.process_time()
            for _ in range(calls):
                answers[name] = case()
            if number:
                taken[name].append((time.process_time() - began) / calls)
    return {name: Timed(np.array(own), answers[name]) for name, own in taken.items()}


def middle(values: np.ndarray) -> Spread:
    """Return median, lower and upper quartile."""
    low, median, high = np.quantile(values, (0.25, 0.5, 0.75))
    return float(median), float(low), float(high)


def ratio(ours: Timed, peer: Timed) -> Spread:
    """Return by how many times the peer takes longer."""
    return middle(peer.seconds / ours.seconds)
