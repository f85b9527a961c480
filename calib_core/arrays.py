"""The array type of the core, and how arrays in records are protected from being written to."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def frozen(values: ArrayLike) -> Array:
    """Return `values` as a read-only float64 array; one that is float64 already is not copied."""
    array = np.asarray(values, dtype=np.float64).view()
    array.setflags(write=False)
    return array
