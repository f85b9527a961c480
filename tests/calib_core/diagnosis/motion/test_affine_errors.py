"""What an error of scale or misalignment does to gravity that is turned back."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.motion.affine_errors import affine_columns

T = np.arange(0.0, 1.0, 0.01)
RATE = np.column_stack([0.8 * np.cos(3 * T), 0.5 * np.sin(2 * T), 0.6 + 0.0 * T])
UP = np.array([2.0, -3.0, 9.1])


def turned_back(rate: Array) -> Array:
    """Return the rotations (n, 3, 3) from the body at T to the body at the beginning."""
    steps = Rotation.from_rotvec(0.5 * (rate[1:] + rate[:-1]) * 0.01)
    back = [Rotation.identity()]
    for step in steps:
        back.append(back[-1] * step)
    return np.array([rotation.as_matrix() for rotation in back])


def test_an_error_of_the_rate_turns_gravity_as_the_wrong_rate_does() -> None:
    back = turned_back(RATE)
    raw = np.einsum("nji,j->ni", back, UP)
    columns = affine_columns(T, back, RATE, raw, np.zeros(9))
    for k in range(9):
        error = np.zeros(9)
        error[k] = 1e-3
        wrong = turned_back(RATE + RATE @ error.reshape(3, 3).T)
        moved = np.einsum("nij,nj->ni", wrong, raw) - UP
        assert np.abs(columns[:, :, 9:] @ error - moved).max() < 0.02 * np.abs(moved).max()
