"""The bias by temperature, learnt from rests and taken up, or dropped, on evidence.

Two regressions of the same rests are compared, with a curve of temperature and without. Both predict each
rest from the rests before it. The curve is taken up where it predicts them better by more than chance, and
dropped where it predicts the newest of them worse by more than chance, by the sign-flip test of the
acceptance rule (Fisher 1935). Rests of the same hour count as one, because they share their errors.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.acceptance import flipped_share
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.record import (
    Acceptance,
    CalibrationRecord,
    Evidence,
    Term,
    TermParameter,
)
from stillcal.calib_core.calibration.terms import POWER_NAMES, force_terms, polynomial
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.forecast import Forecast, thermometer_step
from stillcal.calib_core.temperature.memory import Memory
from stillcal.calib_core.temperature.regression import (
    ACCELEROMETER,
    GYROSCOPE,
    UNIT_K,
    Fit,
    Model,
    Observations,
    Wander,
    learn,
)

LEAST_RESTS = 8
LEAST_SPAN_K = 2.0
"""Fewer rests, or a smaller span of their temperatures, are not learnt from."""

BLOCK_S = 3600.0
NEWEST_BLOCKS = 12
"""Hours with rests that decide whether a curve is dropped."""

_STRICTER = 0.1
"""Of the chance at which a calibration is accepted: the curve is judged anew at every check."""

EFFECTS = {
    Sensor.ACCELEROMETER: ("accel_bias_temperature", "m/s^2"),
    Sensor.GYROSCOPE: ("gyro_bias_temperature", "rad/s"),
}
PRIORS = {Sensor.ACCELEROMETER: ACCELEROMETER, Sensor.GYROSCOPE: GYROSCOPE}
TAKEN_UP, DROPPED = "taken up", "dropped"


@dataclass(frozen=True, slots=True, eq=False)
class Learnt:
    """The result of learning one sensor's bias.

    bias: (3,) at the reference temperature now. scale: (3, 3) or None where it was not learnt. forecast: the
    bias' uncertainty. term: the curve to correct by, None for none. change: "taken up", "dropped" or empty.
    evidence: the figures of that decision.
    """

    sensor: Sensor
    bias: Array
    forecast: Forecast
    term: Term | None
    change: str = ""
    evidence: Evidence | None = None

    def reason(self) -> str:
        """Return the decision on the curve in a sentence."""
        figures = self.evidence or {}
        return (
            f"{self.sensor}: bias by temperature {self.change}: over {figures.get('hours')} hours, its rests "
            f"are predicted with rms {figures.get('rms_with'):.2g} with it, {figures.get('rms_without'):.2g} "
            f"{EFFECTS[self.sensor][1]} without"
        )


def held_term(terms: Iterable[Term], sensor: Sensor) -> Term | None:
    """Return the term by which a sensor's bias is corrected for temperature, None for none."""
    effect, _ = EFFECTS[sensor]
    return next((term for term in terms if term.effect == effect), None)


def learn_gyroscope(
    memory: Memory, record: CalibrationRecord, t: float, settings: QualitySettings
) -> Learnt | None:
    """Learn the gyroscope's bias now (t, s) by temperature; None where there are too few rests with rates."""
    memory = memory.where(np.asarray(np.isfinite(memory.rate).all(axis=1)))
    if len(memory) < LEAST_RESTS:
        return None
    rate = memory.rate - force_terms(record, memory.force)
    middle = frozen(np.median(rate, axis=0))
    level, level_sd = np.ones((len(memory), 1)), np.array([_RATE_SPREAD])
    sd = memory.rate_sd.mean(axis=1)
    seen = Observations(memory.t, memory.celsius, rate - middle, sd, level, level_sd)
    return _learn(Sensor.GYROSCOPE, seen, middle=middle, record=record, t=t, settings=settings)


