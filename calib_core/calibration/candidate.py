"""A full calibration fitted to the rests gathered so far, and the gyroscope's bias measured anew at rest.

This module puts the estimators of both sensors together and writes what they return into a record; it has no
formula of its own for either sensor. Whether a candidate replaces the calibration in use is decided in
acceptance.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.accelerometer import fit as accelerometer
from stillcal.calib_core.accelerometer.fit import AccelerometerFit, AccelerometerSettings
from stillcal.calib_core.accelerometer.prior import SOUND_PHONES, FleetPrior
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.constancy import Change, find_change, norm_jacobian
from stillcal.calib_core.calibration.record import (
    AccelerometerRecord,
    Acceptance,
    CalibrationRecord,
    GyroscopeRecord,
    Provenance,
    StateRecord,
    Validity,
)
from stillcal.calib_core.calibration.rest_pool import HeldRest, Pool
from stillcal.calib_core.calibration.terms import compensated
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.gyroscope import fit as gyroscope
from stillcal.calib_core.gyroscope.bias import BiasEstimate, bias_from_rests, rotation_admitted, update_bias
from stillcal.calib_core.gyroscope.fit import GyroscopeFit, GyroscopeSettings, Parameters
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegment
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState, attitude_labels, force_uncertainties, forces
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.forecast import Forecast

_PARAMETER_COUNT = {Parameters.BIAS: 3, Parameters.SCALE3: 6, Parameters.FULL9: 12}
_GYRO_NAMES = (*(f"S_{a}{b}" for a in "xyz" for b in "xyz"), "b_x", "b_y", "b_z")


ASSUMED_SCATTER = 0.01
"""m/s^2: the scatter of a phone's attitudes (AccelerometerSettings), for where nothing is left to show it."""


