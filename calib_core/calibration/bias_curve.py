"""The bias by temperature, learnt from rests and taken up, or dropped, on evidence.

Where there is no thermometer, the charger stands in for one (driver.py): a curve is then a straight line of
the heat of charging.

Two regressions of the same rests are compared, with a curve of temperature and without. Both predict each
rest from the rests before it. The curve is taken up where it predicts them better by more than chance, and
dropped where it predicts the newest of them worse by more than chance, by the sign-flip test of the
acceptance rule (Fisher 1935). Rests of the same hour count as one, because they share their errors.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.acceptance import (
    ENOUGH_GAIN,
    MOST_GAIN,
    beyond_doubt,
    flipped_share,
    sums_by_block,
)
from stillcal.calib_core.calibration.corrections.base import REACH_OF_95
from stillcal.calib_core.calibration.corrections.bias_temperature import POWER_NAMES
from stillcal.calib_core.calibration.corrections.charging_heat import BY_CHARGING
from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.driver import Driver, by_charger, by_thermometer
from stillcal.calib_core.calibration.record import CalibrationRecord, Evidence
from stillcal.calib_core.calibration.terms import drivers_at, offsets, polynomial, terms_uncertainty
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.breaks import BREAK, HIDDEN, learn
from stillcal.calib_core.temperature.charger import FULL_K
from stillcal.calib_core.temperature.forecast import UNSEEN_S, Forecast
from stillcal.calib_core.temperature.memory import MAX_AGE_S, Memory
from stillcal.calib_core.temperature.regression import (
    ACCELEROMETER,
    GYROSCOPE,
    POWERS,
    UNIT_K,
    Fit,
    Model,
    Observations,
    Priors,
    averaged,
)
from stillcal.calib_core.temperature.wander import Spans

LEAST_RESTS = 8
"""Fewer rests show too little of the accelerometer, of which each shows one direction only."""

LEAST_SPAN_K = 2.0
"""No curve is learnt from a smaller span of temperatures."""

BLOCK_S = 3600.0
NEWEST_HOURS = 12
"""Newest hours with rests that must support a curve for it to be taken up, and that decide whether it is
dropped."""

MATTERS = 1.2
"""A curve is dropped only where it makes the errors larger by this: at one temperature it makes none."""

_BAD = 3.0
"""A rest that misses its prediction by more usual errors than these counts as one that misses by these."""

_STRICTER = 0.1
"""Of the chance at which a calibration is accepted: whether to take a curve up is judged at every check."""

EFFECTS = {
    Sensor.ACCELEROMETER: ("accel_bias_temperature", "m/s^2"),
    Sensor.GYROSCOPE: ("gyro_bias_temperature", "rad/s"),
}
PRIORS = {Sensor.ACCELEROMETER: ACCELEROMETER, Sensor.GYROSCOPE: GYROSCOPE}
TAKEN_UP, DROPPED = "taken up", "dropped"
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Row and column of the scale's entries, in the order of a record's nine parameters."""


@dataclass(frozen=True, slots=True, eq=False)
class Learnt:
    """The result of learning one sensor's bias.

    bias: (3,) at the reference temperature now, and scale_change (3, 3), to be added. forecast: of this bias
    with this term. term: the curve to correct by, None for none. change: "taken up", "dropped" or empty.
    evidence: the figures of that decision. covariance: (9, 9) of bias and scale, as an accelerometer's record
    has it, else None. t, errors, errors_sd: (n,) times of the rests, s, errors of predicting each from those
    before it, and standard uncertainties of the predictions. steps: s, the rests at which the bias stepped.
    doubted: s, the rests that disagree with those before and after them. doubt: why the readings that a curve
    followed are believed no longer, empty where that is not why it was dropped.
    """

    sensor: Sensor
    bias: Array
    scale_change: Array
    forecast: Forecast
    term: Term | None
    change: str
    evidence: Evidence
    covariance: Array | None
    t: Array
    errors: Array
    errors_sd: Array
    steps: tuple[float, ...] = ()
    doubted: tuple[float, ...] = ()
    doubt: str = ""

    @property
    def reason(self) -> str:
        """The decision on the curve in a sentence."""
        figures, unit = self.evidence, EFFECTS[self.sensor][1]
        driver = "charging" if self.forecast.by_charger else "temperature"
        if self.doubt:
            return f"{self.sensor}: bias by {driver} {self.change}: {self.doubt}"
        return (
            f"{self.sensor}: bias by {driver} {self.change}: over {figures['hours']} hours, rests "
            f"are typically predicted to {figures['typical_with']:.2g} {unit} with it, "
            f"to {figures['typical_without']:.2g} without"
        )


