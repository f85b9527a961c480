"""What the engine decides on: checks of the calibration, zeroing, and full calibrations.

When is decided elsewhere (schedule.py, engine.py); the figures and the rules are calibrate.py's and
quality.py's. Here they are put to what is held, and the state follows.
"""

from __future__ import annotations

import math
from dataclasses import replace

from stillcal.calib_core.calibration import candidate as calibrate
from stillcal.calib_core.calibration import gyroscope_record
from stillcal.calib_core.calibration.drift_check import Verdict
from stillcal.calib_core.engine.actions import Action, Diagnose, Level, Log, Publish, Reject
from stillcal.calib_core.engine.decisions import FitOutcome, FitTask, fitted
from stillcal.calib_core.engine.schedule import Occasion, Standing, calibration_due
from stillcal.calib_core.engine.state import EngineSettings, EngineState, Refusal, Trouble
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.static.detector import StationaryDetector


class CalibrationPolicy:
    """Judges what `state` holds.

    detector: says whether a rest is believed to be one by the floor known now.
    """

    def __init__(
        self,
        settings: EngineSettings,
        state: EngineState,
        detector: StationaryDetector,
        actions: list[Action],
    ) -> None:
        self._settings, self._state, self._detector, self._actions = settings, state, detector, actions

    # The check of 4.7

    def check(self, t: float) -> None:
        """Hold the rests since the last check against the calibration, if there are any."""
        state = self._state
        if state.record is None or state.record.accelerometer is None:
            state.check_due = False
            return
        since = state.checked
        recent = state.pool.since(since).where(self._detector.still_valid)
        found = calibrate.checked(state.record, recent, self._settings.quality)
        if found.verdict is Verdict.WAIT:
            return
        state.check_due, state.checked = False, t
        state.counters.checks += 1
        self._actions.append(Log(t, Level.INFO, "check", f"{found.verdict}", calibrate.figures(found)))
        if found.verdict is Verdict.RECALIBRATE:
            self._degrade(t, since if found.off_since is None else found.off_since)
        else:
            state.trouble = None
            self.update_bias(t, since)

    def update_bias(self, t: float, since: float | None) -> None:
        """Measure the gyroscope's bias anew (4.7) on the rests since a time, s, if they show it."""
        state = self._state
        recent = state.pool.since(since).where(self._detector.still_valid)
        if state.record is None:
            return
        updated = gyroscope_record.with_updated_bias(state.record, recent, t)
        if updated is not None:
            state.record = updated
            state.counters.zeroings += 1
            self._actions.append(Publish(t, updated, updated.acceptance.reason))

    def _degrade(self, t: float, since: float | None) -> None:
        """Gather again; `since` (s) is from when on the calibration may have been wrong."""
        state = self._state
        if not state.degraded:
            state.degraded, state.sound_until = True, since
            state.counters.degradations += 1
            why = "the calibration no longer fits: gathering rests again"
            self._actions.append(Log(t, Level.WARNING, "degraded", why))
        state.trouble = (state.trouble or Trouble(t)).after_failed_check()
        if state.trouble.failed == self._settings.schedule.diagnose_after_checks:
            self._actions.append(Diagnose(t, state.trouble.reason))
        if state.charging:
            self.renew(t, Occasion.CHARGING)

    # Full calibration

    def renew(self, t: float, occasion: Occasion) -> None:
        """Try a full calibration if one is due on this occasion."""
        state = self._state
        since = math.inf if state.tried is None else t - state.tried
        standing = Standing(state.record is not None, state.degraded, state.fresh, since)
        if not calibration_due(standing, occasion, self._settings.schedule):
            return
        state.fresh, state.tried = 0, t
        if state.trouble is not None:
            state.trouble = replace(state.trouble, tried=True)
        sure = tuple(self._detector.still_valid(h.rest) for h in state.pool.held)
        task = FitTask(
            t,
            occasion,
            state.pool,
            sure,
            state.gravity,
            state.record,
            state.degraded,
            state.sound_until,
            self._settings.calibrate,
            self._settings.quality,
        )
        self._follow(t, fitted(task), occasion)

    def _follow(self, t: float, found: FitOutcome, occasion: Occasion) -> None:
        state = self._state
        if found.record is None:
            self._refuse(t, found, occasion)
            return
        if found.recent_only:
            state.pool = state.pool.since(state.sound_until)
            state.attitudes = len(state.pool.attitudes(self._settings.pool))
        if not found.accepted:
            state.degraded = state.degraded and not found.settled
            state.counters.rejected += 1
            self._actions.append(Reject(t, found.record, found.reason))
            self._actions.append(Log(t, Level.INFO, "rejected", found.reason, {"occasion": str(occasion)}))
            return
        state.record, state.checked, state.degraded, state.refusal = found.record, t, False, None
        state.counters.calibrations += 1
        self._actions.append(Publish(t, found.record, found.reason))
        self._actions.append(Log(t, Level.INFO, "calibrated", found.reason, {"occasion": str(occasion)}))

    def _refuse(self, t: float, found: FitOutcome, occasion: Occasion) -> None:
        state = self._state
        state.counters.refused += 1
        news = state.refusal is None or state.refusal.missing != found.missing
        state.refusal = Refusal(found.reason, found.missing)
        why = str(NotSupported(found.reason, found.missing))
        level = Level.INFO if news else Level.DEBUG
        self._actions.append(Log(t, level, "refused", why, {"occasion": str(occasion)}))
