"""The 6, 9 and 12 parameters of an accelerometer, as linear maps onto (bias, scale).

Every model here is calibrated = scale @ (raw - bias) (Grammenos et al. 2018, Eq. 2); they differ in what
they let `scale` be, and each choice is a linear subspace of its nine entries. The Jacobian of all twelve
parameters times `basis` therefore serves every model. Forces are in units of gravity, so that bias and scale
are of one size.
"""

from __future__ import annotations

from functools import cache
from typing import Literal

import numpy as np

from stillcal.calib_core.arrays import Array, frozen

Form = Literal["symmetric", "triangular"]
AXES = "xyz"
BIAS = tuple(f"b_{i}" for i in AXES)
SCALE = tuple(f"S_{i}{j}" for i in AXES for j in AXES)
DIAGONAL = ("S_xx", "S_yy", "S_zz")
LOWER = {"S_xy": "S_yx", "S_xz": "S_zx", "S_yz": "S_zy"}
"""Each entry above the diagonal and its mirror image below."""

ALL = len(BIAS + SCALE)
"""Parameters of a calibration that holds a rotation common to all axes."""


def names(parameters: int, form: Form = "symmetric") -> tuple[str, ...]:
    """Name the parameters in order, as in the paper's v and v' (4.2.1): bias first.

    6: bias and the scale's diagonal. 9: also the cross-axis entries, shared by both sides of the diagonal
    (symmetric) or on the lower side only (triangular: x keeps its direction and y its plane with x, as in
    ESGI'95 Eq. 12). 12: the whole scale. Raises ValueError for any other number.
    """
    if parameters == 6:
        return BIAS + DIAGONAL
    if parameters == 9:
        return BIAS + DIAGONAL + tuple(LOWER if form == "symmetric" else LOWER.values())
    if parameters == 12:
        return BIAS + SCALE
    raise ValueError(f"parameters is {parameters}: expected 6, 9 or 12")


@cache
def basis(parameters: int, form: Form = "symmetric") -> Array:
    """Return the (12, parameters) matrix that turns parameters into (bias 3, scale 9 row by row)."""
    rows = {name: k for k, name in enumerate(BIAS + SCALE)}
    columns = names(parameters, form)
    matrix = np.zeros((12, len(columns)))
    for k, name in enumerate(columns):
        matrix[rows[name], k] = 1.0
        if parameters == 9 and form == "symmetric" and name in LOWER:
            matrix[rows[LOWER[name]], k] = 1.0
    return frozen(matrix)


@cache
def inverse(parameters: int, form: Form = "symmetric") -> Array:
    """Return the (parameters, 12) matrix that turns (bias, scale) back into parameters, by least squares."""
    matrix = basis(parameters, form)
    return frozen((matrix / (matrix**2).sum(axis=0)).T)  # the columns are orthogonal


def variances_along(rows: Array, covariance: Array) -> Array:
    """Return the variance of each linear combination of the parameters, (n,); rows: (n, p) its factors."""
    return np.asarray(np.einsum("ij,ij->i", rows @ covariance, rows))


def norm_rows(directions: Array, matrix: Array) -> Array:
    """Return the derivative of a calibrated force's norm along unit directions (n, 3) by parameters, (n, p).

    It is the Jacobian of Eq. 4 over 2 g at bias 0 and scale 1, bias in units of gravity: (-u, u u^T).
    """
    products = directions[:, :, None] * directions[:, None, :]
    return np.hstack((-directions, products.reshape(-1, 9))) @ matrix
