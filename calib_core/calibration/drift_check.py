"""The hourly check of the calibration in use (Grammenos et al. 2018, 4.7).

"Checking for calibration quality is much faster and easier than trying to gather potential states": the
calibrated norm of each rest is compared with local gravity, the gyroscope's mean rate with zero, and a table
says what follows from the two results. Every difference is judged against its own uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.accelerometer.prior import norm_variances
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.record import AccelerometerRecord, CalibrationRecord, Evidence
from stillcal.calib_core.calibration.rest_pool import HeldRest, Pool
from stillcal.calib_core.calibration.terms import compensated
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import directions, force_uncertainties, forces

Number = float | Array

_OUTVOTED = 3
"""Rests: where no more than these were checked, one that disagrees cannot be told from a real change."""

_OMITTED_CROSS_AXIS = 0.05
"""m/s^2: half of 1 % of gravity, what a phone's usual cross-axis sensitivity puts into a norm at worst
(InvenSense MPU-6050 and Bosch BMI270 datasheets give 1 to 2 %)."""


@dataclass(frozen=True, slots=True)
class QualitySettings:
    """When a calibration counts as drifted, and when a new one as better.

    A difference is drift where it is larger than `significance` standard uncertainties and than its limit.
    accel_limit: m/s^2, of a rest's norm. gyro_limit: rad/s, of the mean rate at rest. chance: probability of
    accepting a new calibration that is no better than the old one. held_out_rests: attitudes needed to tell.
    """

    significance: float = 3.0
    accel_limit: float = 0.02
    gyro_limit: float = 0.001
    chance: float = 0.025
    held_out_rests: int = 6

    def __post_init__(self) -> None:
        for name in ("significance", "accel_limit", "gyro_limit"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} = {getattr(self, name)}: must be positive")
        if not 0 < self.chance < 0.5:
            raise ValueError(f"chance = {self.chance}: must be within 0..0.5")
        if 2.0**-self.held_out_rests > self.chance:
            raise ValueError(
                f"held_out_rests = {self.held_out_rests}: too few to tell at chance {self.chance}"
            )


class Drift(StrEnum):
    """What a check says of one sensor."""

    NONE = "none"
    DRIFTED = "drifted"
    UNKNOWN = "unknown"


class Verdict(StrEnum):
    """What follows from a check.

    Every check that does not ask for a recalibration measures the gyroscope's bias anew (4.7). `zero gyro`
    says that the bias had drifted beyond its limit, `keep` that it had not.
    """

    WAIT = "wait"
    KEEP = "keep"
    UPDATE_BIAS = "zero gyro"
    RECALIBRATE = "recalibrate"


VERDICTS: dict[tuple[Drift, Drift], Verdict] = {
    (Drift.UNKNOWN, Drift.UNKNOWN): Verdict.WAIT,
    (Drift.UNKNOWN, Drift.NONE): Verdict.WAIT,
    (Drift.UNKNOWN, Drift.DRIFTED): Verdict.WAIT,
    (Drift.NONE, Drift.UNKNOWN): Verdict.KEEP,
    (Drift.NONE, Drift.NONE): Verdict.KEEP,
    (Drift.NONE, Drift.DRIFTED): Verdict.UPDATE_BIAS,
    (Drift.DRIFTED, Drift.UNKNOWN): Verdict.RECALIBRATE,
    (Drift.DRIFTED, Drift.NONE): Verdict.RECALIBRATE,
    (Drift.DRIFTED, Drift.DRIFTED): Verdict.RECALIBRATE,
}
"""(accelerometer, gyroscope) -> what follows. The accelerometer decides on a full recalibration (4.7)."""


@dataclass(frozen=True, slots=True)
class Check:
    """The result of one check.

    rests: number of rests checked. rests_off: how many of them disagree by themselves. off_since: s, when
    the first of those began. accel_residual: m/s^2, mean norm less gravity. gyro_residual: rad/s, the
    largest axis of mean rate less bias. Each residual has its standard uncertainty; None where no rest had
    the sensor. accel_largest: m/s^2, the largest residual of a single norm.
    """

    accelerometer: Drift
    gyroscope: Drift
    verdict: Verdict
    rests: int
    rests_off: int = 0
    off_since: float | None = None
    accel_residual: float | None = None
    accel_uncertainty: float | None = None
    gyro_residual: float | None = None
    gyro_uncertainty: float | None = None
    accel_largest: float | None = None

    def figures(self) -> Evidence:
        """Return what the check measured, for a log line; what is unknown is left out."""
        return {name: value for name, value in asdict(self).items() if value is not None}


def check_calibration(record: CalibrationRecord, recent: Pool, settings: QualitySettings) -> Check:
    """Check a calibration on recent rests (4.7), by its terms too. It must have an accelerometer part."""
    assert record.accelerometer is not None
    recent = compensated(recent, record)
    bias = None if record.gyroscope is None else record.gyroscope.bias
    part = record.accelerometer
    uncertainty = np.hypot(norm_uncertainty(part, forces(recent.rests)), _gravity_change(record, recent))
    return check_rests(part.model, uncertainty, bias, recent.held, settings)


def check_rests(
    accelerometer: SensorModel,
    norm_uncertainty: Number,
    gyro_bias: Array | None,
    held: Sequence[HeldRest],
    settings: QualitySettings,
) -> Check:
    """Check an accelerometer's model and a gyroscope's bias, (3,) rad/s or None, on rests.

    norm_uncertainty: m/s^2, one or (n,), what the calibration itself leaves uncertain in a rest's norm, the
    repeatability of rests included. The accelerometer has drifted where two rests disagree or where the mean
    does: a change of bias lengthens one norm and shortens another, and their mean may not show it. One rest
    alone may be a bad one: among few rests it leads to waiting for more, by many it is outvoted.
    """
    if not held:
        return Check(Drift.UNKNOWN, Drift.UNKNOWN, Verdict.WAIT, 0)
    residual, own = norm_residuals(accelerometer, held)
    accel = _weighted_mean(residual, own, norm_uncertainty)
    off = _is_off(residual, np.hypot(own, norm_uncertainty), settings.significance, settings.accel_limit)
    off_since = held[int(off.argmax())].rest.t_start if off.any() else None
    gyro = _rate_residual(gyro_bias, held)
    accel_drift = _accel_drift(residual, own, norm_uncertainty, settings)
    gyro_drift = _drift(gyro, settings.significance, settings.gyro_limit)
    verdict = VERDICTS[accel_drift, gyro_drift]
    return Check(
        accel_drift,
        gyro_drift,
        verdict,
        len(held),
        int(off.sum()),
        off_since,
        accel_residual=accel[0],
        accel_uncertainty=accel[1],
        gyro_residual=None if gyro is None else gyro[0],
        gyro_uncertainty=None if gyro is None else gyro[1],
        accel_largest=float(np.abs(residual).max()),
    )


def check_gyroscope(bias: Array, held: Sequence[HeldRest], settings: QualitySettings) -> Drift:
    """Check a gyroscope's bias, (3,) rad/s, on rests: the largest axis of their mean rate less bias."""
    return _drift(_rate_residual(bias, held), settings.significance, settings.gyro_limit)


