"""When the engine's next deadlines fall, as functions of its state; what they bring is engine.py's."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.engine.schedule import ScheduleSettings, least_wait
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.streams.samples import Sensor

_LONGEST_GAP_S = 86400.0


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
