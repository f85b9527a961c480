"""The bias by temperature, learnt from rests and taken up, or dropped, on evidence.

Where there is no thermometer, the charger stands in for one (driver.py): a curve is then a straight line of
the heat of charging.

What rests show is in observations.py, whether a curve is used in evidence.py.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.acceptance import (
    ENOUGH_GAIN,
    MOST_GAIN,
)
from stillcal.calib_core.calibration.bias_curve.driver import Driver, by_charger, by_thermometer
from stillcal.calib_core.calibration.bias_curve.evidence import change_of, misled
from stillcal.calib_core.calibration.bias_curve.learnt import (
    DROPPED,
    TAKEN_UP,
    Learnt,
    held_term,
    term_of,
    told_curve,
)
from stillcal.calib_core.calibration.bias_curve.observations import (
    Shown,
    scale_of,
    shown_by_accelerometer,
    shown_by_gyroscope,
)
from stillcal.calib_core.calibration.corrections.term import Term
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.record import CalibrationRecord, Evidence
from stillcal.calib_core.calibration.terms import polynomial
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.breaks import BREAK, learn
from stillcal.calib_core.temperature.forecast import UNSEEN_S, Forecast
from stillcal.calib_core.temperature.memory import MAX_AGE_S, Memory
from stillcal.calib_core.temperature.regression import (
    ACCELEROMETER,
    GYROSCOPE,
    POWERS,
    Fit,
    Model,
    Observations,
    Priors,
    averaged,
)

LEAST_RESTS = 8
"""Fewer rests show too little of the accelerometer, of which each shows one direction only."""

LEAST_SPAN_K = 2.0
"""No curve is learnt from a smaller span of temperatures."""


PRIORS = {Sensor.ACCELEROMETER: ACCELEROMETER, Sensor.GYROSCOPE: GYROSCOPE}


def learn_gyroscope(
    memory: Memory, record: CalibrationRecord, t: float, settings: QualitySettings, *, search: bool = True
) -> Learnt | None:
    """Learn the gyroscope's bias now (t, s) by temperature; None where no rest has a rate.

    search: whether how it wanders and how late it follows are looked for. Else they stay as the record's
    forecast has them, which takes a fraction of the time.
    """
    shown = shown_by_gyroscope(memory, record)
    return None if shown is None else _learn(shown, record, t, settings, search=search)


def learn_accelerometer(
    memory: Memory, model: SensorModel, record: CalibrationRecord | None, t: float, settings: QualitySettings
) -> Learnt | None:
    """Learn the accelerometer's bias now (t, s) by temperature; None where there are too few rests.

    model: a calibration near the true one. record: the calibration in use, None before the first.
    """
    if len(memory) < LEAST_RESTS:
        return None
    return _learn(shown_by_accelerometer(memory, model, record), record, t, settings)


def _learn(
    shown: Shown,
    record: CalibrationRecord | None,
    t: float,
    settings: QualitySettings,
    *,
    search: bool = True,
) -> Learnt:
    """Learn by the thermometer, or by the charger where no curve can follow the thermometer now.

    A term that follows the charger stays until one that follows the thermometer is taken up, and the other
    way round.
    """
    thermometer, charger = by_thermometer(shown.memory), by_charger(shown.memory)
    term = None if record is None else held_term(record.terms, shown.sensor)
    before = None if record is None else record.forecast.get(str(shown.sensor))
    learn_by = partial(_learn_by, shown, term=term, before=before, t=t, settings=settings, search=search)
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
    return _with_unseen(_with_unfollowed(learnt, thermometer, term=term, before=before, t=t), shown.memory)


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
    shown: Shown,
    driver: Driver,
    *,
    term: Term | None,
    before: Forecast | None,
    t: float,
    settings: QualitySettings,
    search: bool,
) -> Learnt:
    """Fit with and without a curve, decide which is used, and return what follows.

    term, before: term and forecast in use; they count where they follow the same driver.
    """
    seen = replace(shown.seen, celsius=driver.read)
    if term is not None and not driver.drives(term):
        term = None
    start = None if before is None else before.wander
    if before is not None and before.by_charger != driver.by_charger:
        before = None
    model = Model(driver.priors(PRIORS[shown.sensor]), driver.reference(term), with_curve=False)
    known_now = np.isfinite(driver.read[-1])
    if not known_now or not driver.mostly_known or np.ptp(driver.known) < LEAST_SPAN_K:
        return _undecided(shown, seen, driver, model, term=term, t=t, before=before, search=search)
    without = learn(seen, model, t, start, search=search)
    lag, seen, curved = driver.at_likeliest_lag(
        _wider(seen, term), replace(model, with_curve=True), t, before, search=search
    )
    change, evidence = change_of(curved, without, seen, term is not None, settings)
    against = misled(curved, without, seen.t)
    if against > ENOUGH_GAIN:
        return _unguided(shown, averaged(without, t), seen, driver, term=term, t=t)
    if change == TAKEN_UP and against > MOST_GAIN:  # more than one bad rest speaks against it
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
    held = term_of(shown.sensor, forecast) if applied else None
    return _learnt(shown, used, forecast=forecast, term=held, change=change, evidence=evidence)


def _unguided(
    shown: Shown, without: Fit, seen: Observations, driver: Driver, *, term: Term | None, t: float
) -> Learnt:
    """Return the bias where the readings mislead: what there is without them, and nothing follows them."""
    forecast = _forecast(without, without, driver, seen.celsius, t)
    learnt = partial(_learnt, shown, without, forecast=forecast, term=None)
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
    shown: Shown,
    seen: Observations,
    driver: Driver,
    model: Model,
    *,
    term: Term | None,
    t: float,
    before: Forecast | None,
    search: bool,
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
    fit = curved = averaged(learn(seen, model, t, start, search=search), t)
    if known_now and driver.mostly_known:
        priors = _after(model.priors, None if term is None else before)
        curving = replace(model, priors=priors, with_curve=True)
        curved = averaged(learn(seen, curving, t, fit.wander, search=search), t)
    forecast = _forecast(fit, curved, driver, seen.celsius, t)
    forecast = replace(forecast, curve=frozen(forecast.curve + told))
    learnt = partial(_learnt, shown, fit, forecast=forecast, evidence={})
    if term is not None and driver.lies:
        return replace(learnt(term=None, change=DROPPED), doubt="its newest readings are far from all others")
    return learnt(term=term, change="")


def _after(priors: Priors, before: Forecast | None) -> Priors:
    """Return what is known of a curve: by the forecast in use, on its least known axis, else `priors`."""
    if before is None:
        return priors
    linear, quadratic, cubic = np.sqrt(np.diag(before.covariance))[3:].reshape(-1, 3).max(axis=1).tolist()
    return replace(priors, curve=(linear, quadratic, cubic))


def _learnt(
    shown: Shown, fit: Fit, *, forecast: Forecast, term: Term | None, change: str, evidence: Evidence
) -> Learnt:
    one_by_one = fit.level.shape[1] == 3
    t = shown.seen.t
    return Learnt(
        shown.sensor,
        frozen(shown.middle + fit.bias),
        frozen(np.zeros((3, 3)) if one_by_one else scale_of(fit.level[3:, 0])),
        forecast,
        term,
        change,
        evidence,
        None if one_by_one else frozen(fit.covariance[:9, :9]),
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
