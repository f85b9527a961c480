"""Known attitudes: approach 2 of ESGI'95, linear, with all twelve parameters observable.

Georgieva et al., "Laboratory calibration of a MEMS accelerometer sensor", section 3: raw = X a + y with a
known. The paper writes a as gravity's pull, (0, 0, -g) for a phone on its back, yet its tables give +g
there; the sign only mirrors X. Here a is specific force, +g on the axis that points up, as on Android.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stillcal.calib_core.accelerometer.observability import describe
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.model import SensorModel

FACE_DIRECTIONS = np.vstack([sign * np.eye(3)[k] for k in range(3) for sign in (-1.0, 1.0)])
"""(6, 3): -x, +x, -y, +y, -z, +z, the paper's order of a(1) to a(6) (3.3.1)."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownFit:
    """A fit of raw = X a + y. X: (3, 3); y: (3,) m/s^2.

    covariance: (12, 12) of X row by row and y, from residuals, None where four attitudes leave none.
    residuals: (n, 3) raw less model, m/s^2.
    """

    X: Array
    y: Array
    covariance: Array | None
    residuals: Array

    @property
    def model(self) -> SensorModel:
        """Eq. 20: calibrated = X^-1 (raw - y)."""
        return SensorModel.of(np.linalg.inv(self.X), self.y)


def fit_known(forces: ArrayLike, truth: ArrayLike) -> KnownFit:
    """Fit X and y by least squares to raw forces (n, 3) at known specific forces (n, 3), both m/s^2.

    Raises NotSupported where the vectors (a, 1) do not span four dimensions (Eq. 22).
    """
    raw, known = np.asarray(forces, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    if raw.shape != known.shape or raw.ndim != 2 or raw.shape[1] != 3:
        raise ValueError(f"forces {raw.shape} and truth {known.shape}: expected two of (n, 3)")
    unit = float(np.abs(known).max(initial=1.0))
    design = np.column_stack((known / unit, np.ones(len(known))))
    if np.linalg.matrix_rank(design, tol=1e-6 * np.sqrt(max(len(design), 1))) < 4:
        raise NotSupported("the known attitudes lie in one plane", ["faces on every side of the phone"])
    found = np.linalg.lstsq(design, raw, rcond=None)[0]
    residuals = raw - design @ found
    x = found[:3].T / unit
    return KnownFit(frozen(x), frozen(found[3]), _covariance(design, residuals, unit), frozen(residuals))


def six_faces(forces: ArrayLike, gravity: float) -> KnownFit:
    """Return the closed form for the six faces (3.3.1); rows in the order of FACE_DIRECTIONS, m/s^2."""
    raw = np.asarray(forces, dtype=np.float64)
    if raw.shape != (6, 3):
        raise ValueError(f"forces have shape {raw.shape}: expected (6, 3), one row a face")
    x = (raw[1::2] - raw[::2]).T / (2.0 * gravity)
    y = raw.mean(axis=0)
    residuals = raw - gravity * FACE_DIRECTIONS @ x.T - y
    design = np.column_stack((FACE_DIRECTIONS, np.ones(6)))
    return KnownFit(frozen(x), frozen(y), _covariance(design, residuals, gravity), frozen(residuals))


def faces_up(forces: ArrayLike, tilt: float = np.pi / 4) -> Array:
    """Return which face points up in each raw force (n, 3), a row of FACE_DIRECTIONS, or -1; (n,) ints.

    tilt: rad, farthest from the face's own direction.
    """
    raw = np.asarray(forces, dtype=np.float64)
    unit = raw / np.maximum(np.linalg.norm(raw, axis=1, keepdims=True), 1e-12)
    cosines = unit @ FACE_DIRECTIONS.T
    return np.where(cosines.max(axis=1) >= np.cos(tilt), cosines.argmax(axis=1), -1)


def missing_faces(up: Array) -> tuple[str, ...]:
    """Return in words the faces that `up` (n,), from `faces_up`, lacks."""
    return tuple(describe(FACE_DIRECTIONS[k]) for k in range(6) if k not in up)


def _covariance(design: Array, residuals: Array, unit: float) -> Array | None:
    """Pooled over the three axes, as one noise; order X row by row, then y."""
    free = 3 * (len(design) - 4)
    if free == 0:
        return None
    one = np.linalg.inv(design.T @ design) * float((residuals**2).sum()) / free
    one = one / np.outer(units := np.r_[np.full(3, unit), 1.0], units)
    rows = [(axis, k) for axis in range(3) for k in range(3)] + [(axis, 3) for axis in range(3)]
    axis, column = np.array(rows).T
    return frozen(one[np.ix_(column, column)] * (axis[:, None] == axis[None, :]))
