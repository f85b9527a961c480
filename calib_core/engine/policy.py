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
from stillcal.calib_core.engine.actions import Diagnose, Level, Reject, Store
from stillcal.calib_core.engine.decisions import FitOutcome, FitTask, fitted
from stillcal.calib_core.engine.schedule import Occasion, Standing, calibration_due
from stillcal.calib_core.engine.state import EngineSettings, EngineState, Refusal, Trouble
from stillcal.calib_core.engine.telling import Telling
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.static.detector import StationaryDetector


class Judging:
    """Judges what `state` holds.

    detector: says whether a rest is believed to be one by the floor known now.
    """

    def __init__(
        self,
        settings: EngineSettings,
        state: EngineState,
        detector: StationaryDetector,
        telling: Telling,
    ) -> None:
        self._settings, self._s, self._detector, self._telling = settings, state, detector, telling

    # The check of 4.7

    def check(self, t: float) -> None:
        """Hold the rests since the last check against the calibration, if there are any."""
        s = self._s
        if s.record is None or s.record.accelerometer is None:
            s.check_due = False
            return
        since = s.checked
        recent = s.pool.since(since).where(self._detector.still_valid)
        found = calibrate.checked(s.record, recent, self._settings.quality)
        if found.verdict is Verdict.WAIT:
            return
        s.check_due, s.checked = False, t
        s.counters.checks += 1
        self._telling.log(t, Level.INFO, "check", f"{found.verdict}", **calibrate.figures(found))
        if found.verdict is Verdict.RECALIBRATE:
            self._degrade(t, since if found.off_since is None else found.off_since)
        else:
            s.trouble = None
            self.zero_gyro(t, since)

    def zero_gyro(self, t: float, since: float | None) -> None:
        """Measure the gyroscope's bias anew (4.7) on the rests since a time, s, if they show it."""
        s = self._s
        recent = s.pool.since(since).where(self._detector.still_valid)
        zeroed = None if s.record is None else gyroscope_record.zeroed(s.record, recent, t)
        if zeroed is not None:
            s.record = zeroed
            s.counters.zeroings += 1
            self._telling.act(Store(t, zeroed, zeroed.acceptance.reason))

    def _degrade(self, t: float, since: float | None) -> None:
        """Gather again; `since` (s) is from when on the calibration may have been wrong."""
        s = self._s
        if not s.degraded:
            s.degraded, s.sound_until = True, since
            s.counters.degradations += 1
            self._telling.log(
                t, Level.WARNING, "degraded", "the calibration no longer fits: gathering rests again"
            )
        s.trouble = (s.trouble or Trouble(t)).after_failed_check()
        if s.trouble.failed == self._settings.schedule.diagnose_after_checks:
            self._telling.act(Diagnose(t, s.trouble.reason))
        if s.charging:
            self.renew(t, Occasion.CHARGING)

    # Full calibration

    def renew(self, t: float, occasion: Occasion) -> None:
        """Try a full calibration if one is due on this occasion."""
        s = self._s
        since = math.inf if s.tried is None else t - s.tried
        standing = Standing(s.record is not None, s.degraded, s.fresh, since)
        if not calibration_due(standing, occasion, self._settings.schedule):
            return
        s.fresh, s.tried = 0, t
        if s.trouble is not None:
            s.trouble = replace(s.trouble, tried=True)
        sure = tuple(self._detector.still_valid(h.rest) for h in s.pool.held)
        task = FitTask(
            t,
            occasion,
            s.pool,
            sure,
            s.gravity,
            s.record,
            s.degraded,
            s.sound_until,
            self._settings.calibrate,
            self._settings.quality,
        )
        self._follow(t, fitted(task), occasion)

    def _follow(self, t: float, found: FitOutcome, occasion: Occasion) -> None:
        s = self._s
        if found.record is None:
            self._refuse(t, found, occasion)
            return
        if found.recent_only:
            s.pool = s.pool.since(s.sound_until)
            s.attitudes = len(s.pool.attitudes(self._settings.pool))
        if not found.accepted:
            s.degraded = s.degraded and not found.settled
            s.counters.rejected += 1
            self._telling.act(Reject(t, found.record, found.reason))
            self._telling.log(t, Level.INFO, "rejected", found.reason, occasion=str(occasion))
            return
        s.record, s.checked, s.degraded, s.refusal = found.record, t, False, None
        s.counters.calibrations += 1
        self._telling.act(Store(t, found.record, found.reason))
        self._telling.log(t, Level.INFO, "calibrated", found.reason, occasion=str(occasion))

    def _refuse(self, t: float, found: FitOutcome, occasion: Occasion) -> None:
        s = self._s
        s.counters.refused += 1
        news = s.refusal is None or s.refusal.missing != found.missing
        s.refusal = Refusal(found.reason, found.missing)
        why = str(NotSupported(found.reason, found.missing))
        level = Level.INFO if news else Level.DEBUG
        self._telling.log(t, level, "refused", why, occasion=str(occasion))
