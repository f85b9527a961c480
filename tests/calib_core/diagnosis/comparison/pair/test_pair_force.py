"""A nonlinearity of the accelerometer, in bins within which the force changes."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.pair.alignment import Readings
from stillcal.calib_core.diagnosis.comparison.pair.motion import left_in_motion
from stillcal.calib_core.diagnosis.comparison.pair.pair_residuals import pair_residuals
from stillcal.calib_core.diagnosis.effects.by_force import ForceNonlinearity
from stillcal.replay.diagnosis.pair.readings import less
from tests.support.diagnosis.turned_pairs import turned

QUADRATIC, CUBIC = 2e-3, 2e-4
"""Some per cent of the force at 1 g."""


@pytest.mark.parametrize(("quadratic", "cubic"), [(QUADRATIC, 0.0), (0.0, CUBIC)])
def test_powers_of_the_force_leave_nothing_in_motion(quadratic: float, cubic: float) -> None:
    """The mean of a square over a turn is not the square of the mean."""

    def bent(force: Array, rate: Array) -> tuple[Array, Array]:
        return force + quadratic * force**2 + cubic * force**3, rate

    real, sim = turned(1, bent), turned(2)
    true = Readings(sim.accelerometer, sim.gyroscope)
    _, (residuals, _) = pair_residuals(less(real, true), true, [], 0.0)
    found = residuals.hypothesis(ForceNonlinearity(3 if cubic else 2), {})
    left = left_in_motion(residuals, [found])
    assert left is not None and left.finding(residuals) is None
    assert (np.sqrt(left.variance) < 2e-3).all()