def is_thermal(term: Term, sensor: Sensor) -> bool:
    """Tell whether a term corrects a sensor's bias for temperature, or for the heat of charging."""
    return term.effect == EFFECTS[sensor][0] or (term.effect == BY_CHARGING and term.sensor == sensor)


def held_term(terms: Iterable[Term], sensor: Sensor) -> Term | None:
    """Return the term by which a sensor's bias is corrected for temperature, None for none."""
    return next((term for term in terms if is_thermal(term, sensor)), None)


def learn_gyroscope(
    memory: Memory, record: CalibrationRecord, t: float, settings: QualitySettings
) -> Learnt | None:
    """Learn the gyroscope's bias now (t, s) by temperature; None where no rest has a rate."""
    memory = memory.where(np.asarray(np.isfinite(memory.rate).all(axis=1)))
    if not len(memory):
        return None
    memory = _without_others(memory, record, Sensor.GYROSCOPE)
    rate = memory.rate
    middle = frozen(np.median(rate, axis=0))
    level, level_sd = np.ones((len(memory), 1)), np.array([_RATE_SPREAD])
    sd = memory.rate_sd.mean(axis=1)
    known = (memory.t, memory.celsius, rate - middle, sd, level, level_sd)
    seen = Observations(*known, spans=Spans(memory.t))
    return _learn(Sensor.GYROSCOPE, seen, memory, middle=middle, record=record, t=t, settings=settings)


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
    if record is not None:
        memory = _without_others(memory, record, Sensor.ACCELEROMETER)
    value, level, towards = _norms(np.zeros((len(memory), 3)), memory, model)
    level_sd = _level_spread(record, value)
    sd = np.linalg.norm(towards * memory.force_sd, axis=1)
    linear = partial(_norms, memory=memory, model=model)
    known = (memory.t, memory.celsius, value, sd, level, level_sd, towards)
    seen = Observations(*known, linear=linear, spans=Spans(memory.t))
    middle = model.bias
    return _learn(Sensor.ACCELEROMETER, seen, memory, middle=middle, record=record, t=t, settings=settings)


def _without_others(memory: Memory, record: CalibrationRecord, sensor: Sensor) -> Memory:
    """Return rests without those terms of a sensor that are not learnt here, as uncertain as these are."""
    others = replace(record, terms=tuple(term for term in record.terms if not is_thermal(term, sensor)))
    at = drivers_at(record, sensor, memory)
    offset, doubt = offsets(others, sensor, at), terms_uncertainty(others, sensor, at)
    if sensor is Sensor.GYROSCOPE:
        less = frozen(memory.rate - offset)
        return replace(memory, rate=less, rate_sd=frozen(np.hypot(memory.rate_sd, doubt)))
    less = frozen(memory.force - offset)
    return replace(memory, force=less, force_sd=frozen(np.hypot(memory.force_sd, doubt)))


def _norms(biases: Array, memory: Memory, model: SensorModel) -> tuple[Array, Array, Array]:
    """Return what rests show of a calibration that is near a model with biases (n, 3) in excess of its own.

    The result is local gravity less the calibrated norm, (n, 1), linear in the bias in excess; its
    derivatives by bias and scale, (n, 9); and those by the bias alone, (n, 3).
    """
    shifted = memory.force - model.bias - biases
    calibrated = shifted @ model.scale.T
    norm = np.linalg.norm(calibrated, axis=1)
    up = calibrated / norm[:, None]
    towards = -up @ model.scale
    by_scale = [up[:, a] * shifted[:, b] + (up[:, b] * shifted[:, a] if a != b else 0.0) for a, b in _PAIRS]
    value = memory.gravity - norm + (towards * biases).sum(axis=1)
    return value[:, None], np.column_stack((towards, *by_scale)), towards