@dataclass(frozen=True, slots=True)
class CalibrateSettings:
    """The settings of both estimators. folds: number of parts, at most, that attitudes are held out in."""

    accelerometer: AccelerometerSettings = field(default_factory=AccelerometerSettings)
    gyroscope: GyroscopeSettings = field(default_factory=GyroscopeSettings)
    folds: int = 30

    def __post_init__(self) -> None:
        if self.folds < 2:
            raise ValueError(f"folds = {self.folds}: must be 2 or more")


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A calibration that was fitted and is not accepted yet.

    pool: the rests and rotation segments it was fitted to. labels: (n,) number of the attitude that each rest
    of the pool is in. change: how the bias changes among them, None where it does not show; the record's
    covariance allows for it.
    """

    record: CalibrationRecord
    accelerometer: AccelerometerFit
    gyroscope: GyroscopeFit | None
    pool: Pool
    settings: CalibrateSettings
    labels: NDArray[np.intp]
    change: Change | None = None

    @property
    def gravity(self) -> Gravity:
        """The local gravity where the phone was when the candidate was fitted."""
        return self.record.gravity or Gravity()


def fit_candidate(
    pool: Pool,
    gravity: Gravity,
    t: float,
    settings: CalibrateSettings,
    known: CalibrationRecord | None = None,
) -> Candidate:
    """Fit both sensors to a pool of rests at sample time t (s), under the present local gravity.

    known: the calibration whose terms the new one keeps. The rests are corrected by them first, so that its
    biases are those at the terms' reference temperature. Where there is none that stands on its rests alone,
    what is known of sound phones helps where the attitudes do not suffice.

    Raises NotSupported where the rests do not support an accelerometer fit. Where they do not support a
    gyroscope fit, the record has the gyroscope's bias alone, or no gyroscope part.
    """
    known = _usable(known, pool)
    steady = pool if known is None else compensated(pool, known)
    prior = SOUND_PHONES if _is_first(known) else None
    fit = fit_accelerometer(steady.held, gravity, settings.accelerometer, prior=prior)
    change = find_change(fit, steady.held)
    gyro = fit_gyroscope(replace(pool, turns=steady.turns), fit.model, gravity.value, settings.gyroscope)
    labels = attitude_labels(forces(pool.rests), settings.accelerometer.attitude_angle)
    record = CalibrationRecord(
        accelerometer=accelerometer_record(fit, change, forces(steady.rests)),
        gyroscope=None
        if gyro is None
        else _at_reference(gyroscope_record(gyro, t, pool.turns), steady, known),
        gravity=gravity,
        fitted_at=t,
        validity=validity_of(pool.rests),
        provenance=Provenance(t_start=pool.rests[0].t_start, t_end=pool.rests[-1].t_end),
        states=tuple(
            StateRecord.of(rest, float(residual), int(label))
            for rest, residual, label in zip(pool.rests, fit.residuals, labels, strict=True)
        ),
        terms=() if known is None else known.terms,
        forecast={} if known is None else _unfollowed(known),
    )
    return Candidate(record, fit, gyro, pool, settings, labels, change)


def _is_first(known: CalibrationRecord | None) -> bool:
    """Tell whether there is no calibration yet that stands on its rests alone."""
    return known is None or known.accelerometer is None or known.accelerometer.with_prior


def _unfollowed(known: CalibrationRecord) -> dict[str, Forecast]:
    """Return the forecasts by which a bias moves with a temperature that is not followed now.

    They stand until the bias of the new calibration is learnt. Other forecasts are of the old bias alone.
    """
    return {
        sensor: forecast
        for sensor, forecast in known.forecast.items()
        if forecast.unfollowed_since is not None
    }


def _usable(known: CalibrationRecord | None, pool: Pool) -> CalibrationRecord | None:
    """Return a record without the terms that need a temperature where no rest has one."""
    if known is None or any(rest.temperature is not None for rest in pool.rests):
        return known
    return replace(known, terms=tuple(term for term in known.terms if "temperature" not in term.reference))


def _at_reference(part: GyroscopeRecord, steady: Pool, known: CalibrationRecord | None) -> GyroscopeRecord:
    """Return a gyroscope's record with the bias that its terms count from, where it has any.

    The fit itself takes off what force adds.
    """
    terms = () if known is None else known.terms
    by_force = "gyro_g_sensitivity"
    if not any(term.sensor == Sensor.GYROSCOPE and term.effect != by_force for term in terms):
        return part
    return replace(part, bias=bias_from_rests(steady.rests).bias)


def fit_accelerometer(
    held: Sequence[HeldRest],
    gravity: Gravity,
    settings: AccelerometerSettings,
    parameters: int | None = None,
    prior: FleetPrior | None = None,
) -> AccelerometerFit:
    """Fit the accelerometer to rests, each with the gravity of its own place.

    parameters: 6, 9 or 12; None takes the largest model that the attitudes support, with a prior if one is
    given and needed. Raises NotSupported.
    """
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
        prior=prior,
    )


def gyroscope_record(fit: GyroscopeFit, t: float, turns: Sequence[RotationSegment] = ()) -> GyroscopeRecord:
    """Return the record of a gyroscope fit to turns, made at sample time t (s).

    The covariance of the bias is that of a single rest: the bias wanders on between rests.
    """
    n_segments = len(fit.after) - len(fit.rejected)
    return GyroscopeRecord(
        scale=fit.model.scale,
        bias=fit.model.bias,
        parameters=_PARAMETER_COUNT[fit.parameters],
        names=_GYRO_NAMES,
        covariance=with_wander(fit.covariance, fit.bias),
        rms_residual=fit.rms_after if n_segments else None,
        rms_nominal=fit.rms_before if n_segments else None,
        n_rests=fit.bias.n_rests,
        n_turns=n_segments,
        rotation_admitted=_nan_where_unbounded(fit.bias.undetected_rotation_bound),
        missing=fit.missing,
        zeroed_at=t,
        turn_powers=_turn_powers(turns) if n_segments else None,
    )


_LEAST_TURNED = 0.1
"""rad^2, of all turns about an axis: less shows nothing of its scale."""


def _turn_powers(turns: Sequence[RotationSegment]) -> Array:
    """Return the integrals of the rate's square and cube, by those of the rate: a regression over turns."""
    angles = np.zeros((3, len(turns), 3))
    for k, turn in enumerate(turns):
        assert turn.before.rate is not None and turn.after.rate is not None, "a segment has both"
        rate = turn.rates - 0.5 * (turn.before.rate + turn.after.rate)
        for power in (1, 2, 3):
            own = rate**power
            angles[power - 1, k] = 0.5 * np.diff(turn.t) @ (own[1:] + own[:-1])
    turned = (angles[0] ** 2).sum(axis=0)
    by = (angles[1:] * angles[0]).sum(axis=1) / np.maximum(turned, _LEAST_TURNED)
    return frozen(np.where(turned >= _LEAST_TURNED, by, 0.0))


