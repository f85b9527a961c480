"""All twelve parameters of an accelerometer from a phone laid on each of its six faces (ESGI'95, 3.4).

Rests of unknown attitude show only norms, so that a rotation common to all axes stays unknown. A phone that
lies on a face of its case shows where that face is. Case and table are not perfect: each face is tilted by an
unknown small angle. The fit of approach 2 (known_attitudes.py) would take these tilts for bias. Here a face
tells its norm as well as any rest, and its direction only to within the tilt, whose size follows from how far
opposite faces are from opposite (variance components; Förstner 1979). Rests in other attitudes add norms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer.known_attitudes import (
    FACE_DIRECTIONS,
    FACE_WORDS,
    faces_up,
    missing_faces,
    six_faces,
)
from stillcal.calib_core.accelerometer.odd_face import OddFace, odd_faces
from stillcal.calib_core.accelerometer.parameters import basis
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.maths.student_t import quantile
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.ranges import check_ranges
from stillcal.calib_core.static.rest import ATTITUDE_ANGLE, attitude_labels

_ROUNDS = 20
_NORMAL_975 = 1.959964
_FINEST_TILT = 1e-5  # rad; no face is known better


@dataclass(frozen=True, slots=True)
class SixFacesSettings:
    """What is required of the faces.

    max_off_axis: rad, a rest farther than this from every face is not one of them. max_tilt: rad, root mean
    square tilt beyond which faces do not count as known. scatter: m/s^2, by which norms of rests differ where
    too few rests show it.
    """

    max_off_axis: float = 0.3
    max_tilt: float = 0.035
    scatter: float = 0.01

    def __post_init__(self) -> None:
        check_ranges(self, {"max_off_axis": (0.0, 0.78), "max_tilt": (0.0, 1.0), "scatter": (1e-6, 1.0)})


@dataclass(frozen=True, slots=True, eq=False)
class SixFaces:
    """A calibration from six faces: calibrated = scale @ (raw - bias) in the axes of the case.

    covariance: (12, 12) of bias, then scale row by row. tilt: rad, root mean square tilt of a face.
    rotation_sd: rad, standard uncertainty of the rotation common to all axes, about the worst axis.
    residuals: (n,) m/s^2, of the norms. n_states: number of distinct attitudes. odd: faces that do not agree
    with the other five.
    """

    model: SensorModel
    covariance: Array
    tilt: float
    rotation_sd: float
    residuals: Array
    n_states: int
    odd: Sequence[OddFace] = ()

    @property
    def rms_residual(self) -> float:
        """Root mean square of the norms' residuals, m/s^2."""
        return rms(self.residuals)


_DEFAULT = SixFacesSettings()


def fit_six_faces(
    forces: Array, uncertainties: Array, gravity: Array, weights: Array, settings: SixFacesSettings = _DEFAULT
) -> SixFaces:
    """Fit bias and scale to rests, among them six faces.

    forces, uncertainties: (n, 3) raw means and their standard uncertainties, m/s^2. gravity: (n,) m/s^2.
    weights: (n,) number of samples. Of several attitudes near one face the one with most samples is taken.
    Raises NotSupported where a face is missing, naming it, or where the faces are too far from square, naming
    those farthest off: a tilted face cannot be told from the one opposite.
    """
    means = _face_means(forces, weights, settings)
    start = six_faces(means, float(gravity.mean())).model
    theta = np.r_[start.bias, start.scale.ravel()]
    tilt, scatter = settings.max_tilt, _scatter(forces, uncertainties, gravity, settings)
    own = np.linalg.norm(uncertainties, axis=1)
    labels = attitude_labels(forces, ATTITUDE_ANGLE)
    sd = np.hypot(own, scatter) * np.sqrt(np.bincount(labels)[labels])
    normal, free = np.eye(12), 1.0
    for _ in range(_ROUNDS):
        norm_rows, norms = _norms(theta, forces, gravity)
        tilt_rows, tilts = _tilts(theta, means)
        rows = np.vstack((norm_rows / sd[:, None], tilt_rows / tilt))
        residuals = np.r_[norms / sd, tilts / tilt]
        normal = np.linalg.inv(rows.T @ rows)
        theta = theta - normal @ (rows.T @ residuals)
        norms, tilts = _norms(theta, forces, gravity)[1], _tilts(theta, means)[1]
        leverage = np.einsum("ij,jk,ik->i", rows, normal, rows)
        free = tilts.size - float(leverage[norms.size :].sum())
        tilt = max(float(np.sqrt(tilts @ tilts / free)), _FINEST_TILT)
    if tilt > settings.max_tilt:
        off = np.hypot(*_tilts(theta, means)[1].reshape(6, 2).T)
        raise NotSupported(
            f"the faces are {np.degrees(tilt):.1f} degrees (rms) from square and level: lay them again, flat",
            [FACE_WORDS[k] for k in np.flatnonzero(off >= off.max() / 2)],
        )
    widened = (quantile(free, 0.975) / _NORMAL_975) ** 2
    model = SensorModel.of(theta[3:].reshape(3, 3), theta[:3])
    by_norms = norm_rows / sd[:, None], norms / sd
    covariance = frozen(widened * normal)
    return SixFaces(
        model=model,
        covariance=covariance,
        tilt=tilt,
        rotation_sd=float(np.sqrt(np.diag(rotation_covariance(model.scale, covariance)).max())),
        residuals=frozen(_norms(theta, forces, gravity)[1]),
        n_states=int(labels.max()) + 1,
        odd=odd_faces(model.scale, by_norms, (tilt_rows, tilts), settings.max_tilt),
    )