_RATE_SPREAD, _FORCE_SPREAD, _SCALE_SPREAD = 0.05, 0.1, 0.01
"""Standard deviations before any rest: of the bias about the rests' median, rad/s, and of a fit that knows
nothing of temperature from the true bias, m/s^2, and scale."""


_FIRST = 8
"""Oldest rests, whose median says how far the bias was from that of now when the memory begins."""


def _level_spread(record: CalibrationRecord | None, value: Array) -> Array:
    """Return how far the parameters of a calibration in use may be off, (9,), bias first.

    value: (n, 1) what rests show, oldest first. One that a prior entered is known badly along some
    directions, and says so.
    """
    shown = HIDDEN * float(np.median(np.abs(value[:_FIRST])))
    usual = np.array([max(_FORCE_SPREAD, shown)] * 3 + [_SCALE_SPREAD] * 6)
    part = None if record is None else record.accelerometer
    if part is None or not part.with_prior or part.covariance is None:
        return usual
    return np.asarray(np.maximum(usual, np.sqrt(np.diag(part.covariance))))


def _learn(
    sensor: Sensor,
    seen: Observations,
    memory: Memory,
    *,
    middle: Array,
    record: CalibrationRecord | None,
    t: float,
    settings: QualitySettings,
) -> Learnt:
    """Learn by the thermometer, or by the charger where no curve can follow the thermometer now.

    A term that follows the charger stays until one that follows the thermometer is taken up, and the other
    way round. middle: (3,) the bias that the observations count from.
    """
    thermometer, charger = by_thermometer(memory), by_charger(memory)
    term = None if record is None else held_term(record.terms, sensor)
    before = None if record is None else record.forecast.get(str(sensor))
    learn_by = partial(
        _learn_by, sensor, seen, term=term, before=before, middle=middle, t=t, settings=settings
    )
    if term is not None and charger.drives(term):
        learnt = learn_by(thermometer) if thermometer.mostly_known else None
        learnt = learnt if learnt is not None and learnt.change == TAKEN_UP else learn_by(charger)
    elif term is None and not thermometer.mostly_known and charger.mostly_known:
        learnt = learn_by(charger)
    else:
        learnt = learn_by(thermometer)
        doubted = learnt.term is None and before is not None and before.unfollowed_since is not None
        if charger.mostly_known and (thermometer.silent or learnt.doubt or doubted):
            charged = learn_by(charger)
            learnt = charged if charged.change == TAKEN_UP else learnt
    return _with_unseen(_with_unfollowed(learnt, thermometer, term=term, before=before, t=t), memory)


_USUAL_RESTS = 2
"""Rests after a time without one that are taken to have been off as stated, before any other are met."""


def _with_unseen(learnt: Learnt, memory: Memory) -> Learnt:
    """Return what was learnt, with how far off rests were that came after a time without one.

    A phone that is in use shows no rest, and warms up: what rests say of each other is too certain there.
    The first rest after it still shows most of that.
    """
    after = memory.since[1:] >= UNSEEN_S
    off = np.minimum(np.abs(learnt.errors / learnt.errors_sd)[1:][after], BREAK)
    mean_square = (_USUAL_RESTS + float((off**2).sum())) / (_USUAL_RESTS + off.size)
    forecast = replace(learnt.forecast, rested_at=float(memory.t[-1]), unseen=max(mean_square, 1.0) ** 0.5)
    return replace(learnt, forecast=forecast)


def _with_unfollowed(
    learnt: Learnt, thermometer: Driver, *, term: Term | None, before: Forecast | None, t: float
) -> Learnt:
    """Return what was learnt, as uncertain as the bias moves with a temperature that is followed no longer.

    A reading that is missing or doubted says nothing against the rests that showed the curve. They count
    until a curve is followed again, or for as long as the memory would keep them. term, before: in use.
    """
    known_now = bool(np.isfinite(thermometer.read[-1]))
    if before is None or (known_now and learnt.term is not None and thermometer.drives(learnt.term)):
        return learnt
    size, since = before.unfollowed, before.unfollowed_since
    if since is None:
        followed = term is not None and thermometer.drives(term)
        if not followed or (known_now and not learnt.doubt):
            return learnt
        size, since = before.between_temperatures(), t
    if t - since > MAX_AGE_S:
        return learnt
    forecast = replace(learnt.forecast, unfollowed=size, unfollowed_since=since)
    return replace(learnt, forecast=forecast)