def with_updated_bias(record: CalibrationRecord, recent: Pool, t: float) -> CalibrationRecord | None:
    """Return the record with the gyroscope's bias measured anew on recent rests at sample time t (s).

    Grammenos et al. 2018, 4.7; a zero angular rate update. A record without a gyroscope part gets one with
    the nominal scale. None where no rest has a gyroscope mean.
    """
    model = SensorModel.identity() if record.gyroscope is None else record.gyroscope.model
    try:
        new_model, estimate = update_bias(model, recent.rests)
    except NotSupported:
        return None
    known = record.gyroscope or GyroscopeRecord(scale=model.scale, bias=model.bias, parameters=3)
    part = replace(
        known,
        bias=new_model.bias,
        covariance=with_wander(known.covariance, estimate),
        rotation_admitted=_nan_where_unbounded(estimate.undetected_rotation_bound),
        zeroed_at=t,
    )
    n = estimate.n_rests
    reason = f"gyroscope bias measured on {n} rest{'' if n == 1 else 's'}"
    return replace(record, gyroscope=part, acceptance=Acceptance(how="zeroing", reason=reason))


def with_rotation_bound(record: CalibrationRecord, held: Pool) -> CalibrationRecord:
    """Return a record whose bound on rotation in the gyroscope's bias goes by all rests held, too."""
    part, steady = record.gyroscope, compensated(held, record).rests
    if part is None or part.rotation_admitted is None or not any(rest.rate is not None for rest in steady):
        return record
    own = np.nan_to_num(part.rotation_admitted, nan=np.inf)
    bound = _nan_where_unbounded(rotation_admitted(part.bias, own, steady))
    return replace(record, gyroscope=replace(part, rotation_admitted=bound))


def inherit_scale(old: CalibrationRecord | None, new: CalibrationRecord) -> CalibrationRecord:
    """Return a new calibration with the gyroscope's scale of the old one, where that knows more of it.

    Rotation segments come seldom and are forgotten in time. Where those at hand do not show a scale any more,
    the one measured earlier is better than none.
    """
    known = None if old is None else old.gyroscope
    part = new.gyroscope
    if known is None or part is None or known.parameters <= part.parameters:
        return new
    covariance = known.covariance
    if covariance is not None and part.covariance is not None and covariance.shape == (12, 12):
        kept = np.array(covariance)
        kept[9:, 9:] = part.covariance[9:, 9:]
        covariance = frozen(kept)
    scaled = replace(
        known,
        bias=part.bias,
        covariance=covariance,
        n_rests=part.n_rests,
        rotation_admitted=part.rotation_admitted,
        zeroed_at=part.zeroed_at,
    )
    return replace(new, gyroscope=scaled)


def fit_gyroscope(
    pool: Pool, accel: SensorModel, gravity: float, settings: GyroscopeSettings
) -> GyroscopeFit | None:
    """Fit the gyroscope under the accelerometer's model; None where no rest has a gyroscope mean."""
    try:
        return gyroscope.fit(pool.turns, accel, gravity, rests=pool.rests, settings=settings)
    except NotSupported:
        return None


def accelerometer_record(fit: AccelerometerFit, change: Change | None, raw: Array) -> AccelerometerRecord:
    """Return the record of a fit to raw forces (n, 3), whose covariance holds what the fit could not see.

    That is a bias that changed, and, where there are no more attitudes than parameters, the scatter that no
    residual is left to show.
    """
    covariance = np.array(fit.total_covariance)
    if change is not None:
        covariance += change.covariance
    if fit.n_states <= fit.parameters and not fit.with_prior:
        covariance += ASSUMED_SCATTER**2 * np.linalg.pinv(_normal_matrix(fit, raw))
    return AccelerometerRecord(
        scale=fit.model.scale,
        bias=fit.model.bias,
        parameters=fit.parameters,
        names=fit.names,
        covariance=frozen(covariance),
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
        with_prior=fit.with_prior,
    )


def _normal_matrix(fit: AccelerometerFit, raw: Array) -> Array:
    design, _ = norm_jacobian(fit, raw[fit.used])
    return np.asarray(design.T @ design)


def validity_of(rests: Sequence[RestState]) -> Validity:
    """Return the range of temperatures of rests."""
    temperatures = [r.temperature for r in rests if r.temperature is not None]
    if not temperatures:
        return Validity()
    return Validity(temperature_min=min(temperatures), temperature_max=max(temperatures))


def with_wander(covariance: Array | None, bias: BiasEstimate) -> Array | None:
    """Return a gyroscope's covariance (12, 12) with its bias as uncertain as a single rest leaves it.

    The mean over all rests is known better than that, but the bias is used between the rests, where it
    wanders on. A covariance that does not hold the bias is returned as it is.
    """
    if covariance is None or covariance.shape != (12, 12):
        return covariance
    wandering = np.array(covariance)
    wandering[9:, 9:] = bias.covariance + np.diag(bias.wander**2)
    return frozen(wandering)


def _nan_where_unbounded(values: Array) -> Array:
    """Return values with NaN, which a record reads as unknown, where nothing bounds them."""
    return frozen(np.where(np.isfinite(values), values, np.nan))
