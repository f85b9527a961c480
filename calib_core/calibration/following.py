"""The calibration in use brought up to the present: by temperature and time, as all rests kept show it.

The gyroscope's bias is taken as learnt at every check (4.7 of Grammenos et al. 2018 asks for a new one
then). The accelerometer's calibration is replaced by the learnt one under the rules of acceptance.py. The
rests since the old one was fitted are held out from it, and the learnt one predicts each of them from those
before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.accelerometer.parameters import ALL, names
from stillcal.calib_core.accelerometer.six_faces import common_rotation
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.acceptance import (
    MOST_GAIN,
    beyond_doubt,
    clearly_smaller,
    flipped_share,
    stated_uncertainty,
    sums_by_block,
)
from stillcal.calib_core.calibration.bias_curve.evidence import BLOCK_S, NEWEST_HOURS
from stillcal.calib_core.calibration.bias_curve.learn import learn_accelerometer
from stillcal.calib_core.calibration.bias_curve.learnt import Learnt, is_thermal, told_curve
from stillcal.calib_core.calibration.corrections.charging_heat import BY_CHARGING
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.known_faces import inherit_rotation
from stillcal.calib_core.calibration.record import (
    AccelerometerRecord,
    Acceptance,
    CalibrationRecord,
    Evidence,
    Validity,
)
from stillcal.calib_core.calibration.terms import drivers_at, offsets
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.static.rest import ATTITUDE_ANGLE, attitude_labels
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.forecast import Forecast
from stillcal.calib_core.temperature.memory import Memory

STEP_S = 12 * BLOCK_S
"""s: for so long after a step the calibration may be replaced on the evidence of the rests since then."""

LARGEST_KNOCK = 0.5 * STANDARD
"""m/s^2, by axis: ten times the zero offset of data sheets (40 mg, Bosch BMI160)."""

LEAST_KNOWN = 0.25
"""m/s^2: what leaves gravity less certain over all directions is no calibration (see max_prior_sd)."""

_BAD_SHARE = 0.2
"""Share of the rests since a step that may be bad ones. Another phone's scale leaves more that disagree."""

FOLLOWED_GAIN = 3.0
"""nats, odds of 20 to 1, by which the newest hours with rests must be likelier by what is learnt than by the
calibration that was accepted last for the one in use to follow them."""

_RETURNED = Acceptance(
    how="following",
    reason="the accelerometer no longer follows its rests: they are as likely by what was accepted last",
)

_FEW_HOURS = 2
"""Hours with later rests that suffice against a calibration that a prior entered, which assumes more, and for
one to be followed: what a step leaves, the check notices first."""


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """A record with its forecast renewed.

    accepted: whether its calibration of the accelerometer is a new one. centre: the calibration that was
    accepted last, where the one in the record follows the rests since; else None.
    """

    record: CalibrationRecord
    accepted: bool
    centre: CalibrationRecord | None = None


def with_learnt_gyroscope(record: CalibrationRecord, learnt: Learnt, t: float) -> CalibrationRecord:
    """Return a record with the gyroscope's bias, curve and forecast as learnt at t (s).

    The uncertainty of the bias allows for the wander until the next check.
    """
    part, forecast = record.gyroscope, learnt.forecast
    assert part is not None
    covariance = part.covariance
    if covariance is not None and covariance.shape == (12, 12):
        wandering = np.array(covariance)
        wandering[9:, 9:] = np.diag(forecast.at_reference(t + BLOCK_S) ** 2)
        covariance = frozen(wandering)
    updated = replace(record, gyroscope=replace(part, bias=learnt.bias, covariance=covariance, zeroed_at=t))
    updated = _with_term(updated, learnt)
    if not learnt.change:
        return updated
    acceptance = Acceptance(how="terms", reason=learnt.reason, evidence=learnt.evidence)
    return replace(updated, acceptance=acceptance)