def _learn_by(
    sensor: Sensor,
    seen: Observations,
    driver: Driver,
    *,
    term: Term | None,
    before: Forecast | None,
    middle: Array,
    t: float,
    settings: QualitySettings,
) -> Learnt:
    """Fit with and without a curve, decide which is used, and return what follows.

    term, before: term and forecast in use; they count where they follow the same driver.
    """
    seen = replace(seen, celsius=driver.read)
    if term is not None and not driver.drives(term):
        term = None
    start = None if before is None else before.wander
    if before is not None and before.by_charger != driver.by_charger:
        before = None
    model = Model(driver.priors(PRIORS[sensor]), driver.reference(term), with_curve=False)
    known_now = np.isfinite(driver.read[-1])
    if not known_now or not driver.mostly_known or np.ptp(driver.known) < LEAST_SPAN_K:
        return _undecided(sensor, seen, driver, model, middle=middle, term=term, t=t, before=before)
    without = learn(seen, model, t, start)
    lag, seen, curved = driver.at_likeliest_lag(
        _wider(seen, term), replace(model, with_curve=True), t, before
    )
    change, evidence = _change(curved, without, seen, term is not None, settings)
    misled = _misled(curved, without, seen.t)
    if misled > ENOUGH_GAIN:
        return _unguided(sensor, averaged(without, t), seen, driver, middle=middle, term=term, t=t)
    if change == TAKEN_UP and misled > MOST_GAIN:  # more than one bad rest speaks against it
        change = ""
    applied = change == TAKEN_UP or (term is not None and change != DROPPED)
    curved = averaged(curved, t)
    used = curved if applied else averaged(without, t)
    behind = seen.celsius - driver.read
    known_behind = behind[np.isfinite(behind) & (behind != 0.0)]
    forecast = replace(
        _forecast(used, curved, driver, seen.celsius, t),
        lag_s=lag,
        behind_sd=rms(known_behind),
    )
    held = _term(sensor, forecast) if applied else None
    return _learnt(
        sensor,
        used,
        t=seen.t,
        middle=middle,
        forecast=forecast,
        term=held,
        change=change,
        evidence=evidence,
    )


def _misled(curved: Fit, without: Fit, t: Array) -> float:
    """Return how strongly the newest rests speak against the readings, nats, 0 where they do not.

    Page's test (1954, 10.1093/biomet/41.1-2.100) on the predictive density of each rest without the curve and
    with it; a step costs what it costs in the regression. Where the curve holds, the result exceeds
    ENOUGH_GAIN once in some exp(ENOUGH_GAIN) rests. t: (n,) s, of the rests.
    """
    gains = _log_density(without, t) - _log_density(curved, t)
    gains[[0, *without.doubted, *curved.doubted]] = 0.0
    against = 0.0
    for gain in np.minimum(gains, MOST_GAIN).tolist():
        against = min(max(against + gain, 0.0), 2.0 * ENOUGH_GAIN)
    return against


def _log_density(fit: Fit, t: Array) -> Array:
    """Return the log density of each rest by those before it, (n,), less the cost of a step there."""
    missed = (fit.errors / fit.errors_sd[:, None]) ** 2
    density = -0.5 * missed.sum(axis=1) - fit.errors.shape[1] * np.log(fit.errors_sd)
    stepped = np.isin(t, [step.t for step in fit.steps])
    return np.asarray(density - np.log(len(t)) * stepped)


def _unguided(
    sensor: Sensor,
    without: Fit,
    seen: Observations,
    driver: Driver,
    *,
    middle: Array,
    term: Term | None,
    t: float,
) -> Learnt:
    """Return the bias where the readings mislead: what there is without them, and nothing follows them."""
    forecast = _forecast(without, without, driver, seen.celsius, t)
    learnt = partial(_learnt, sensor, without, t=seen.t, middle=middle, forecast=forecast, term=None)
    if term is None:
        return learnt(change="", evidence={})
    return replace(learnt(change=DROPPED, evidence={}), doubt="rests are predicted worse by its readings")


