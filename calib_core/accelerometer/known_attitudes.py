"""Calibration of an accelerometer from known attitudes: a phone laid once on each of its six faces.

`fit_known` is approach 2 of ESGI'95 (Georgieva et al., "Laboratory calibration of a MEMS accelerometer
sensor", section 3): raw = X a + y with the specific force a known, linear, all twelve parameters observable.
The paper writes a as gravity's pull, (0, 0, -g) for a phone on its back, yet its tables give +g there; the
sign only mirrors X. Here a is specific force, +g on the axis that points up, as on Android.

`calibrate_faces` reads from the data which face points up. It uses approach 2 where the faces are square
enough to count as known, and otherwise the 6 parameters of `fit.py`, for which only the norm is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer.fit import AccelerometerSettings
from stillcal.calib_core.accelerometer.observability import describe
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import directions

FACE_DIRECTIONS = np.vstack([sign * np.eye(3)[k] for k in range(3) for sign in (-1.0, 1.0)])
"""(6, 3): -x, +x, -y, +y, -z, +z, the paper's order of a(1) to a(6) (3.3.1)."""

FACE_WORDS = tuple(map(describe, FACE_DIRECTIONS))
"""How to lay the phone for each of these."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownFit:
    """A fit of raw = X a + y.

    X: (3, 3). y: (3,) m/s^2. covariance: (12, 12) of X, row by row, and y, from the residuals; None where
    four attitudes leave no residuals. residuals: (n, 3) raw less model, m/s^2.
    """

    X: Array
    y: Array
    covariance: Array | None
    residuals: Array

    @property
    def model(self) -> SensorModel:
        """The correction, Eq. 20: calibrated = X^-1 (raw - y)."""
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
    solution = np.linalg.lstsq(design, raw, rcond=None)[0]
    residuals = raw - design @ solution
    x = solution[:3].T / unit
    return KnownFit(frozen(x), frozen(solution[3]), _covariance(design, residuals, unit), frozen(residuals))


def six_faces(forces: ArrayLike, gravity: float) -> KnownFit:
    """Return the closed-form fit of the six faces (3.3.1); rows in the order of FACE_DIRECTIONS, m/s^2."""
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
    cosines = directions(raw) @ FACE_DIRECTIONS.T
    return np.where(cosines.max(axis=1) >= np.cos(tilt), cosines.argmax(axis=1), -1)


def missing_faces(up: Array) -> tuple[str, ...]:
    """Return in words the faces that `up` (n,), from `faces_up`, lacks."""
    return tuple(words for k, words in enumerate(FACE_WORDS) if k not in up)


def _covariance(design: Array, residuals: Array, unit: float) -> Array | None:
    """Return the covariance of X, row by row, and y, (12, 12), by one noise pooled over the three axes."""
    free = 3 * (len(design) - 4)
    if free == 0:
        return None
    one = np.linalg.inv(design.T @ design) * float((residuals**2).sum()) / free
    one = one / np.outer(units := np.r_[np.full(3, unit), 1.0], units)
    rows = [(axis, k) for axis in range(3) for k in range(3)] + [(axis, 3) for axis in range(3)]
    axis, column = np.array(rows).T
    return frozen(one[np.ix_(column, column)] * (axis[:, None] == axis[None, :]))


class Method(StrEnum):
    """How a model was fitted to a phone's faces."""

    KNOWN_FACES = "approach 2"
    SIX_PARAMETERS = "6 parameters"


class Broken(NotSupported):
    """Refusal because the sensor itself does not work; no further rest would help."""


