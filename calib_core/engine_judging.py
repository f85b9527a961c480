"""What the engine decides on: checks of the calibration, zeroing, and full calibrations.

When is decided elsewhere (schedule.py, engine.py); the figures and the rules are calibrate.py's and
quality.py's. Here they are put to what is held, and the state follows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from stillcal.calib_core import calibrate
from stillcal.calib_core.accelerometer import AccelerometerFit
from stillcal.calib_core.engine_state import EngineSettings, EngineState, Refusal, Trouble
from stillcal.calib_core.engine_telling import Telling
from stillcal.calib_core.events import Diagnose, Level, Reject, Store
from stillcal.calib_core.pool import Pool
from stillcal.calib_core.quality import Verdict
from stillcal.calib_core.refusals import NotSupported
from stillcal.calib_core.rests import RestState
from stillcal.calib_core.schedule import Occasion, Standing, calibration_due

Valid = Callable[[RestState], bool]


class Judging:
    """Judges what `state` holds. still_valid: whether a rest is believed to be one by the floor known now."""

    def __init__(
        self, settings: EngineSettings, state: EngineState, still_valid: Valid, telling: Telling
    ) -> None:
        self._settings, self._s, self._valid, self._telling = settings, state, still_valid, telling

    # The check of 4.7

    def check(self, t: float) -> None:
        """Hold the rests since the last check against the calibration, if there are any."""
        s = self._s
        if s.record is None or s.record.accelerometer is None:
            s.check_due = False
            return
        since = s.checked
        recent = s.pool.since(since).where(self._valid)
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
            self.zero_gyro(t, recent)

    def zero_gyro(self, t: float, recent: Pool) -> bool:
        """Measure the gyroscope's bias anew on recent rests (4.7); say whether they showed it."""
        s = self._s
        zeroed = None if s.record is None else calibrate.zeroed(s.record, recent, t)
        if zeroed is None:
            return False
        s.record = zeroed
        s.counters.zeroings += 1
        self._telling.act(Store(t, zeroed, zeroed.acceptance.reason))
        return True

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
        try:
            candidate = self._candidate(t)
        except NotSupported as refusal:
            self._refuse(t, refusal, occasion)
            return
        self._decide(t, candidate, occasion)

    def _refuse(self, t: float, refusal: NotSupported, occasion: Occasion) -> None:
        s = self._s
        s.counters.refused += 1
        news = s.refusal is None or s.refusal.missing != refusal.missing
        s.refusal = Refusal(refusal.reason, refusal.missing)
        level = Level.INFO if news else Level.DEBUG
        self._telling.log(t, level, "refused", str(refusal), occasion=str(occasion))

    def _candidate(self, t: float) -> calibrate.Candidate:
        """Fit what was gathered.

        After a failed check, what was gathered before it is only kept as long as one calibration
        explains both: otherwise the sensor has changed, and the older rests go.
        """
        s = self._s
        recent = s.pool.since(s.sound_until) if s.degraded else s.pool
        whole = self._fit(s.pool, t)
        if len(recent.held) == len(s.pool.held):
            return _taken(whole)
        if isinstance(whole, calibrate.Candidate):
            check = calibrate.checked(whole.record, recent, self._settings.quality)
            if check.verdict is not Verdict.RECALIBRATE:
                return whole
        found = _taken(self._fit(recent, t))
        s.pool, s.attitudes = recent, len(recent.attitudes(self._settings.pool))
        return found

    def _fit(self, pool: Pool, t: float) -> calibrate.Candidate | NotSupported:
        """Fit the rests that the noise floor, as known by now, confirms, or all: whichever leaves less open.

        A doubtful rest that is one adds an attitude; one that is none adds scatter.
        """
        sure = pool.where(self._valid)
        everything = self._fitted_or_refused(pool, t)
        if len(sure.held) == len(pool.held) or isinstance(everything, NotSupported):
            return everything
        confirmed = self._fitted_or_refused(sure, t)
        if isinstance(confirmed, NotSupported):
            return everything
        return min(confirmed, everything, key=lambda c: _left_open(c.accelerometer))

    def _fitted_or_refused(self, pool: Pool, t: float) -> calibrate.Candidate | NotSupported:
        try:
            return calibrate.candidate(pool, self._s.gravity, t, self._settings.calibrate)
        except NotSupported as refusal:
            return refusal

    def _decide(self, t: float, candidate: calibrate.Candidate, occasion: Occasion) -> None:
        s = self._s
        decision = calibrate.decide(candidate, s.record, s.degraded, self._settings.quality)
        record = candidate.accepted(decision, occasion)
        if not decision.accepted:
            s.degraded = s.degraded and not decision.settled
            s.counters.rejected += 1
            self._telling.act(Reject(t, record, decision.reason))
            self._telling.log(t, Level.INFO, "rejected", decision.reason, occasion=str(occasion))
            return
        s.record, s.checked, s.degraded, s.refusal = record, t, False, None
        s.counters.calibrations += 1
        self._telling.act(Store(t, record, decision.reason))
        self._telling.log(t, Level.INFO, "calibrated", decision.reason, occasion=str(occasion))


def _taken(found: calibrate.Candidate | NotSupported) -> calibrate.Candidate:
    """Return the candidate, or raise the refusal."""
    if isinstance(found, NotSupported):
        raise found
    return found


def _left_open(fit: AccelerometerFit) -> tuple[int, float]:
    """Order fits: more parameters first, then the smaller uncertainty along the worst direction."""
    return -fit.parameters, fit.worst_norm_uncertainty