def _wider(seen: Observations, term: Term | None) -> Observations:
    """Return observations whose rests of unknown temperature are as uncertain as the term held is large."""
    missing = ~np.isfinite(seen.celsius)
    if term is None or not missing.any():
        return seen
    rise = float(np.ptp(polynomial(term, seen.celsius[~missing]), axis=0).max())
    return seen.wider(np.where(missing, 0.5 * rise, 0.0))


def _undecided(
    sensor: Sensor,
    seen: Observations,
    driver: Driver,
    model: Model,
    *,
    middle: Array,
    term: Term | None,
    t: float,
    before: Forecast | None,
) -> Learnt:
    """Return the bias where the rests' temperatures decide nothing: a term that is held stays as it is.

    Where the newest rest's temperature is unknown, the term is not applied: the bias is that of now, whatever
    the temperature may be. Where the thermometer goes on to tell others that cannot be, the term is dropped.
    Where the temperatures are known and all alike, the bias at others is as uncertain
    as the term held, or without one as a sensor's usually is.
    """
    known_now, told = np.isfinite(driver.read[-1]), np.zeros((POWERS, 3))
    start = None if before is None else before.wander
    if term is not None and known_now:
        offset, told = driver.offset(term), told_curve(term)[1:]
        seen = seen.less(offset)
    fit = curved = averaged(learn(seen, model, t, start), t)
    if known_now and driver.mostly_known:
        priors = _after(model.priors, None if term is None else before)
        curved = averaged(learn(seen, replace(model, priors=priors, with_curve=True), t, fit.wander), t)
    forecast = _forecast(fit, curved, driver, seen.celsius, t)
    forecast = replace(forecast, curve=frozen(forecast.curve + told))
    learnt = partial(_learnt, sensor, fit, t=seen.t, middle=middle, forecast=forecast, evidence={})
    if term is not None and driver.lies:
        return replace(learnt(term=None, change=DROPPED), doubt="its newest readings are far from all others")
    return learnt(term=term, change="")


def _after(priors: Priors, before: Forecast | None) -> Priors:
    """Return what is known of a curve: by the forecast in use, on its least known axis, else `priors`."""
    if before is None:
        return priors
    linear, quadratic, cubic = np.sqrt(np.diag(before.covariance))[3:].reshape(-1, 3).max(axis=1).tolist()
    return replace(priors, curve=(linear, quadratic, cubic))


def told_curve(term: Term) -> Array:
    """Return a term's coefficients about its own reference, (4, 3) as Forecast.error has them."""
    told = np.zeros((POWERS + 1, 3))
    if term.effect == BY_CHARGING:
        told[1] = term.parameters["amplitude"].value * UNIT_K / FULL_K
    for power, name in enumerate(POWER_NAMES, start=1):
        if name in term.parameters:
            told[power] = term.parameters[name].value * UNIT_K**power
    return told


def _change(
    curved: Fit, without: Fit, seen: Observations, held: bool, settings: QualitySettings
) -> tuple[str, Evidence]:
    """Return whether the curve is to be taken up or dropped, or nothing, and the figures.

    held: whether a curve is in use. Whether one is taken up is judged by the score of a Cauchy distribution
    of the rests' own scatter, so that one bad rest weighs little; and where few hours leave no doubt, by what
    is gained at the uncertainty stated without the curve. Whether one is dropped is judged by squared errors,
    because a curve that often fails badly may be the better one in all other hours.
    """
    own = seen.variances(curved.wander)[1:, None]
    errors = [fit.errors[1:] ** 2 for fit in (without, curved)]
    gains = np.log((errors[0] + own) / (errors[1] + own)).sum(axis=1)
    _, block = np.unique(np.floor(seen.t[1:] / BLOCK_S), return_inverse=True)
    by_hour = sums_by_block(block, gains)
    evidence: Evidence = {"hours": by_hour.size, "gain": float(by_hour.sum())}
    evidence |= {
        f"typical_{name}": float(np.sqrt(np.median(e))) if e.size else None
        for name, e in zip(("without", "with"), errors, strict=True)
    }
    at_stated = (errors[0] - errors[1]).sum(axis=1) / (2.0 * without.errors_sd[1:] ** 2)
    doubtless = beyond_doubt(sums_by_block(block, at_stated)[-NEWEST_HOURS:])
    if by_hour.size < settings.held_out_rests:
        return (TAKEN_UP if doubtless and not held else ""), evidence
    if held:
        newest = block >= by_hour.size - NEWEST_HOURS
        without_curve, with_curve = (e[newest].sum(axis=1) for e in errors)
        most = _BAD**2 * without_curve.mean()
        lost = np.minimum(with_curve, most) - np.minimum(without_curve, most)
        worse = flipped_share(sums_by_block(block[newest], lost)[-NEWEST_HOURS:])
        matters = with_curve.mean() > MATTERS**2 * without_curve.mean()
        return (DROPPED if worse <= settings.chance and matters else ""), evidence | {"chance": worse}
    better, lately = flipped_share(by_hour), flipped_share(by_hour[-NEWEST_HOURS:])
    taken_up = better <= settings.chance * _STRICTER and lately <= settings.chance
    return (TAKEN_UP if taken_up or doubtless else ""), evidence | {"chance": better}


