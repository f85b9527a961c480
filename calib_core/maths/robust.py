"""Robust scale and moving means."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array

MAD_TO_SD = 1.4826
"""Standard deviation over median absolute deviation, for a normal distribution."""


def means(values: Array, low: NDArray[np.int64], high: NDArray[np.int64]) -> Array:
    """Return the moving means (m, k) of values (n, k) over rows [low, high), (m,) each; none may be empty."""
    middle = values.mean(axis=0)
    total = np.vstack([np.zeros(values.shape[1]), np.cumsum(values - middle, axis=0)])
    return np.asarray(middle + (total[high] - total[low]) / (high - low)[:, None])
