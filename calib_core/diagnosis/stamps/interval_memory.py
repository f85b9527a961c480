"""Intervals that are alike for a while: stamps are wrong together, though neighbours look even.

A driver that stamps a batch when it comes and spreads its samples evenly makes such stamps. Stamps that are
each off by themselves scatter about an even grid by the same over any time; those whose intervals are each
off by themselves by the root of the time. What grows faster has intervals that remember one another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import of_spread
from stillcal.calib_core.diagnosis.model.measurement import Measured, direct_finding, of_measured
from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.diagnosis.stamps.rate_changes import stretches
from stillcal.calib_core.diagnosis.stamps.timestamps import LONGEST_GAP, Grid

DRIVER = "neighbouring intervals"

LONGEST = 256
"""Samples apart, at most: ten times a phone's usual batch; what is slower is the clock."""

LEAST = 30
"""Independent differences that a scatter is known from, at least: to an eighth."""

NO_GROWTH = 1.0
"""Growth that single stamps, or single intervals, have by themselves, on the scale of populations."""

EVEN = 0.01
"""Periods: less scatter from stamp to stamp than this is none, so that a clock's own steps are no memory."""


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """How much faster than by the root of the time the scatter of stamps grows.

    apart: samples over which it grows most. sigma: scatter of one stamp about an even grid over that time,
    periods. least: the same from stamp to stamp. off: (k,) independent differences, in units of sigma's.
    """

    apart: int
    sigma: float
    least: float
    off: Array

    @classmethod
    def of(cls, grid: Grid) -> Memory | None:
        """Measure it; None where the rate is set anew, or there are too few stamps."""
        if stretches(grid.t):
            return None
        parts = _unbroken(grid)
        least = max(_scatter(_bends(parts, 1)), EVEN)
        best: Memory | None = None
        apart = 2
        while apart <= LONGEST:
            bends = _bends(parts, apart)
            if bends.size < 2 * LEAST * apart:
                break
            sigma = _scatter(bends)
            one = cls(apart, sigma, least, bends[:: 2 * apart] / np.sqrt(6.0))
            best = one if best is None or one.growth > best.growth else best
            apart *= 2
        return best

    @property
    def growth(self) -> float:
        """The scatter over what the root of the time makes of that from stamp to stamp."""
        return self.sigma / (self.least * float(np.sqrt(self.apart)))

    def size(self) -> Measured:
        """Return log10 of (1 + growth): a scatter from n values is known to one part in sqrt(2 n)."""
        return Measured(self.growth, self.growth / np.sqrt(2.0 * self.off.size)).log(NO_GROWTH)


def _unbroken(grid: Grid) -> list[Array]:
    """Return stamps less the even grid's, periods, between pauses; samples that are lost are no pause."""
    place = np.concatenate([[0.0], np.cumsum(grid.multiples)])
    pauses = np.flatnonzero(grid.multiples > LONGEST_GAP) + 1
    return np.split(grid.t / grid.period - place, pauses)


def _bends(parts: list[Array], apart: int) -> Array:
    """Return second differences of stamps so many samples apart: none of an even grid at any rate."""
    made = [p[2 * apart :] - 2.0 * p[apart:-apart] + p[: -2 * apart] for p in parts if p.size > 2 * apart]
    return np.concatenate(made) if made else np.zeros(0)


def _scatter(bends: Array) -> float:
    """Return the standard deviation of one stamp: that of a second difference is sqrt(6) times as large."""
    return float(np.sqrt((bends**2).mean() / 6.0)) if bends.size else 0.0


def interval_memory(grid: Grid, usual: Usual, where: Where) -> Finding | None:
    """Find intervals that are alike for a while. usual: of log10 of (1 + growth) of their scatter."""
    memory = Memory.of(grid)
    if memory is None:
        return None
    sound = memory.least * np.sqrt(memory.apart) * (10.0**usual.highest - NO_GROWTH)
    seen = of_measured(memory.size(), usual, of_spread(memory.off, sound))
    error = memory.sigma / np.sqrt(2.0 * memory.off.size)
    sigma = Measured(memory.sigma * grid.period, error * grid.period)
    span = memory.apart * grid.period
    say = (
        f"Time stamps are wrong together, by {sigma.value * 1e3:.3g} ms over {span:.2g} s: neighbouring"
        f" intervals are alike, as where a driver spreads the samples of a batch evenly."
    )
    there = Where(where.t_start, where.t_end, (0.0, 0.5 / span), DRIVER)
    return direct_finding(
        "unknown", "timing", [], there, {"sigma": sigma.parameter("s")}, statement=say, seen=seen
    )
