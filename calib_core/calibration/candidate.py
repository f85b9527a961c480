"""A full calibration from what was gathered, and whether it may replace the one before.

Puts the estimators together; has no formula of its own for either sensor. A candidate is a complete
record, its evidence beside it; the decision is taken on rests that neither calibration was fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer.fit import AccelerometerFit, AccelerometerSettings
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration import drift_check as quality
from stillcal.calib_core.calibration.drift_check import Check, Comparison, QualitySettings
from stillcal.calib_core.calibration.gyroscope_record import gyroscope_record
from stillcal.calib_core.calibration.record import (
    AccelerometerRecord,
    Acceptance,
    CalibrationRecord,
    Evidence,
    Provenance,
    StateRecord,
    Validity,
)
from stillcal.calib_core.calibration.rest_pool import HeldRest, Pool
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.gyroscope import fit as gyroscope
from stillcal.calib_core.gyroscope.fit import GyroscopeFit, GyroscopeSettings
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState, attitude_labels, force_uncertainties, forces

_OMITTED_CROSS_AXIS = 0.05
"""m/s^2: half of 1 % of gravity, what a phone's usual cross-axis sensitivity puts into a norm at worst
(InvenSense MPU-6050 and Bosch BMI270 datasheets give 1 to 2 %)."""


@dataclass(frozen=True, slots=True)
class CalibrateSettings:
    """The estimators' settings. folds: into how many parts, at most, attitudes are held out."""

    accelerometer: AccelerometerSettings = field(default_factory=AccelerometerSettings)
    gyroscope: GyroscopeSettings = field(default_factory=GyroscopeSettings)
    folds: int = 30

    def __post_init__(self) -> None:
        if self.folds < 2:
            raise ValueError(f"folds = {self.folds}: must be 2 or more")


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A calibration that was fitted and not yet accepted.

    pool: what it stands on; labels: (n,) which attitude each of its rests is in.
    """

    record: CalibrationRecord
    accelerometer: AccelerometerFit
    gyroscope: GyroscopeFit | None
    pool: Pool
    settings: CalibrateSettings
    labels: NDArray[np.intp]

    @property
    def gravity(self) -> Gravity:
        """Gravity of where the phone was when it was fitted."""
        return self.record.gravity or Gravity()

    def accepted(self, decision: Decision, occasion: str) -> CalibrationRecord:
        """Return the record with the reason and the figures that it was decided on."""
        evidence: Evidence = {"occasion": occasion, **decision.evidence}
        return replace(self.record, acceptance=Acceptance(reason=decision.reason, evidence=evidence))


@dataclass(frozen=True, slots=True)
class Decision:
    """Whether a candidate takes the old one's place, why, and the figures.

    settled: whether enough rests were held out to tell; an old one that is then kept is sound.
    """

    accepted: bool
    reason: str
    evidence: Evidence = field(default_factory=dict)
    settled: bool = True


def candidate(pool: Pool, gravity: Gravity, t: float, settings: CalibrateSettings) -> Candidate:
    """Fit both sensors to the pool. t: s, sample time.

    Raises NotSupported where the rests do not allow it. The gyroscope may fall short without harm: it
    then has its bias only, or no part in the record.
    """
    fit = _fit_accelerometer(pool.held, gravity, settings.accelerometer)
    gyro = _fit_gyroscope(pool, fit.model, gravity.value, settings.gyroscope)
    labels = attitude_labels(forces(pool.rests), settings.accelerometer.attitude_angle)
    record = CalibrationRecord(
        accelerometer=_accelerometer_record(fit),
        gyroscope=None if gyro is None else gyroscope_record(gyro, t),
        gravity=gravity,
        fitted_at=t,
        validity=_validity(pool.rests),
        provenance=Provenance(t_start=pool.rests[0].t_start, t_end=pool.rests[-1].t_end),
        states=tuple(
            StateRecord.of(rest, float(residual), int(label))
            for rest, residual, label in zip(pool.rests, fit.residuals, labels, strict=True)
        ),
    )
    return Candidate(record, fit, gyro, pool, settings, labels)


def _fit_accelerometer(
    held: Sequence[HeldRest], gravity: Gravity, settings: AccelerometerSettings, parameters: int | None = None
) -> AccelerometerFit:
    rests = [h.rest for h in held]
    local = np.array([h.gravity.value for h in held])
    wanted = cast(accelerometer.Parameters, parameters or "auto")
    return accelerometer.fit(
        forces(rests),
        force_uncertainties(rests),
        local,
        gravity.uncertainty,
        parameters=wanted,
        settings=settings,
    )


def _fit_gyroscope(
    pool: Pool, accel: SensorModel, gravity: float, settings: GyroscopeSettings
) -> GyroscopeFit | None:
    try:
        return gyroscope.fit(pool.turns, accel, gravity, rests=pool.rests, settings=settings)
    except NotSupported:
        return None


def _accelerometer_record(fit: AccelerometerFit) -> AccelerometerRecord:
    return AccelerometerRecord(
        scale=fit.model.scale,
        bias=fit.model.bias,
        parameters=fit.parameters,
        names=fit.names,
        covariance=frozen(fit.total_covariance),
        rms_residual=fit.rms_residual,
        n_rests=fit.n_rests,
        n_states=fit.n_states,
        gravity=fit.gravity,
        repeatability=fit.repeatability,
        observability=fit.coverage.observability,
        unobservable=fit.coverage.unobservable,
        most_helpful_attitude=fit.coverage.weakest.words,
        n_dropped=len(fit.dropped),
        iterations=fit.iterations,
    )


def _validity(rests: Sequence[RestState]) -> Validity:
    seen = [r.temperature for r in rests if r.temperature is not None]
    return Validity(temperature_min=min(seen), temperature_max=max(seen)) if seen else Validity()


def decide(
    new: Candidate, old: CalibrationRecord | None, degraded: bool, settings: QualitySettings
) -> Decision:
    """Decide whether `new` replaces `old`: only if it explains held-out rests better, by more than chance.

    Held out are the rests taken since the old one was fitted; the new one meets each of them as a
    fit that left its attitude out. Where the old one has failed its check, its rests being the very
    evidence, `degraded` only asks that the new one is not the worse.
    """
    if old is None or old.accelerometer is None:
        return Decision(True, "the first calibration", {"rms_residual": new.accelerometer.rms_residual})
    found = held_out(new, old.accelerometer.model, old.fitted_at, settings)
    evidence: Evidence = {f"held_out_{name}": value for name, value in asdict(found).items()}
    figures = f"held-out rms {found.rms_new:.2g} after {found.rms_old:.2g} m/s^2 on {found.rests} attitudes"
    if found.better:
        return Decision(True, f"better by more than chance: {figures}", evidence)
    if degraded and found.rests and found.rms_new < found.rms_old:
        return Decision(True, f"the old one failed its check: {figures}", evidence)
    enough = found.rests >= settings.held_out_rests
    return Decision(False, f"not better by more than chance: {figures}", evidence, settled=enough)


def held_out(new: Candidate, old: SensorModel, since: float | None, settings: QualitySettings) -> Comparison:
    """Compare both on the attitudes seen since the old fit (s), which took no part in it.

    The new one meets each attitude as refitted without it. One value an attitude: rests that share one
    are not independent.
    """
    held = new.pool.held
    fresh = np.array([since is None or h.rest.t_start >= since for h in held])
    refitted = _left_out(new, fresh)
    fresh &= np.isfinite(refitted)
    old_residuals, own = quality.norm_residuals(old, held)
    sd = np.hypot(own, new.accelerometer.rms_residual)
    attitudes = [fresh & (new.labels == k) for k in np.unique(new.labels[fresh])]
    old_means, new_means, sd_means = (
        np.array([float(values[a].mean()) for a in attitudes]) for values in (old_residuals, refitted, sd)
    )
    return quality.compare(old_means, new_means, sd_means, settings)


def _left_out(new: Candidate, asked: NDArray[np.bool_]) -> Array:
    """Return residuals (n,) of the rests asked for, each under a fit without its fold of attitudes.

    NaN where the other attitudes do not support a fit, and where none was asked for.
    """
    held, residuals = new.pool.held, np.full(len(new.pool.held), np.nan)
    folds = new.labels % new.settings.folds
    for fold in np.unique(folds[asked]):
        out = folds == fold
        kept = [h for h, left in zip(held, out, strict=True) if not left]
        tested = [h for h, left in zip(held, out, strict=True) if left]
        try:
            fit = _fit_accelerometer(
                kept, new.gravity, new.settings.accelerometer, new.accelerometer.parameters
            )
        except NotSupported:
            continue
        residuals[out] = quality.norm_residuals(fit.model, tested)[0]
    return residuals


def checked(record: CalibrationRecord, recent: Pool, settings: QualitySettings) -> Check:
    """Hold recent rests against a calibration (4.7); it must have an accelerometer part."""
    assert record.accelerometer is not None
    bias = None if record.gyroscope is None else record.gyroscope.bias
    left_open = np.hypot(norm_uncertainty(record.accelerometer), _gravity_change(record, recent))
    return quality.check(record.accelerometer.model, float(left_open), bias, recent.held, settings)


def _gravity_change(record: CalibrationRecord, recent: Pool) -> float:
    """Return the uncertainty (m/s^2) of the gravity fitted to, where the rests know theirs from elsewhere.

    A phone that was calibrated before it knew its place has a scale off by as much as the standard value;
    that is no drift.
    """
    if record.gravity is None or all(h.gravity.source == record.gravity.source for h in recent.held):
        return 0.0
    return record.gravity.uncertainty


def norm_uncertainty(part: AccelerometerRecord) -> float:
    """Return what a calibration leaves open in the norm of a rest, m/s^2.

    The scatter of its own rests; and where it has no cross-axis terms, what these may amount to.
    """
    omitted = _OMITTED_CROSS_AXIS if part.parameters == 6 else 0.0
    return float(np.hypot(part.rms_residual or 0.0, omitted))


def figures(check: Check) -> Evidence:
    """Return a check's figures for the log."""
    return {name: value for name, value in asdict(check).items() if value is not None}
