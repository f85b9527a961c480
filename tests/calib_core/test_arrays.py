"""What is kept of an array is of its values as they are, and no longer than it lives."""

from __future__ import annotations

import gc
import weakref

import numpy as np

from stillcal.calib_core.arrays import Array, frozen, once_per_array


@once_per_array
def doubled(values: Array) -> Array:
    return 2.0 * values


def test_an_array_that_may_be_written_is_looked_at_each_time() -> None:
    values = np.ones(2)
    assert doubled(values).tolist() == [2.0, 2.0]
    values[0] = 5.0
    assert doubled(values).tolist() == [10.0, 2.0]


def test_an_answer_goes_with_its_array() -> None:
    values = frozen([1.0, 2.0])
    answer = weakref.ref(doubled(values))
    assert answer() is doubled(values)
    del values
    gc.collect()
    assert answer() is None
    assert all(doubled(frozen([float(k)]))[0] == 2.0 * k for k in range(100))
