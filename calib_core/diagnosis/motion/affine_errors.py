"""What is not known of both sensors' bias, scale and misalignment, as it shows where a phone turns.

All windows share it. Where a phone makes the same few moves again and again it looks the same in each of
them, and like an arm or a delay: leaving windows out does not show how unsure those are.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.residuals import affine
from stillcal.calib_core.maths.integral import running


def affine_columns(t: Array, back: Array, rate: Array, raw: Array, parameters: Array) -> Array:
    """Return what errors of the affine parameters do to specific force turned back, (n, 3, 18) m/s^2.

    t: (n,) s; back: (n, 3, 3), turns the body to where it was when the window began; rate: (n, 3), corrected;
    raw: (n, 3) specific force as read; parameters: (9,) of the accelerometer. First come these nine, then the
    error of the rate, row by row, which turns gravity by its integral.
    """
    _, force, moved = affine(raw, parameters)
    still = np.einsum("nij,nj->ni", back, force).mean(axis=0)
    turned = np.einsum("nij,nk->nijk", back, rate).reshape(len(t), 3, 9)
    tilt = running(t, turned)
    return np.concatenate([back @ moved, np.cross(tilt, still[None, :, None], axis=1)], axis=2)
