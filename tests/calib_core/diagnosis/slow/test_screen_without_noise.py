"""A recording without any noise, as a faultless simulator makes it, is screened like another."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.slow.screen import _least_squares


@pytest.mark.parametrize("power", [1.0, 1e30])
def test_columns_that_depend_on_each_other_are_fitted_at_any_noise(power: float) -> None:
    # Three equal columns of squared length `power`.
    gram, target = power * np.ones((1, 3, 3)), power * np.ones((1, 3))
    expected = 1.5 * power**2 / (3.0 * power + 1.0)  # Woodbury: t' (I + x x')^-1 t / 2
    np.testing.assert_allclose(_least_squares(gram, target), [expected], rtol=1e-3)
