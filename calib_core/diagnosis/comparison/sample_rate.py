"""The rate of a sensor as its stamps tell it."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.quantity import TIMES, Part, Quantity
from stillcal.calib_core.diagnosis.model.measurement import mean_of
from stillcal.calib_core.diagnosis.model.records import Where
from stillcal.calib_core.diagnosis.segments.sample_period import bunched, intervals, sample_period
from stillcal.calib_core.diagnosis.stamps.timestamps import Grid
from stillcal.calib_core.streams.samples import Samples

ALIKE_RATE = 2e-3
"""Relative difference of sample rates that two recordings of one phone may have: nominal rates are round."""

PIECES = 40
LEAST_RATE_ERROR = 1e-6


def rate(samples: Samples) -> Quantity:
    """Return the logarithm of the sensor's rate.

    Samples that are missing count, for they were measured; stamps in bursts are counted over time.
    """
    if bunched(samples.t):
        pieces = [p.mean() for p in np.array_split(intervals(samples.t), PIECES) if p.size and p.any()]
        mean = mean_of(-np.log(pieces), LEAST_RATE_ERROR)
    else:
        grid = Grid.of(samples.t, sample_period(samples.t))
        mean = grid.mean_rate(min(PIECES, len(samples) - 1), LEAST_RATE_ERROR)[0]
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