def learn_accelerometer(
    memory: Memory, model: SensorModel, record: CalibrationRecord | None, t: float, settings: QualitySettings
) -> Learnt | None:
    """Learn the accelerometer's bias now (t, s) by temperature; None where there are too few rests.

    model: a calibration near the true one. A rest shows the bias along gravity only: the norm of its
    calibrated force less local gravity, linear in small changes of bias, scale and curve. record: the
    calibration in use, None before the first.
    """
    if len(memory) < LEAST_RESTS:
        return None
    shifted = memory.force - model.bias
    calibrated = shifted @ model.scale.T
    norm = np.linalg.norm(calibrated, axis=1)
    up = calibrated / norm[:, None]
    towards = -up @ model.scale
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    by_scale = [up[:, a] * shifted[:, b] + (up[:, b] * shifted[:, a] if a != b else 0.0) for a, b in pairs]
    level = np.column_stack((towards, *by_scale))
    level_sd = np.array([_FORCE_SPREAD] * 3 + [_SCALE_SPREAD] * 6)
    sd = np.linalg.norm(towards * memory.force_sd, axis=1)
    value = (memory.gravity - norm)[:, None]
    seen = Observations(memory.t, memory.celsius, value, sd, level, level_sd, towards)
    return _learn(Sensor.ACCELEROMETER, seen, middle=model.bias, record=record, t=t, settings=settings)


_RATE_SPREAD, _FORCE_SPREAD, _SCALE_SPREAD = 0.05, 0.1, 0.01
"""Standard deviations before any rest: of the bias about the rests' median, rad/s, and of a fit that knows
nothing of temperature from the true bias, m/s^2, and scale."""


def _learn(
    sensor: Sensor,
    seen: Observations,
    *,
    middle: Array,
    record: CalibrationRecord | None,
    t: float,
    settings: QualitySettings,
) -> Learnt:
    """Fit with and without a curve, decide which is used, and return what follows.

    middle: (3,) the bias that the observations count from.
    """
    before = None if record is None else record.forecast.get(str(sensor))
    term = None if record is None else held_term(record.terms, sensor)
    known = seen.celsius[np.isfinite(seen.celsius)]
    reference = 25.0 if not known.size else float(np.median(known))
    if term is not None and "temperature" in term.reference:
        reference = term.reference["temperature"]
    model = Model(PRIORS[sensor], reference, with_curve=False)
    start = None if before is None else before.wander
    if known.size <= seen.celsius.size / 2 or np.ptp(known) < LEAST_SPAN_K:
        return _without_evidence(sensor, seen, model, middle=middle, term=term, t=t, start=start)
    without = learn(seen, model, t, start)
    curved = learn(seen, replace(model, with_curve=True), t, start)
    change, evidence = _change(curved, without, seen.t, term is not None, settings)
    applied = change == TAKEN_UP or (term is not None and change != DROPPED)
    fit = curved if applied else without
    forecast = _forecast(fit, curved, seen.celsius, t, applied)
    held = _term(sensor, forecast) if applied else None
    return Learnt(sensor, frozen(middle + fit.coefficients[0]), forecast, held, change, evidence)


def _without_evidence(
    sensor: Sensor,
    seen: Observations,
    model: Model,
    *,
    middle: Array,
    term: Term | None,
    t: float,
    start: Wander | None,
) -> Learnt:
    """Return the bias where temperatures are unknown or all alike: a term that is held stays as it is."""
    if term is not None:
        offset = polynomial(term, seen.celsius)
        along = offset if seen.towards is None else (offset * seen.towards).sum(axis=1)[:, None]
        seen = replace(seen, value=seen.value - along)
    fit = learn(seen, model, t, start)
    forecast = _forecast(fit, None, seen.celsius, t, term is not None)
    return Learnt(sensor, frozen(middle + fit.coefficients[0]), forecast, term)


