"""When the engine senses, checks, reviews and calibrates: every timing decision, as functions of its state.

Times are s of sample time. Nothing here keeps a state of its own; engine.py acts on the answers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from stillcal.calib_core.engine.settings import ScheduleSettings, Watch
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.streams.samples import Sensor

_LEAST_EARLY_S = 120.0
"""s: two checks are at least so far apart."""

UNCHARGED_INTERVALS = 4
"""Intervals between calibrations, of six hours usually: nearly all phones are charged once a day."""

_LONGEST_GAP_S = 86400.0
"""A day: through longer gaps deadlines are left out, so that years between two stamps cost no time."""


@dataclass(frozen=True, slots=True)
class Need:
    """What rests are needed for. rests: more attitudes are wanted; check: a check waits for a rest."""

    rests: bool
    check: bool


def watch_for(
    need: Need, current: Watch, remaining_s: float, capacity_s: float, settings: ScheduleSettings
) -> Watch:
    """Choose how to sense until the next review.

    remaining_s: s of unbroken sensing that the budget allows. capacity_s: s that it can hold. Unbroken
    sensing begins only when half the capacity is saved up and goes on until the budget is spent, so that the
    sensors are not switched on and off all the time. A check alone is worth only probing, but even without
    any budget left.
    """
    if settings.watch != "auto":
        return Watch(settings.watch)
    if need.rests and remaining_s > 0 and (current is Watch.CONTINUOUS or remaining_s >= capacity_s / 2):
        return Watch.CONTINUOUS
    return Watch.PROBING if need.check or (need.rests and remaining_s > 0) else Watch.IDLE


def next_on_grid(began: float, interval: float, after: float) -> float:
    """Return the first of the times began + k interval (k = 1, 2, ...) that lies after `after`, in s.

    Deadlines stay on this grid across gaps, so that the schedule does not drift. `after` may be one of them,
    rounded down: its quotient then falls short of k, and k would come again without end.
    """
    k = max(1, math.floor((after - began) / interval) + 1)
    t = began + interval * k
    return t if t > after else began + interval * (k + 1)


class Occasion(StrEnum):
    """What may lead to a full calibration."""

    CHARGING = "charging"
    UNPLUGGED = "no charger was ever reported"
    UNCHARGED = "off the charger for long"
    END = "the recording ended"
    ASKED = "asked for"


@dataclass(frozen=True, slots=True)
class CalibrationStatus:
    """What decides whether a full calibration is due.

    complete: whether there is a full calibration that no prior entered. degraded: whether that failed its
    check. fresh: rests gathered since the last attempt to fit. since_try: s since that attempt, inf where
    there was none.
    """

    complete: bool
    degraded: bool
    fresh: int
    since_try: float


def calibration_due(standing: CalibrationStatus, occasion: Occasion, settings: ScheduleSettings) -> bool:
    """Say whether a full calibration is due on this occasion.

    A request is always answered. Otherwise there must be rests gathered since the last attempt. A phone
    without a complete calibration does not wait, nor does the end of a recording, after which there is no
    other chance. A phone with a complete calibration waits for `least_wait` since the last attempt.
    """
    if occasion is Occasion.ASKED:
        return True
    if standing.fresh == 0:
        return False
    if not standing.complete or occasion is Occasion.END:
        return True
    return standing.since_try >= least_wait(standing.degraded, settings)


def first_without_charger(state: EngineState, t: float, settings: ScheduleSettings) -> Occasion | None:
    """Return on what occasion a phone that is not charged gets its first calibration at t (s), None for none.

    Where no charger is ever told of, that is after one interval between calibrations; where the phone is
    known to be off it, after UNCHARGED_INTERVALS.
    """
    if state.complete or state.charging or state.began is None:
        return None
    if state.charging is None:
        return Occasion.UNPLUGGED if t - state.began >= settings.recalibrate_interval_s else None
    since = float(state.charger.t[-1]) if state.charger.t.size else state.began
    long = t - since >= UNCHARGED_INTERVALS * settings.recalibrate_interval_s
    return Occasion.UNCHARGED if long else None


def least_wait(degraded: bool, settings: ScheduleSettings) -> float:
    """Return how long (s) after an attempt to fit the next one may come, where there is a calibration."""
    return settings.check_interval_s if degraded else settings.recalibrate_interval_s


def resumed(state: EngineState, t: float) -> float:
    """Return the time (s) from which deadlines count: `t`, or a day before the end of a longer gap.

    In gaps of up to a day deadlines fall as they would live. Where a gap ends is told by the next event and
    the accelerometer's next sample; the gyroscope's may still be on its way.
    """
    waiting = state.waiting.get(Sensor.ACCELEROMETER)
    coming = [e.t for e in state.events[:1]]
    if waiting is not None:
        coming += waiting.t[np.searchsorted(waiting.t, t) :][:1].tolist()
    return max(t, min(coming or [state.heard or t]) - _LONGEST_GAP_S)


def first_of_use(state: EngineState, t: float, step: float, settings: ScheduleSettings) -> float:
    """Return the first review, from t (s) on in steps of `step` (s), that can find anything to do.

    For times when a review cannot change how the sensors are used. The reviews before the next full
    calibration or check have nothing to do and are left out; a check or an event plans the next review anew.
    """
    if not state.complete or state.check_due or state.tried is None or state.next_check is None:
        return t
    until = state.next_check if state.early_check is None else min(state.next_check, state.early_check)
    if state.charging is not False:
        until = min(until, state.tried + least_wait(state.degraded, settings))
    while t < until:
        t += step
    return t


def wandered_by(state: EngineState, t: float, settings: ScheduleSettings) -> float | None:
    """Return when (s) a bias measured at t (s) is expected to have wandered by more than is wanted.

    By this phone's own wander (forecast). None where that is not before the next check, which comes anyway.
    """
    if state.record is None or state.next_check is None:
        return None
    wanted = {Sensor.ACCELEROMETER: settings.wanted_force, Sensor.GYROSCOPE: settings.wanted_rate}
    ages = np.arange(_LEAST_EARLY_S, state.next_check - t, _LEAST_EARLY_S)
    for age in ages.tolist():
        for sensor, limit in wanted.items():
            forecast = state.record.forecast.get(str(sensor))
            if forecast is not None and forecast.wander.growth(age) > limit**2:
                return float(t + age)
    return None


def accelerometer_wandered(state: EngineState, t: float, settings: ScheduleSettings) -> bool:
    """Tell whether the accelerometer's bias, learnt before, is expected to have wandered too far by t (s)."""
    forecast = None if state.record is None else state.record.forecast.get(str(Sensor.ACCELEROMETER))
    return forecast is not None and forecast.wander.growth(t - forecast.at) > settings.wanted_force**2


def early_check_due(state: EngineState, t: float) -> bool:
    """Tell whether a check is due at t (s) before its hour, and any of the budget is left to spend.

    A check takes some five seconds of the sensors, less than the budget earns from one to the next.
    """
    left = state.allowance is not None and state.allowance.saved > 0.0
    return state.early_check is not None and t >= state.early_check and left


def first_of_its_hour(state: EngineState, before: float | None, settings: ScheduleSettings) -> bool:
    """Tell whether a check is the first since the last deadline for one; before: s, when the last one was."""
    if before is None or state.next_check is None:
        return True
    return before < state.next_check - settings.check_interval_s


def review_soon(state: EngineState, t: float, settings: ScheduleSettings) -> None:
    """Move the next review to within one interval of `t` (s), because a change from outside needs one."""
    if state.next_review is not None:
        state.next_review = min(state.next_review, t + settings.review_interval_s)
