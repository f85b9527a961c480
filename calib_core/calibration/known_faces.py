"""A full calibration from rests on the six faces of the case, and its rotation handed on to later ones.

The daemon's own calibrations know no rotation common to all axes. Where the calibration in use has one from
known faces, a new one is turned by the same rotation: norms, by which calibrations are judged, do not change.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.accelerometer.known_attitudes import FACE_WORDS
from stillcal.calib_core.accelerometer.odd_face import OddFace
from stillcal.calib_core.accelerometer.parameters import ALL, Form, basis, names
from stillcal.calib_core.accelerometer.six_faces import (
    SixFaces,
    common_rotation,
    fit_six_faces,
    rotated_scale_covariance,
    rotation_covariance,
    without_rotation,
)
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.candidate import (
    CalibrateSettings,
    fit_gyroscope,
    gyroscope_record,
    validity_of,
)
from stillcal.calib_core.calibration.record import (
    AccelerometerRecord,
    Acceptance,
    CalibrationRecord,
    GyroscopeRecord,
    Provenance,
    StateRecord,
)
from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.static.rest import attitude_labels, force_uncertainties, forces


def calibrate_faces(
    pool: Pool,
    gravity: Gravity,
    t: float,
    settings: CalibrateSettings,
    unquestioned: Collection[int] = range(6),
) -> CalibrationRecord:
    """Calibrate both sensors from rests among which are the six faces, at sample time t (s).

    unquestioned: numbers of faces that are taken as they lie even if they do not agree with the other five;
    the reason then says so. Raises NotSupported where a face is missing, the faces are too far from square
    and level, or another one does not agree, naming it.
    """
    raw, local = forces(pool.rests), np.array([h.gravity.value for h in pool.held])
    samples = np.array([float(rest.n) for rest in pool.rests])
    fit = fit_six_faces(raw, force_uncertainties(pool.rests), local, samples)
    again = [FACE_WORDS[odd.face] for odd in fit.odd if odd.face not in unquestioned]
    if again:
        raise NotSupported(f"{_disagreeing(fit.odd)}: lay it again, flat", again)
    gyro = fit_gyroscope(pool, fit.model, gravity.value, settings.gyroscope)
    labels = attitude_labels(raw, settings.accelerometer.attitude_angle)
    degrees = np.degrees([fit.tilt, fit.rotation_sd])
    reason = (
        f"six known faces, tilted by {degrees[0]:.2g} degrees (rms); "
        f"the rotation of all axes is known to {degrees[1]:.2g} degrees (1 sd)"
    )
    if fit.odd:
        reason += f"; {_disagreeing(fit.odd)} ({', '.join(FACE_WORDS[odd.face] for odd in fit.odd)})"
    return CalibrationRecord(
        accelerometer=_accelerometer_record(fit, len(raw), gravity, float(local.mean())),
        gyroscope=None if gyro is None else gyroscope_record(gyro, t, pool.turns),
        gravity=gravity,
        fitted_at=t,
        validity=validity_of(pool.rests),
        acceptance=Acceptance(reason=reason, evidence={"tilt": fit.tilt, "rotation_sd": fit.rotation_sd}),
        provenance=Provenance(t_start=pool.rests[0].t_start, t_end=pool.rests[-1].t_end),
        states=tuple(
            StateRecord.of(rest, float(residual), int(label))
            for rest, residual, label in zip(pool.rests, fit.residuals, labels, strict=True)
        ),
    )


def _disagreeing(odd: Sequence[OddFace]) -> str:
    tilts = " and ".join(f"{np.degrees(one.tilt):.0f}" for one in odd)
    return f"a face is {tilts} degrees off what the other five show"


def inherit_rotation(old: CalibrationRecord | None, new: CalibrationRecord) -> CalibrationRecord:
    """Return a new calibration turned by the common rotation of the old one, where only that has one."""
    part = new.accelerometer
    return new if old is None or part is None or part.parameters == ALL else turned_as(old, new)


def turned_as(faces: CalibrationRecord, record: CalibrationRecord) -> CalibrationRecord:
    """Return a calibration with the rotation common to all axes of another one, where that has one.

    What rests show of its bias and scale stays.
    """
    known, part = faces.accelerometer, record.accelerometer
    if known is None or part is None or known.parameters != ALL:
        return record
    if known.covariance is None or known.names != names(ALL):
        return record
    rotation = common_rotation(known.scale) @ common_rotation(part.scale).T
    scale = rotation @ part.scale
    by_rests = np.eye(ALL)
    by_rests[3:, 3:] = np.kron(rotation, np.eye(3)) @ without_rotation(part.scale)
    covariance = by_rests @ _of_all_parameters(part) @ by_rests.T
    covariance[3:, 3:] += rotated_scale_covariance(scale, rotation_covariance(known.scale, known.covariance))
    accelerometer = replace(
        part,
        scale=scale,
        parameters=ALL,
        names=names(ALL),
        covariance=frozen(covariance),
        observability=None,
    )
    return replace(record, accelerometer=accelerometer, gyroscope=_turned(record.gyroscope, rotation))


def _of_all_parameters(part: AccelerometerRecord) -> Array:
    """Return a calibration's covariance of bias and scale row by row, (12, 12); of nothing where unknown."""
    if part.covariance is None:
        return np.zeros((ALL, ALL))
    form: Form = "symmetric" if part.names == names(part.parameters) else "triangular"
    spread = basis(part.parameters, form)
    return np.asarray(spread @ part.covariance @ spread.T)


def _turned(part: GyroscopeRecord | None, rotation: Array) -> GyroscopeRecord | None:
    """Turn a gyroscope's calibration, where its axes were fitted to the accelerometer's."""
    if part is None or part.parameters != ALL:
        return part
    covariance = part.covariance
    if covariance is not None:
        by_scale = np.eye(ALL)
        by_scale[:9, :9] = np.kron(rotation, np.eye(3))
        covariance = frozen(by_scale @ covariance @ by_scale.T)
    return replace(part, scale=rotation @ part.scale, covariance=covariance)


def _accelerometer_record(fit: SixFaces, rests: int, gravity: Gravity, value: float) -> AccelerometerRecord:
    covariance = np.array(fit.covariance)
    common = fit.model.scale.ravel() * gravity.scale_uncertainty
    covariance[3:, 3:] += np.outer(common, common)
    return AccelerometerRecord(
        scale=fit.model.scale,
        bias=fit.model.bias,
        parameters=ALL,
        names=names(ALL),
        covariance=frozen(covariance),
        rms_residual=fit.rms_residual,
        n_rests=rests,
        n_states=fit.n_states,
        gravity=value,
    )
