"""What the engine looks at and when it calibrates: every timing decision, as pure functions.

Times are s of sample time. The engine asks; nothing here remembers anything.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from stillcal.calib_core.engine.settings import ScheduleSettings, Watch
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.streams.samples import Sensor

_LONGEST_GAP_S = 86400.0


@dataclass(frozen=True, slots=True)
class Need:
    """What is still wanted. rests: attitudes are missing; check: a check waits for a rest."""

    rests: bool
    check: bool


def watch_for(
    need: Need, current: Watch, remaining_s: float, capacity_s: float, settings: ScheduleSettings
) -> Watch:
    """Choose how to look on, given how long (s) the energy allowance would last.

    Unbroken watching begins only with half the burst saved up and goes on until it is spent, so that the
    sensors are not switched to and fro; a check alone is worth probing only, and worth an overdraft.
    """
    if settings.watch != "auto":
        return Watch(settings.watch)
    if need.rests and remaining_s > 0 and (current is Watch.CONTINUOUS or remaining_s >= capacity_s / 2):
        return Watch.CONTINUOUS
    return Watch.PROBING if need.check or (need.rests and remaining_s > 0) else Watch.IDLE


def next_on_grid(began: float, interval: float, after: float) -> float:
    """Return the first of the times began + k interval (k = 1, 2, ...) that lies past `after`.

    Deadlines stay on their grid across gaps, so that schedules do not drift.
    """
    return began + interval * max(1, math.floor((after - began) / interval) + 1)


class Occasion(StrEnum):
    """What may bring about a full calibration."""

    CHARGING = "charging"
    UNPLUGGED = "no charger was ever reported"
    END = "the recording ended"
    ASKED = "asked for"


@dataclass(frozen=True, slots=True)
class CalibrationStatus:
    """Where calibration stands.

    fresh: rests gathered since the last try to fit. since_try: s since that try, inf where there was none.
    """

    has_record: bool
    degraded: bool
    fresh: int
    since_try: float


def calibration_due(standing: CalibrationStatus, occasion: Occasion, settings: ScheduleSettings) -> bool:
    """Say whether a full calibration is worth trying: never without rests gathered since the last try.

    A phone without a calibration does not wait; one whose calibration failed its check waits for the
    next. A recording that ends has no later chance. Who asks is always answered.
    """
    if occasion is Occasion.ASKED:
        return True
    if standing.fresh == 0:
        return False
    if not standing.has_record or occasion is Occasion.END:
        return True
    return standing.since_try >= least_wait(standing.degraded, settings)


def least_wait(degraded: bool, settings: ScheduleSettings) -> float:
    """Return how long (s) after a try to fit the next may come, where there is a calibration already."""
    return settings.check_interval_s if degraded else settings.recalibrate_interval_s


def resumed(state: EngineState, t: float) -> float:
    """Return from when (s) on deadlines count: `t`, or a day before what comes next after a longer gap.

    Through gaps of a day deadlines fall as they would live; years between two stamps cost no more.
    The gyroscope's next sample may still be on its way; the accelerometer's is known.
    """
    waiting = state.waiting.get(Sensor.ACCELEROMETER)
    coming = [e.t for e in state.events[:1]]
    if waiting is not None:
        coming += waiting.t[np.searchsorted(waiting.t, t) :][:1].tolist()
    return max(t, min(coming or [state.heard or t]) - _LONGEST_GAP_S)


def first_of_use(state: EngineState, t: float, step: float, settings: ScheduleSettings) -> float:
    """Return the first review, from t (s) in steps, that can find anything to do: not all need be held.

    For where a review changes nothing in how the sensors are watched. Before it comes a full calibration that
    is due, or the next check, which plans anew in any case; so does every event.
    """
    if state.record is None or state.check_due or state.tried is None or state.next_check is None:
        return t
    until = state.next_check
    if state.charging is not False:
        until = min(until, state.tried + least_wait(state.degraded, settings))
    while t < until:
        t += step
    return t


def review_soon(state: EngineState, t: float, settings: ScheduleSettings) -> None:
    """Hold a review within one interval of `t` (s): something was changed that left it nothing to do."""
    if state.next_review is not None:
        state.next_review = min(state.next_review, t + settings.review_interval_s)
