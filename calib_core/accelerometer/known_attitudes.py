"""A phone laid once on each of its faces: which calibration that supports, or why none.

Chooses between approach 2 of ESGI'95 (sixface.py, the faces taken as known) and the 6 parameters of
accelerometer.py (only the norm taken as known). Which face points up is read from the data.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer import sixface
from stillcal.calib_core.accelerometer.fit import AccelerometerSettings
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.model import SensorModel


class Method(StrEnum):
    """How a phone's faces were turned into a model."""

    KNOWN_FACES = "approach 2"
    SIX_PARAMETERS = "6 parameters"


class Broken(NotSupported):
    """The sensor itself does not work; no further rest would help."""


@dataclass(frozen=True, slots=True)
class FaceSettings:
    """What is asked of faces.

    max_off_axis: rad, a rest farther than this from every face is none. max_norm_error: fraction of g beyond
    which the sensor is broken. max_spread: m/s^2, samples that scatter more were not at rest. max_tilt: rad,
    rms irregularity of the faces beyond which they are not known well enough: half of it would pass for
    cross-axis sensitivity, and half a percent of that is what leaving it out costs (1 % in datasheets).
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

    faces: number of rests used. tilt: rad, rms of what approach 2 leaves over: opposite faces that are not
    opposite. rms_residual: m/s^2, of the norm; nothing is left of it by 6 parameters from 6 faces.
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
    """Calibrate from mean raw forces (n, 3) of faces, m/s^2, with the sd of their samples and of the means.

    Raises Broken where the sensor does not work; NotSupported where a face is missing, naming it.
    """
    _require_working(forces, spreads, gravity, settings)
    still = (spreads <= settings.max_spread).all(axis=1)
    up = np.where(still, sixface.faces_up(forces, settings.max_off_axis), -1)
    missing = sixface.missing_faces(up)
    if missing:
        reason = f"{6 - len(missing)} of 6 faces"
        if not still.all():
            reason += f", {np.count_nonzero(~still)} recordings were not at rest"
        raise NotSupported(reason, missing)
    face = up >= 0
    known = sixface.fit_known(forces[face], gravity * sixface.FACE_DIRECTIONS[up[face]])
    tilt = _tilt(known, gravity)
    if tilt <= settings.max_tilt:
        model, method = known.model, Method.KNOWN_FACES
    else:
        model, method = _six_parameters(forces[face], uncertainties[face], gravity), Method.SIX_PARAMETERS
    norms = np.linalg.norm(model.apply(forces[face]), axis=1)
    return FaceCalibration(
        model, method, int(face.sum()), tilt, float(np.sqrt(np.mean((norms - gravity) ** 2)))
    )


def _six_parameters(forces: Array, uncertainties: Array, gravity: float) -> SensorModel:
    settings = AccelerometerSettings()
    return accelerometer.fit(forces, uncertainties, gravity, parameters=6, settings=settings).model


def _tilt(known: sixface.KnownFit, gravity: float) -> float:
    """Return the rms of what the linear model leaves over, as an angle; two axes of each face show tilt."""
    free = max(2 * (len(known.residuals) - 4), 1)
    return float(np.sqrt((known.residuals**2).sum() / free) / gravity)


def _require_working(forces: Array, spreads: Array, gravity: float, settings: FaceSettings) -> None:
    """Raise Broken for a sensor that repeats one value, does not follow gravity, or is far off its size."""
    frozen_rows = np.flatnonzero((spreads == 0.0).all(axis=1))
    if frozen_rows.size:
        raise Broken(
            f"the sensor is frozen: {frozen_rows.size} of {len(forces)} recordings hold one value throughout"
        )
    off = np.abs(np.linalg.norm(forces, axis=1) / gravity - 1.0)
    if off.max(initial=0.0) > settings.max_norm_error:
        raise Broken(f"a rest's norm is {off.max():.0%} off gravity, more than {settings.max_norm_error:.0%}")