def follow_accelerometer(
    record: CalibrationRecord,
    memory: Memory,
    t: float,
    settings: QualitySettings,
    *,
    degraded: bool = False,
    fresh: bool = False,
    centre: CalibrationRecord | None = None,
) -> Followed | None:
    """Learn the accelerometer's calibration at t (s), and replace the one in use where the rules allow it.

    degraded: the one in use has failed its check. fresh: it was fitted just now; the learnt one refines it
    where there is evidence that the bias follows temperature, which the fit knows nothing of. None where
    there are too few rests to learn from. centre: the calibration that was accepted last, where the one in
    use follows the rests since. All that is learnt counts from it, and is compared with it: as a new
    calibration it needs the evidence of the rules of acceptance; until then the one in use follows the rests
    where these are likelier by what is learnt, and is the accepted one where they are not.
    """
    accepted = record if centre is None else _returned(record, centre)
    part = accepted.accelerometer
    if part is None:
        return None
    part = _unturned(part)
    in_use = replace(accepted, terms=record.terms)
    learnt = learn_accelerometer(memory, part.model, in_use, t, settings)
    if learnt is None or learnt.covariance is None:
        return None
    if not _shows_calibration(part, learnt, memory):
        return Followed(with_learnt_forecast(accepted, learnt), False)
    reason, evidence = _accepted(accepted, part, learnt, memory, settings, degraded=degraded, fresh=fresh)
    if not reason and not fresh:
        reason, evidence = _stepped(accepted, part, learnt, memory, t)
    replaced = partial(_replaced, record, part, learnt=learnt, memory=memory)
    if reason:
        return Followed(replaced(t=t, acceptance=Acceptance(reason=reason, evidence=evidence)), True)
    lately = _held_out(accepted, part, learnt, memory).by_hour[-NEWEST_HOURS:]
    gain = float(np.minimum(lately, MOST_GAIN).sum())
    if fresh or lately.size < _FEW_HOURS or gain <= FOLLOWED_GAIN:
        kept = accepted if centre is None else replace(accepted, acceptance=_RETURNED)
        return Followed(with_learnt_forecast(kept, learnt), False)
    why = f"the accelerometer follows its rests: {gain:.1f} nats likelier than by what was accepted last"
    following = Acceptance(how="following", reason=why, evidence={"gain": gain})
    followed = replaced(t=record.fitted_at, acceptance=following)
    return Followed(_checked_as(followed, part), False, accepted)


def _shows_calibration(part: AccelerometerRecord, learnt: Learnt, memory: Memory) -> bool:
    """Tell whether what was learnt is a calibration: rests that contradict each other show none."""
    try:
        stated = stated_uncertainty(_part(part, learnt, memory))
    except ValueError:  # its scale is no sensor's
        return False
    missed = float(np.median(learnt.errors[_since_step(learnt)]))
    knocked = np.abs(learnt.bias - part.bias).max() <= LARGEST_KNOCK
    return stated is not None and max(stated, missed) <= LEAST_KNOWN and bool(knocked)


def _since_step(learnt: Learnt) -> NDArray[np.bool_]:
    """Tell which rests (n,) have come since the newest step of the bias."""
    return np.asarray(learnt.t >= max(learnt.steps, default=-np.inf))


def _checked_as(record: CalibrationRecord, part: AccelerometerRecord) -> CalibrationRecord:
    """Return a record whose accelerometer is checked as strictly as another calibration of it."""
    own = record.accelerometer
    if own is None or own.rms_residual is None or part.rms_residual is None:
        return record
    strict = replace(own, rms_residual=min(own.rms_residual, part.rms_residual))
    return replace(record, accelerometer=strict)