def stepped_since(bias: Array, held: Sequence[HeldRest], settings: QualitySettings) -> float | None:
    """Return since when (s) a gyroscope's bias, (3,) rad/s, has stepped; None where the rests do not show it.

    The two newest rests with rates must both disagree with it, and agree with each other: a single one may
    have been turning slowly about the vertical, as in a vehicle.
    """
    newest = [h for h in held if h.rest.rate is not None][-2:]
    if len(newest) < 2 or newest[0].rest.rate is None:
        return None
    if any(check_gyroscope(bias, [h], settings) is not Drift.DRIFTED for h in newest):
        return None
    if check_gyroscope(newest[0].rest.rate, newest[1:], settings) is Drift.DRIFTED:
        return None
    return newest[0].rest.t_start


def norm_residuals(model: SensorModel, held: Sequence[HeldRest]) -> tuple[Array, Array]:
    """Return each rest's calibrated norm less local gravity and its standard uncertainty, (n,) m/s^2 each.

    The uncertainty is that of the rest's mean, propagated through the model along the direction of gravity.
    """
    rests = [h.rest for h in held]
    calibrated = model.apply(forces(rests))
    norm = np.linalg.norm(calibrated, axis=1)
    along = (calibrated / norm[:, None]) @ model.scale
    own = np.linalg.norm(along * force_uncertainties(rests), axis=1)
    return norm - np.array([h.gravity.value for h in held]), own


