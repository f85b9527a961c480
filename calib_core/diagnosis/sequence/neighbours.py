"""A sample against the four about it: what a cubic through these leaves of it.

At rest it is the sensor's noise, in motion what is quicker than a cubic through five samples too.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array

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
