"""The array type of the core, and what is done with arrays as such: protected, and looked at only once."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Answer = TypeVar("Answer")


def frozen(values: ArrayLike) -> Array:
    """Return `values` as a read-only float64 array; one that is float64 already is not copied."""
    array = np.asarray(values, dtype=np.float64).view()
    array.setflags(write=False)
    return array


def once_per_array(function: Callable[[Array], Answer]) -> Callable[[Array], Answer]:
    """Keep what `function` returns of a read-only array as long as that array lives; decorates it.

    What stamps say of a rate is asked in many places, and each time of the same few arrays.

    >>> calls = []
    >>> @once_per_array
    ... def total(values):
    ...     calls.append(values.size)
    ...     return float(values.sum())
    >>> values = frozen([1.0, 2.0])
    >>> total(values), total(values), len(calls)
    (3.0, 3.0, 1)
    """
    kept: dict[int, tuple[weakref.ref[Array], Answer]] = {}

    @wraps(function)
    def asked(values: Array) -> Answer:
        if values.flags.writeable:
            return function(values)
        key = id(values)
        known = kept.get(key)
        if known is not None and known[0]() is values:
            return known[1]
        answer = function(values)
        kept[key] = weakref.ref(values, lambda gone: _forget(kept, key, gone)), answer
        return answer

    return asked


def _forget(kept: dict[int, tuple[weakref.ref[Array], Answer]], key: int, gone: weakref.ref[Array]) -> None:
    """Drop what is kept of an array that is no more, unless another one has its key already."""
    if key in kept and kept[key][0] is gone:
        del kept[key]
