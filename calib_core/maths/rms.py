"""The root of the mean square."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def rms(values: ArrayLike) -> float:
    """Return the root of the mean square, 0 of nothing."""
    squares = np.square(np.asarray(values, dtype=np.float64))
    return float(np.sqrt(np.mean(squares))) if squares.size else 0.0