def _learnt(
    sensor: Sensor,
    fit: Fit,
    *,
    t: Array,
    middle: Array,
    forecast: Forecast,
    term: Term | None,
    change: str,
    evidence: Evidence,
) -> Learnt:
    one_by_one = fit.level.shape[1] == 3
    scale = np.zeros((3, 3))
    if not one_by_one:
        for (a, b), value in zip(_PAIRS, fit.level[3:, 0], strict=True):
            scale[a, b] = scale[b, a] = value
    covariance = None if one_by_one else frozen(fit.covariance[:9, :9])
    return Learnt(
        sensor,
        frozen(middle + fit.bias),
        frozen(scale),
        forecast,
        term,
        change,
        evidence,
        covariance,
        t,
        frozen(np.sqrt((fit.errors**2).mean(axis=1))),
        fit.errors_sd,
        tuple(step.t for step in fit.steps),
        tuple(t[list(fit.doubted)].tolist()),
    )


def _forecast(fit: Fit, curved: Fit, driver: Driver, celsius: Array, t: float) -> Forecast:
    """Return the uncertainty of a fit's bias, with that of the curve where it is not corrected.

    celsius: (n,) temperatures of the sensor at the rests.
    """
    error = np.zeros((4, 3))
    if fit is not curved:
        error = np.vstack((curved.bias - fit.bias, curved.curve))
    forecast = Forecast(
        at=t,
        reference=fit.model.reference,
        curve=curved.curve,
        error=frozen(error),
        covariance=curved.bias_covariance,
        white=fit.wander.white,
        flicker=curved.wander.flicker,
        walk=curved.wander.walk,
    )
    return driver.stated(forecast, celsius)


def _term(sensor: Sensor, forecast: Forecast) -> Term:
    """Return the term that corrects a forecast's curve."""
    effect, unit = EFFECTS[sensor]
    sd = np.sqrt(np.diag(forecast.covariance))[3:].reshape(-1, 3)
    lag = {"lag_s": forecast.lag_s} if forecast.lag_s else {}

    def parameter(power: int, per: float, unit: str) -> TermParameter:
        value, reach = forecast.curve[power - 1] * per, REACH_OF_95 * sd[power - 1] * per
        ci95 = frozen(np.stack([value - reach, value + reach], axis=1))
        return TermParameter(value=frozen(value), unit=unit, ci95=ci95)

    if forecast.by_charger:
        amplitude = parameter(1, FULL_K / UNIT_K, unit)
        return Term(effect=BY_CHARGING, sensor=sensor, parameters={"amplitude": amplitude}, reference=lag)
    parameters = {
        name: parameter(power, UNIT_K**-power, f"{unit}/K" if power == 1 else f"{unit}/K^{power}")
        for power, name in enumerate(POWER_NAMES, start=1)
    }
    reference = {"temperature": forecast.reference}
    if forecast.temperature_min is not None and forecast.temperature_max is not None:
        reference |= {
            "temperature_min": forecast.temperature_min,
            "temperature_max": forecast.temperature_max,
        }
    return Term(effect=effect, sensor=sensor, parameters=parameters, reference=reference | lag)
