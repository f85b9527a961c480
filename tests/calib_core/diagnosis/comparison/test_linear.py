"""Constants and slow effects that are measured together, in a recording in which nothing is searched for."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.linear import Wanted, linear_quantities
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.effects.temperature import BiasTemperature
from stillcal.calib_core.streams.samples import Samples, Sensor
from tests.support.diagnosis import nulls

SLOPE = np.array([5e-3, -3e-3, 4e-3])


def in_a_chamber(seed: int) -> Samples:
    """Return two hours at 1 Hz in a chamber that warms by 90 K: 12 rests near the faces of the phone."""
    rng = np.random.default_rng(seed)
    t = np.arange(7200.0)
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    tilted = faces[rng.permutation(12) % 6] + rng.normal(0.0, 0.05, (12, 3))
    up = (tilted / np.linalg.norm(tilted, axis=1, keepdims=True))[(t // 600).astype(int)]
    warm = np.interp(t, [0.0, 3600.0, 7200.0], [-20.0, 70.0, 25.0])
    force = nulls.G * up + np.outer(warm - 25.0, SLOPE) + rng.normal(0.0, 2e-3, (t.size, 3))
    return Samples.checked(Sensor.ACCELEROMETER, t, frozen(force), frozen(warm))


@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.slow), 2])
def test_a_large_effect_that_is_not_searched_for_leaves_the_constants_as_they_are(seed: int) -> None:
    """Linear about a bias that changes by 0.45 m/s^2, slopes were off by a half, angles by 0.01 rad."""
    exam = examine(in_a_chamber(seed), None, sought=())
    (own,) = exam.sensors
    effect = BiasTemperature("accel", 1)
    wanted = [Wanted("accel", own.hypothesis(effect, {}), {})]
    found = linear_quantities(exam, wanted, {"accel": 25.0})
    np.testing.assert_allclose(found[effect.name, "accel"].value, SLOPE, rtol=0.02)
    np.testing.assert_allclose(found["accel_scale", "accel"].value[3:], 0.0, atol=1e-3)