def common_rotation(scale: Array) -> Array:
    """Return the rotation (3, 3) that a scale (3, 3) holds: the orthogonal factor R of scale = R P."""
    u, _, v = np.linalg.svd(scale)
    return np.asarray(u @ v)


def rotation_covariance(scale: Array, covariance: Array) -> Array:
    """Return the covariance (3, 3), rad^2, of the rotation common to all axes.

    covariance: (12, 12) of bias, then scale row by row. A small rotation d changes the scale by d x scale.
    """
    inverse = np.linalg.inv(scale)
    rows = np.zeros((3, 9))
    for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        change = np.zeros((3, 3))
        change[i], change[j] = 0.5 * inverse[:, j], -0.5 * inverse[:, i]
        rows[k] = change.ravel()
    return np.asarray(rows @ covariance[3:, 3:] @ rows.T)


def without_rotation(scale: Array) -> Array:
    """Return the projection (9, 9) of a change of a scale (3, 3), row by row, onto what rests show of it.

    That is all but its part along rotations common to all axes.
    """
    stretches = np.kron(common_rotation(scale), np.eye(3)) @ basis(9)[3:, 3:]
    parts = np.linalg.inv(np.hstack((stretches, _turns(scale))))
    return np.asarray(stretches @ parts[:6])


def rotated_scale_covariance(scale: Array, rotation: Array) -> Array:
    """Return the covariance (9, 9) that an uncertain rotation, (3, 3) rad^2, puts into a scale (3, 3)."""
    turns = _turns(scale)
    return np.asarray(turns @ rotation @ turns.T)


def _turns(scale: Array) -> Array:
    """Return by how much a scale (3, 3), row by row, changes with a rotation about each axis, (9, 3)."""
    return np.stack([np.cross(axis, scale.T).T.ravel() for axis in np.eye(3)], axis=1)


def _scatter(forces: Array, uncertainties: Array, gravity: Array, settings: SixFacesSettings) -> float:
    """Return the scatter of the norms, m/s^2, as a fit of nine parameters shows it, or the usual one."""
    try:
        fit = accelerometer.fit(forces, uncertainties, gravity, parameters=9)
    except NotSupported:
        return settings.scatter
    return fit.rms_residual * float(np.sqrt(fit.n_states / max(fit.n_states - fit.parameters, 1)))


def _face_means(forces: Array, weights: Array, settings: SixFacesSettings) -> Array:
    """Return the mean raw force of each face, (6, 3), of the attitude near it with most samples."""
    up = faces_up(forces, settings.max_off_axis)
    missing = missing_faces(up)
    if missing:
        raise NotSupported(f"{6 - len(missing)} of 6 faces", missing)
    labels = attitude_labels(forces, settings.max_tilt)
    means = np.empty((6, 3))
    for face in range(6):
        samples = np.bincount(labels[up == face], weights[up == face])
        chosen = (up == face) & (labels == samples.argmax())
        means[face] = np.average(forces[chosen], axis=0, weights=weights[chosen])
    return means


def _norms(theta: Array, forces: Array, gravity: Array) -> tuple[Array, Array]:
    """Return the slopes (n, 12) of the calibrated norms and the norms less gravity, (n,) m/s^2."""
    shifted, scale = forces - theta[:3], theta[3:].reshape(3, 3)
    calibrated = shifted @ scale.T
    norm = np.linalg.norm(calibrated, axis=1)
    up = calibrated / norm[:, None]
    by_scale = (up[:, :, None] * shifted[:, None, :]).reshape(-1, 9)
    return np.hstack((-up @ scale, by_scale)), norm - gravity


def _tilts(theta: Array, means: Array) -> tuple[Array, Array]:
    """Return the slopes (12, 12) of the six faces' tilts by the parameters and the tilts, (12,) rad."""
    shifted, scale = means - theta[:3], theta[3:].reshape(3, 3)
    calibrated = shifted @ scale.T
    norm = np.linalg.norm(calibrated, axis=1)
    rows, values = [], []
    for face, direction in enumerate(FACE_DIRECTIONS):
        for axis in np.flatnonzero(direction == 0.0):
            by_scale = np.zeros((3, 3))
            by_scale[axis] = shifted[face]
            rows.append(np.r_[-scale[axis], by_scale.ravel()] / norm[face])
            values.append(calibrated[face, axis] / norm[face])
    return np.array(rows), np.array(values)