def _change(
    curved: Fit, without: Fit, t: Array, held: bool, settings: QualitySettings
) -> tuple[str, Evidence]:
    """Return whether the curve is to be taken up or dropped, or nothing, and the figures.

    t: (n,) s, times of the rests. held: whether a curve is in use.
    """
    used = np.ones(len(t), dtype=bool)
    used[[0, *curved.doubted, *without.doubted]] = False
    errors = [(fit.errors**2).mean(axis=1)[used] for fit in (without, curved)]
    gains = (errors[0] - errors[1]) * curved.errors.shape[1] / (2 * curved.errors_sd[used] ** 2)
    _, block = np.unique(np.floor(t[used] / BLOCK_S), return_inverse=True)
    by_block: Array = np.bincount(block, gains).astype(np.float64) if gains.size else np.zeros(0)
    n, limit = by_block.size, settings.chance * _STRICTER
    evidence: Evidence = {"hours": n, "gain": float(by_block.sum())}
    evidence |= {
        f"rms_{name}": float(np.sqrt(e.mean())) if e.size else None
        for name, e in zip(("without", "with"), errors, strict=True)
    }
    if n < settings.held_out_rests:
        return "", evidence
    if held:
        worse = flipped_share(-by_block[-NEWEST_BLOCKS:])
        return (DROPPED if worse <= limit else ""), evidence | {"chance": worse}
    better = flipped_share(by_block)
    return (TAKEN_UP if better <= limit else ""), evidence | {"chance": better}


def _forecast(fit: Fit, curved: Fit | None, celsius: Array, t: float, applied: bool) -> Forecast:
    """Return the uncertainty of a fit's bias, with that of the curve where it is not corrected."""
    known = celsius[np.isfinite(celsius)]
    source = fit if curved is None else curved
    return Forecast(
        at=t,
        reference=fit.model.reference,
        curve=frozen(source.coefficients[1:]),
        covariance=source.covariance,
        white=fit.wander.white,
        flicker=source.wander.flicker,
        walk=source.wander.walk,
        applied=applied,
        temperature_min=float(known.min()) if known.size else None,
        temperature_max=float(known.max()) if known.size else None,
        thermometer_sd=thermometer_step(celsius) / np.sqrt(12.0),
    )


def _term(sensor: Sensor, forecast: Forecast) -> Term:
    """Return the term that corrects a forecast's curve."""
    effect, unit = EFFECTS[sensor]
    sd = np.sqrt(np.diag(forecast.covariance))[3:].reshape(-1, 3)
    parameters = {}
    for power, name in enumerate(POWER_NAMES, start=1):
        by_unit = UNIT_K**-power
        value, reach = forecast.curve[power - 1] * by_unit, 1.96 * sd[power - 1] * by_unit
        ci95 = frozen(np.stack([value - reach, value + reach], axis=1))
        per = "K" if power == 1 else f"K^{power}"
        parameters[name] = TermParameter(value=frozen(value), unit=f"{unit}/{per}", ci95=ci95)
    reference = {"temperature": forecast.reference}
    if forecast.temperature_min is not None and forecast.temperature_max is not None:
        reference |= {
            "temperature_min": forecast.temperature_min,
            "temperature_max": forecast.temperature_max,
        }
    return Term(effect=effect, sensor=sensor, parameters=parameters, reference=reference)


def with_learnt_gyroscope(record: CalibrationRecord, learnt: Learnt, t: float) -> CalibrationRecord:
    """Return a record with the gyroscope's bias, curve and forecast as learnt at t (s).

    The uncertainty of the bias allows for the wander until the next check.
    """
    part = record.gyroscope
    assert part is not None
    covariance = part.covariance
    if covariance is not None and covariance.shape == (12, 12):
        wandering = np.array(covariance)
        wandering[9:, 9:] = np.diag(
            learnt.forecast.bias_uncertainty(t + BLOCK_S, learnt.forecast.reference) ** 2
        )
        covariance = frozen(wandering)
    updated = replace(record, gyroscope=replace(part, bias=learnt.bias, covariance=covariance, zeroed_at=t))
    return with_learnt_term(updated, learnt)


def with_learnt_term(record: CalibrationRecord, learnt: Learnt) -> CalibrationRecord:
    """Return a record with a sensor's curve and forecast as learnt; a decision on the curve is its reason."""
    others = tuple(term for term in record.terms if term.effect != EFFECTS[learnt.sensor][0])
    terms = others if learnt.term is None else (*others, learnt.term)
    forecast = record.forecast | {str(learnt.sensor): learnt.forecast}
    record = replace(record, terms=terms, forecast=forecast)
    if not learnt.change:
        return record
    acceptance = Acceptance(how="terms", reason=learnt.reason(), evidence=learnt.evidence or {})
    return replace(record, acceptance=acceptance)