def _returned(record: CalibrationRecord, centre: CalibrationRecord) -> CalibrationRecord:
    """Return a record with the accelerometer's calibration and terms of another one."""
    accel = Sensor.ACCELEROMETER
    terms = (
        *(term for term in record.terms if term.sensor != accel),
        *(term for term in centre.terms if term.sensor == accel),
    )
    return replace(
        record,
        accelerometer=centre.accelerometer,
        fitted_at=centre.fitted_at,
        validity=centre.validity,
        terms=terms,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _HeldOut:
    """Rests since a calibration was fitted: by it, and by what is learnt, from the rests before each.

    old, new: (n,) m/s^2, by how much norms are off. by_hour: what the learnt one gains in each hour with
    rests, nats.
    """

    old: Array
    new: Array
    by_hour: Array


def _held_out(
    record: CalibrationRecord, part: AccelerometerRecord, learnt: Learnt, memory: Memory
) -> _HeldOut:
    """Compare a calibration in use with what is learnt, on the rests since it was fitted.

    Rests before the bias stepped say nothing of what holds after it.
    """
    since = -np.inf if record.fitted_at is None else record.fitted_at
    held_out = (learnt.t > since) & _since_step(learnt)
    old, new = np.abs(_residuals(record, part, memory))[held_out], learnt.errors[held_out]
    gains = (old**2 - new**2) / (2 * learnt.errors_sd[held_out] ** 2)
    _, block = np.unique(np.floor(learnt.t[held_out] / BLOCK_S), return_inverse=True)
    return _HeldOut(old, new, sums_by_block(block, gains))


def _accepted(
    record: CalibrationRecord,
    part: AccelerometerRecord,
    learnt: Learnt,
    memory: Memory,
    settings: QualitySettings,
    *,
    degraded: bool,
    fresh: bool,
) -> tuple[str, Evidence]:
    """Return why the learnt calibration replaces the one in use, empty where it does not, and the figures."""
    if fresh:
        kept = record.acceptance
        return (kept.reason, kept.evidence) if learnt.term is not None else ("", {})
    held_out = _held_out(record, part, learnt, memory)
    by_hour = held_out.by_hour
    doubtless = beyond_doubt(by_hour)
    enough = by_hour.size >= (_FEW_HOURS if part.with_prior else settings.held_out_rests)
    if not enough and not doubtless:
        return "", {}
    rms_old, rms_new = (rms(values) for values in (held_out.old, held_out.new))
    chance = flipped_share(by_hour)
    evidence: Evidence = {"hours": by_hour.size, "chance": chance, "rms_old": rms_old, "rms_new": rms_new}
    figures = f"held-out rms {rms_new:.2g} after {rms_old:.2g} m/s^2 over {by_hour.size} hours"
    if chance <= settings.chance or doubtless:
        return f"better by more than chance: {figures}", evidence
    if degraded and rms_new < rms_old:
        return f"the old one failed its check: {figures}", evidence
    not_worse = flipped_share(-by_hour) > settings.chance
    if not_worse and clearly_smaller(_part(part, learnt, memory), part):
        return f"as good and less uncertain: {figures}", evidence
    return "", evidence


def _stepped(
    record: CalibrationRecord, part: AccelerometerRecord, learnt: Learnt, memory: Memory, t: float
) -> tuple[str, Evidence]:
    """Return why the learnt calibration replaces the one in use after a step of its bias.

    Few rests suffice where they leave no doubt. Each is predicted from those before it. A bias that steps
    again and again, or after which rests disagree with each other, is not that of a phone that was knocked:
    for such a one a full calibration has to be found.
    """
    steps = [step for step in learnt.steps if t - step <= STEP_S]
    if not steps or max(steps) - min(steps) > BLOCK_S:
        return "", {}
    stepped = max(steps)
    since = stepped if record.fitted_at is None else max(stepped, record.fitted_at)
    after = learnt.t > since
    old, new, sd = _residuals(record, part, memory)[after], learnt.errors[after], learnt.errors_sd[after]
    gains = (old**2 - new**2) / (2 * sd**2)
    disagreeing = sum(t_doubted > since for t_doubted in learnt.doubted)
    if not beyond_doubt(gains) or disagreeing > _BAD_SHARE * int(after.sum()):
        return "", {}
    n = int(after.sum())
    evidence: Evidence = {"stepped_at": stepped, "rests": n, "gain": float(gains.sum())}
    return f"the bias stepped at {stepped:.0f} s, as {n} rests since then show", evidence


def _residuals(record: CalibrationRecord, part: AccelerometerRecord, memory: Memory) -> Array:
    """Return the calibrated norm of every rest less local gravity, (n,) m/s^2, terms included."""
    offset = offsets(record, Sensor.ACCELEROMETER, drivers_at(record, Sensor.ACCELEROMETER, memory))
    norm = np.linalg.norm(part.model.apply(memory.force - offset), axis=1)
    return np.asarray(norm - memory.gravity)


def with_learnt_forecast(record: CalibrationRecord, learnt: Learnt) -> CalibrationRecord:
    """Return a record whose bias and terms stay, with the uncertainty that what was learnt leaves them."""
    forecast, bias = learnt.forecast, record.model(learnt.sensor).bias
    error = np.vstack((learnt.bias + forecast.error[0] - bias, forecast.curve))
    for term in record.terms:
        if is_thermal(term, learnt.sensor) and (term.effect == BY_CHARGING) == forecast.by_charger:
            error = error - told_curve(term)
    return _with_forecast(record, learnt.sensor, replace(forecast, error=frozen(error)))


def _replaced(
    record: CalibrationRecord,
    part: AccelerometerRecord,
    *,
    learnt: Learnt,
    memory: Memory,
    t: float | None,
    acceptance: Acceptance,
) -> CalibrationRecord:
    """Return the record with the learnt calibration of the accelerometer; a decision on its curve is said.

    t: s, since when it counts as fitted.
    """
    if learnt.change:
        acceptance = replace(acceptance, reason=f"{acceptance.reason}; {learnt.reason}")
    low, high = learnt.forecast.temperature_min, learnt.forecast.temperature_max
    updated = replace(
        record,
        accelerometer=_part(part, learnt, memory),
        fitted_at=t,
        validity=Validity(temperature_min=low, temperature_max=high),
        acceptance=acceptance,
    )
    turned = inherit_rotation(record, updated).accelerometer
    return _with_term(replace(updated, accelerometer=turned), learnt)


def _unturned(part: AccelerometerRecord) -> AccelerometerRecord:
    """Return a calibration without the rotation common to all axes, which rests alone do not show."""
    if part.parameters != ALL:
        return part
    return replace(part, scale=common_rotation(part.scale).T @ part.scale)


def _part(part: AccelerometerRecord, learnt: Learnt, memory: Memory) -> AccelerometerRecord:
    """Return the accelerometer's record as learnt: nine parameters, from all rests kept."""
    labels = attitude_labels(memory.force, ATTITUDE_ANGLE)
    nine = part.parameters == 9
    return replace(
        part,
        scale=frozen(part.scale + learnt.scale_change),
        bias=learnt.bias,
        parameters=9,
        names=names(9),
        covariance=learnt.covariance,
        rms_residual=_scatter(learnt),
        n_rests=len(memory),
        n_states=int(labels.max()) + 1,
        observability=part.observability if nine else None,
        unobservable=part.unobservable,
        n_dropped=0,
        iterations=None,
        with_prior=part.with_prior and int(labels.max()) + 1 <= 9,
    )


def _scatter(learnt: Learnt) -> float:
    """Return how far the newest half of the rests are from their predictions, m/s^2 (root mean square).

    Each counts by how well it was predicted: right after a step of the bias next to nothing is known of it,
    and what is missed then is no scatter of rests. Doubted rests are left out, as in the fit.
    """
    newest = np.arange(len(learnt.t)) >= len(learnt.t) // 2
    used = newest & ~np.isin(learnt.t, learnt.doubted)
    rows = used if used.any() else newest
    weights = learnt.errors_sd[rows] ** -2.0
    return float(np.sqrt(np.average(learnt.errors[rows] ** 2, weights=weights)))


def _with_term(record: CalibrationRecord, learnt: Learnt) -> CalibrationRecord:
    """Return a record with a sensor's curve and forecast as learnt."""
    others = tuple(term for term in record.terms if not is_thermal(term, learnt.sensor))
    terms = others if learnt.term is None else (*others, learnt.term)
    return _with_forecast(replace(record, terms=terms), learnt.sensor, learnt.forecast)


def _with_forecast(record: CalibrationRecord, sensor: Sensor, forecast: Forecast) -> CalibrationRecord:
    return replace(record, forecast=record.forecast | {str(sensor): forecast})