def norm_uncertainty(part: AccelerometerRecord, raw: Array) -> Array:
    """Return what a calibration leaves uncertain in the norms of rests of raw force (n, 3), (n,) m/s^2.

    The scatter of the rests it was fitted to and, without cross-axis terms, what these may amount to. A
    calibration that a prior entered is known unequally well by direction, as its covariance says.
    """
    unknown = np.full(len(raw), _OMITTED_CROSS_AXIS if part.parameters == 6 else 0.0)
    if part.with_prior and part.covariance is not None:
        up = directions(part.model.apply(raw))
        unknown = np.sqrt(norm_variances(up, part.covariance, part.gravity))
    return np.asarray(np.hypot(part.rms_residual or 0.0, unknown))


def _gravity_change(record: CalibrationRecord, recent: Pool) -> float:
    """Return the uncertainty (m/s^2) of the gravity fitted to, where recent rests know theirs from elsewhere.

    A phone that was calibrated before it knew its place has a scale that is off by as much as the standard
    gravity is there. That is no drift of the sensor.
    """
    if record.gravity is None or all(h.gravity.source == record.gravity.source for h in recent.held):
        return 0.0
    return record.gravity.uncertainty


def _accel_drift(residual: Array, own: Array, norm_uncertainty: Number, settings: QualitySettings) -> Drift:
    """Decide whether two rests disagree, or the mean does without the rest that disagrees most."""
    common = np.broadcast_to(norm_uncertainty, residual.shape)
    apart = np.abs(residual) / np.hypot(own, norm_uncertainty)
    off = _is_off(residual, np.hypot(own, norm_uncertainty), settings.significance, settings.accel_limit)
    if off.sum() >= 2:
        return Drift.DRIFTED
    if off.sum() == 1 and residual.size <= _OUTVOTED:
        return Drift.UNKNOWN
    others = np.arange(residual.size) != apart.argmax()
    if not others.any():
        return Drift.NONE
    mean = _weighted_mean(residual[others], own[others], common[others])
    return _drift(mean, settings.significance, settings.accel_limit)


def _weighted_mean(values: Array, own: Array, common: Number) -> tuple[float, float]:
    """Return the mean of residuals that share a common error, one or (n,), and its standard uncertainty."""
    weight = 1 / np.maximum(own, 1e-9) ** 2
    mean = float(weight @ values / weight.sum())
    shared = weight @ np.broadcast_to(common, values.shape) / weight.sum()
    return mean, float(np.hypot(1 / np.sqrt(weight.sum()), shared))


def _rate_residual(bias: Array | None, held: Sequence[HeldRest]) -> tuple[float, float] | None:
    """Return the largest axis of (mean rate at rest - bias) and its uncertainty; None without a rate."""
    with_rate = [h.rest for h in held if h.rest.rate is not None and h.rest.rate_uncertainty is not None]
    if bias is None or not with_rate:
        return None
    weight = 1 / np.maximum(np.array([r.rate_uncertainty for r in with_rate]), 1e-9) ** 2
    mean = (weight * np.array([r.rate for r in with_rate])).sum(axis=0) / weight.sum(axis=0) - bias
    axis = int(np.abs(mean).argmax())
    return float(mean[axis]), float(1 / np.sqrt(weight.sum(axis=0)[axis]))


def _drift(residual: tuple[float, float] | None, significance: float, limit: float) -> Drift:
    """Judge a residual and its uncertainty; None is unknown."""
    if residual is None:
        return Drift.UNKNOWN
    return Drift.DRIFTED if _is_off(*residual, significance, limit) else Drift.NONE


def _is_off(residual: Number, uncertainty: Number, significance: float, limit: float) -> NDArray[np.bool_]:
    """Tell whether residuals are larger than their uncertainty explains, and large enough to matter."""
    return np.asarray(np.abs(residual) > np.maximum(limit, significance * np.asarray(uncertainty)))