@dataclass(frozen=True, slots=True)
class FaceSettings:
    """What is required of faces.

    max_off_axis: rad, a rest farther than this from every face is not used. max_norm_error: fraction of g
    beyond which the sensor counts as broken. max_spread: m/s^2, a recording with a larger standard deviation
    was not at rest. max_tilt: rad, root mean square irregularity of the faces beyond which they do not count
    as known: half of it would pass for cross-axis sensitivity, and half a percent of that is what leaving it
    out costs (1 % in datasheets).
    """

    max_off_axis: float = 0.5
    max_norm_error: float = 0.25
    max_spread: float = 0.2
    max_tilt: float = 0.01

    def __post_init__(self) -> None:
        for name, high in (
            ("max_off_axis", 0.78),
            ("max_norm_error", 1.0),
            ("max_spread", 10.0),
            ("max_tilt", 1.0),
        ):
            if not 0.0 < getattr(self, name) <= high:
                raise ValueError(f"{name} is {getattr(self, name)}: allowed above 0, to {high}")


@dataclass(frozen=True, slots=True, eq=False)
class FaceCalibration:
    """A phone calibrated from its faces.

    faces: number of rests used. tilt: rad, root mean square residual of approach 2 as an angle, by which
    opposite faces are not opposite. rms_residual: m/s^2, of the norm; 0 for 6 parameters from 6 faces.
    """

    model: SensorModel
    method: Method
    faces: int
    tilt: float
    rms_residual: float


_DEFAULT = FaceSettings()


def calibrate_faces(
    forces: Array, spreads: Array, uncertainties: Array, gravity: float, settings: FaceSettings = _DEFAULT
) -> FaceCalibration:
    """Calibrate from mean raw forces of faces, (n, 3) m/s^2.

    spreads: (n, 3) standard deviation of the samples. uncertainties: (n, 3) of the means. gravity: m/s^2.
    Raises Broken where the sensor does not work; NotSupported where a face is missing, naming it.
    """
    _require_working(forces, spreads, gravity, settings)
    still = (spreads <= settings.max_spread).all(axis=1)
    up = np.where(still, faces_up(forces, settings.max_off_axis), -1)
    missing = missing_faces(up)
    if missing:
        reason = f"{6 - len(missing)} of 6 faces"
        if not still.all():
            reason += f", {np.count_nonzero(~still)} recordings were not at rest"
        raise NotSupported(reason, missing)
    face = up >= 0
    known = fit_known(forces[face], gravity * FACE_DIRECTIONS[up[face]])
    tilt = _tilt(known, gravity)
    if tilt <= settings.max_tilt:
        model, method = known.model, Method.KNOWN_FACES
    else:
        model, method = _six_parameters(forces[face], uncertainties[face], gravity), Method.SIX_PARAMETERS
    norms = np.linalg.norm(model.apply(forces[face]), axis=1)
    return FaceCalibration(model, method, int(face.sum()), tilt, rms(norms - gravity))


def _six_parameters(forces: Array, uncertainties: Array, gravity: float) -> SensorModel:
    """Fit bias and scale factors to norms alone."""
    settings = AccelerometerSettings()
    return accelerometer.fit(forces, uncertainties, gravity, parameters=6, settings=settings).model


def _tilt(known: KnownFit, gravity: float) -> float:
    """Return the rms residual of the linear model as an angle, rad; two axes of each face show tilt."""
    free = max(2 * (len(known.residuals) - 4), 1)
    return float(np.sqrt((known.residuals**2).sum() / free) / gravity)


def _require_working(forces: Array, spreads: Array, gravity: float, settings: FaceSettings) -> None:
    """Raise Broken for a sensor that repeats one value or whose norm is far off gravity."""
    frozen_rows = np.flatnonzero((spreads == 0.0).all(axis=1))
    if frozen_rows.size:
        raise Broken(
            f"the sensor is frozen: {frozen_rows.size} of {len(forces)} recordings hold one value throughout"
        )
    off = np.abs(np.linalg.norm(forces, axis=1) / gravity - 1.0)
    if off.max(initial=0.0) > settings.max_norm_error:
        raise Broken(f"a rest's norm is {off.max():.0%} off gravity, more than {settings.max_norm_error:.0%}")
