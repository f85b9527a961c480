"""First-order recursions beside scipy's filter, in one piece and in blocks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from stillcal.replay.phone.recursion import decaying


@pytest.mark.parametrize("shape", [(500,), (500, 3), (1,), (1, 3)])
def test_a_recursion_is_that_of_a_filter(shape: tuple[int, ...]) -> None:
    driven = np.random.default_rng(0).normal(size=shape)
    given = driven.copy()
    np.testing.assert_allclose(
        decaying(driven, 0.97), lfilter([1.0], [1.0, -0.97], driven, axis=0), atol=1e-13
    )
    np.testing.assert_array_equal(driven, given)


def test_blocks_give_the_bits_of_the_whole() -> None:
    driven = np.random.default_rng(1).normal(size=(400, 3))
    whole = decaying(driven, 0.9, np.ones(3))
    first = decaying(driven[:150], 0.9, np.ones(3))
    np.testing.assert_array_equal(np.vstack([first, decaying(driven[150:], 0.9, first[-1])]), whole)
