"""The rate of a sensor as its stamps tell it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.quantity import TIMES, Part, Quantity
from stillcal.calib_core.diagnosis.model.measurement import mean_in_time
from stillcal.calib_core.diagnosis.model.records import Where
from stillcal.calib_core.diagnosis.segments.sample_period import bunched, intervals, sample_period
from stillcal.calib_core.diagnosis.stamps.timestamps import Grid
from stillcal.calib_core.streams.samples import Samples

ALIKE_RATE = 2e-3
"""Relative difference of sample rates that two recordings of one phone may have: nominal rates are round."""

PIECES = 40
LEAST_RATE_ERROR = 1e-6


def of_both(samples: Sequence[Samples]) -> list[Quantity]:
    """Return the rates of two recordings, counted alike in both.

    Samples that are missing count, for they were measured, unless one of the two does not tell how many are,
    as stamps in bursts do not.
    """
    told = all(grid is not None and grid.told for grid in map(_grid, samples))
    return [rate(one, missing=told) for one in samples]


def _grid(samples: Samples) -> Grid | None:
    """Return the grid of stamps; None of those in bursts."""
    return None if bunched(samples.t) else Grid.of(samples.t, sample_period(samples.t))


def rate(samples: Samples, *, missing: bool = True) -> Quantity:
    """Return the logarithm of the sensor's rate; stamps in bursts are counted over time.

    missing: whether samples that are missing count where stamps tell how many are.
    """
    grid = _grid(samples)
    if grid is None:
        pieces = [p.mean() for p in np.array_split(intervals(samples.t), PIECES) if p.size and p.any()]
        mean = mean_in_time(-np.log(pieces), LEAST_RATE_ERROR)
    else:
        grid = grid if missing else replace(grid, multiples=np.ones_like(grid.multiples))
        mean = grid.mean_rate(min(PIECES, len(samples) - 1), LEAST_RATE_ERROR, mean_in_time)[0]
    return Quantity(
        "sample_rate",
        "timing",
        (Part("rate", "Hz", 1),),
        np.array([mean.value]),
        np.array([[mean.error**2]]),
        np.array([TIMES]),
        np.array([ALIKE_RATE]),
        np.array([-1]),
        logarithmic=True,
        where=Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.0), "time stamps"),
    )


def exactly_even(t: Array) -> bool:
    """Whether stamps t (n,) are multiples of one interval to rounding: computed, not taken from a clock."""
    steps = np.diff(t)
    return bool(np.ptp(steps) < 1e-9 * max(float(np.abs(t).max()), 1.0))
