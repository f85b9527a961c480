"""A sample against the four about it: what a cubic through these leaves of it.

At rest it is the sensor's noise, in motion what is quicker than a cubic through five samples too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.noise.heavy_tails import FAR, OUTLIER
from stillcal.calib_core.diagnosis.segments.value_grid import comb_step
from stillcal.calib_core.maths.robust import MAD_TO_SD
from stillcal.calib_core.streams.samples import Samples

WEIGHTS = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6.0
"""What a sample and two on either side count: the fourth difference, a sixth of it."""

REACH = 2
"""Samples on either side that a cubic takes."""

LEAST_SPREAD = 1e-12
"""m/s^2 or rad/s, below what any value is given in: an axis that does not move."""


def residual(values: Array) -> Array:
    """Return what neighbours leave of values (n, k): (n - 4, k), the first of the third sample."""
    n = len(values) - 2 * REACH
    return np.asarray(sum(w * values[i : i + n] for i, w in enumerate(WEIGHTS)), dtype=np.float64)


def spread(left: Array) -> Array:
    """Return the robust spread (k,) of residuals (n, k), more than nothing."""
    return np.asarray(np.maximum(MAD_TO_SD * np.median(np.abs(left), axis=0), LEAST_SPREAD))


def without_outliers(samples: Samples) -> Samples:
    """Return samples in which single values far from four neighbours that agree have these' median.

    Where many repeat at a steady time, their overtones would be lines in a spectrum.
    """
    n = len(samples) - 2 * REACH
    if n < 1:
        return samples
    step = np.array([comb_step(column) or 0.0 for column in samples.xyz.T])
    noise = np.hypot(spread(residual(samples.xyz)), step)
    xyz = None
    for axis, values in enumerate(samples.xyz.T):
        middle, apart = _of_four(*(values[i : i + n] for i in range(2 * REACH + 1) if i != REACH))
        own = values[REACH:-REACH]
        alone = (apart < 2.0 * FAR * noise[axis]) & (np.abs(own - middle) > OUTLIER * noise[axis])
        if alone.any():
            xyz = samples.xyz.copy() if xyz is None else xyz
            xyz[REACH:-REACH, axis] = np.where(alone, middle, own)
    return samples if xyz is None else replace(samples, xyz=frozen(xyz))


def _of_four(a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array]:
    """Return the median (n,) of four values each, and how far apart the least and the largest are."""
    low, high = np.minimum(a, b), np.maximum(a, b)
    other_low, other_high = np.minimum(c, d), np.maximum(c, d)
    middle = (np.maximum(low, other_low) + np.minimum(high, other_high)) / 2.0
    return middle, np.maximum(high, other_high) - np.minimum(low, other_low)
