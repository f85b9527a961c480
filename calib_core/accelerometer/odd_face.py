"""Which of six laid faces does not agree with the other five: it was laid on something, or is not flat.

A face's direction is predicted from the other five, the norms of all rests, and the cross-axis sensitivity
of sound phones: without the latter a tilted face could not be told from the one opposite. The prediction is
compared with the face by the tilts that the other five show themselves (an F test of a single outlier).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.accelerometer.prior import CROSS_AXIS_SD
from stillcal.calib_core.arrays import Array

CHANCE = 0.01
"""Chance that any of six faces laid alike is called odd: a person lays one again in vain."""

FINEST_TILT = 2e-3
"""rad, 0.1 degrees: no case is square, and nobody lays it flat, to less; so five faces that happen to agree
better than that do not make the sixth odd."""

_ROUNDS = 10
_SHEARS = ((0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, slots=True)
class OddFace:
    """A face, by its number in FACE_DIRECTIONS, and how far it is off what the other five show, rad."""

    face: int
    tilt: float


def odd_faces(
    scale: Array, norms: tuple[Array, Array], tilts: tuple[Array, Array], least: float
) -> list[OddFace]:
    """Return the faces that do not agree with the other five, at a fit of all of them.

    scale: (3, 3) of the fit. norms: slopes (n, 12) and values (n,) of the norms, over their standard
    deviations. tilts: slopes (12, 12) and values (12,) rad of the faces' tilts, two for each face. least:
    rad, a tilt up to which a face agrees whatever the others are. Parameters are bias, then scale row by row.
    """
    shears = _shears(scale)
    fixed = np.vstack((norms[0], shears[0])), np.r_[norms[1], shears[1]]
    found = []
    for face in range(6):
        own = np.arange(12) // 2 == face
        off, chance = _predicted(fixed, tilts, own)
        if off > least and chance < CHANCE / 6:
            found.append(OddFace(face, off))
    return found


def _predicted(
    fixed: tuple[Array, Array], tilts: tuple[Array, Array], own: NDArray[np.bool_]
) -> tuple[float, float]:
    """Return how far a face's tilts `own`, (12,) bool, are off, rad, and how likely that is by chance."""
    rows, values = tilts
    free, change = 1.0, np.zeros(12)
    spread: Array = np.eye(12)
    tilt = max(float(np.sqrt(np.mean(values[~own] ** 2))), FINEST_TILT)
    for _ in range(_ROUNDS):
        design = np.vstack((fixed[0], rows[~own] / tilt))
        spread = np.asarray(np.linalg.inv(design.T @ design))
        change = -spread @ (design.T @ np.r_[fixed[1], values[~own] / tilt])
        left = values[~own] + rows[~own] @ change
        leverage = np.einsum("ij,jk,ik->i", rows[~own], spread, rows[~own]) / tilt**2
        free = left.size - float(leverage.sum())
        tilt = max(float(np.sqrt(left @ left / free)), FINEST_TILT)
    off = values[own] + rows[own] @ change
    variance = rows[own] @ spread @ rows[own].T + tilt**2 * np.eye(2)
    ratio = float(off @ np.linalg.solve(variance, off)) / 2.0
    return float(np.linalg.norm(off)), (1.0 + 2.0 * ratio / free) ** (-free / 2.0)  # F with 2 and `free`


def _shears(scale: Array) -> tuple[Array, Array]:
    """Return slopes (3, 12) and values (3,) of the cross-axis terms over their standard deviations.

    They are those of scale = rotation @ stretch, the stretch symmetric.
    """
    u, _, v = np.linalg.svd(scale)
    turned = u @ v
    rows = np.zeros((3, 12))
    for k, (i, j) in enumerate(_SHEARS):
        change = np.zeros((3, 3))
        change[:, j], change[:, i] = turned[:, i] / 2.0, turned[:, j] / 2.0
        rows[k, 3:] = change.ravel()
    stretch = turned.T @ scale
    values = np.array([stretch[i, j] for i, j in _SHEARS])
    return rows / CROSS_AXIS_SD, values / CROSS_AXIS_SD
