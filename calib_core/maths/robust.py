"""Robust scale and moving means."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array

MAD_TO_SD = 1.4826
"""Standard deviation over median absolute deviation, for a normal distribution."""

NEARLY_ALL = np.array([0.01, 0.99])
"""Parts of a total that lie before the first and the last place of its bulk."""


def bulk(amounts: Array) -> tuple[int, int]:
    """Return the first and the last place (both included) of those that hold all but 2 % of amounts (n,).

    None is negative, and one at least is positive.
    """
    total = np.cumsum(amounts) / amounts.sum()
    first, last = np.searchsorted(total, NEARLY_ALL)
    return int(first), int(min(last, amounts.size - 1))


def means(values: Array, low: NDArray[np.int64], high: NDArray[np.int64]) -> Array:
    """Return the moving means (m, k) of values (n, k) over rows [low, high), (m,) each; none may be empty."""
    middle = values.mean(axis=0)
    total = np.vstack([np.zeros(values.shape[1]), np.cumsum(values - middle, axis=0)])
    return np.asarray(middle + (total[high] - total[low]) / (high - low)[:, None])
