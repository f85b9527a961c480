"""A sample against the four about it: what a cubic through these leaves of it.

At rest it is the sensor's noise, in motion what is quicker than a cubic through five samples too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.noise.heavy_tails import FAR, OUTLIER
from stillcal.calib_core.diagnosis.segments.value_grid import comb_step
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
    return np.asarray(np.maximum(1.4826 * np.median(np.abs(left), axis=0), LEAST_SPREAD))


def without_outliers(samples: Samples) -> Samples:
    """Return samples in which single values far from four neighbours that agree have these' median.

    Where many repeat at a steady time, their overtones would be lines in a spectrum.
    """
    n = len(samples) - 2 * REACH
    if n < 1:
        return samples
    step = np.array([comb_step(column) or 0.0 for column in samples.xyz.T])
    noise = np.hypot(spread(residual(samples.xyz)), step)
    near = np.stack([samples.xyz[i : i + n] for i in range(2 * REACH + 1) if i != REACH])
    middle = np.median(near, axis=0)
    agree = np.ptp(near, axis=0) < 2.0 * FAR * noise
    alone = agree & (np.abs(samples.xyz[REACH:-REACH] - middle) > OUTLIER * noise)
    if not alone.any():
        return samples
    xyz = samples.xyz.copy()
    xyz[REACH:-REACH] = np.where(alone, middle, xyz[REACH:-REACH])
    return replace(samples, xyz=frozen(xyz))
