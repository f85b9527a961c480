"""Means of rows over neighbourhoods that slide along."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array


def means(values: Array, low: NDArray[np.int64], high: NDArray[np.int64]) -> Array:
    """Return the means (m, k) of values (n, k) over rows [low, high) (m,), none of them empty."""
    middle = values.mean(axis=0)
    total = np.vstack([np.zeros(values.shape[1]), np.cumsum(values - middle, axis=0)])
    return np.asarray(middle + (total[high] - total[low]) / (high - low)[:, None])
