"""Coning against motion in closed form, Eq. 26 against differentiated rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillcal.replay.studies.methods.coning import coning_errors, rotation_vector_rate


@pytest.mark.parametrize("size", [1e-4, 0.02, 1.0, 2.8])
def test_eq_26_is_the_derivative_of_the_rotation_vector(size: float) -> None:
    rng = np.random.default_rng(1)
    p, rate, h = size * np.array([0.6, -0.64, 0.48]), rng.standard_normal(3), 1e-6
    turned = [(Rotation.from_rotvec(p) * Rotation.from_rotvec(s * h * rate)).as_rotvec() for s in (-1, 1)]
    assert rotation_vector_rate(p, rate) == pytest.approx(
        (turned[1] - turned[0]) / (2 * h), rel=1e-6, abs=1e-7
    )


def test_rotation_about_one_axis_has_no_coning() -> None:
    t = np.arange(0.0, 20.0, 0.05)
    rates = (1.0 + np.sin(3.0 * t))[:, None] * np.array([0.3, -0.5, 0.8])
    assert coning_errors(t, rates).max() < 1e-6
    constant = np.tile([0.02, -0.01, 0.03], (t.size, 1))
    assert coning_errors(t, constant).max() < 1e-9


def test_classical_coning_drifts_as_bortz_has_it() -> None:
    # body rates of a cone: constant rotation vector of size a, its direction turning at w
    a, w = 0.05, 2 * np.pi * 2.0
    t = np.arange(0.0, 10.0 + 1e-9, 1e-3)
    cone = Rotation.from_rotvec(a * np.column_stack((np.cos(w * t), np.sin(w * t), 0.0 * t)))
    rates = (cone[:-1].inv() * cone[1:]).as_rotvec() / 1e-3
    middle = 0.5 * (t[1:] + t[:-1])
    # over whole periods the cone comes back, while the mean rate claims a drift of w (1 - cos a) about z
    expected = w * (1.0 - np.cos(a))
    assert coning_errors(middle, rates) == pytest.approx(expected, rel=0.01)


def test_a_stretch_shorter_than_the_span_is_refused() -> None:
    with pytest.raises(ValueError, match="coning needs 1"):
        coning_errors(np.arange(0.0, 0.5, 0.05), np.zeros((10, 3)))
