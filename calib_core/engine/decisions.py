"""What the engine decides: checks, updates of the gyroscope's bias, and full calibrations.

`CalibrationPolicy` applies a full calibration (full_calibration.py), the hourly check and the bias update to
what the engine has gathered, and changes the engine's state accordingly. When a decision is due is not
decided here (schedule.py, engine.py); the statistical rules are those of drift_check.py and acceptance.py.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from stillcal.calib_core.calibration.acceptance import with_remark
from stillcal.calib_core.calibration.adoption import terms_of
from stillcal.calib_core.calibration.bias_curve.learn import learn_gyroscope
from stillcal.calib_core.calibration.bias_curve.learnt import Learnt
from stillcal.calib_core.calibration.candidate import (
    inherit_scale,
    with_rotation_bound,
    with_updated_bias,
)
from stillcal.calib_core.calibration.drift_check import (
    Verdict,
    check_calibration,
    stepped_since,
)
from stillcal.calib_core.calibration.following import (
    follow_accelerometer,
    with_learnt_forecast,
    with_learnt_gyroscope,
)
from stillcal.calib_core.calibration.gyroscope_alone import first_bias, followed_up
from stillcal.calib_core.calibration.known_faces import calibrate_faces, turned_as
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.calibration.suspicion import Suspicion
from stillcal.calib_core.calibration.terms import compensated
from stillcal.calib_core.calibration.trial import TESTED, Trial, judge
from stillcal.calib_core.engine.actions import Action, Diagnose, Level, Log, Publish, Reject
from stillcal.calib_core.engine.full_calibration import FitOutcome, FitTask, fit_and_decide
from stillcal.calib_core.engine.schedule import (
    CalibrationStatus,
    Occasion,
    accelerometer_wandered,
    calibration_due,
    first_of_its_hour,
    wandered_by,
)
from stillcal.calib_core.engine.sensor_faults import is_deaf, sensor_faults, shows_enough, told
from stillcal.calib_core.engine.settings import EngineSettings
from stillcal.calib_core.engine.state import EngineState, Refusal, Trouble
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.streams.samples import Sensor

RESTS_SHOW = 9
"""Parameters of an accelerometer that rests in unknown attitudes can show."""


def _is_whole(record: CalibrationRecord | None) -> bool:
    """Tell whether rests alone have shown bias, scale and cross-axis terms of the accelerometer."""
    part = None if record is None else record.accelerometer
    return part is not None and not part.with_prior and part.parameters >= RESTS_SHOW


def _without(suspected: dict[Sensor, Suspicion], sensor: Sensor) -> dict[Sensor, Suspicion]:
    """Return what is suspected of other sensors."""
    return {other: step for other, step in suspected.items() if other is not sensor}


class CalibrationPolicy:
    """Checks, updates and renews the calibration in the engine's `state`.

    detector: says whether a rest still counts as one by the noise floor known now. actions: what the daemon
    is to do is appended to this list.
    """

    def __init__(
        self,
        settings: EngineSettings,
        state: EngineState,
        detector: StationaryDetector,
        actions: list[Action],
    ) -> None:
        self._settings, self._state, self._detector, self._actions = settings, state, detector, actions
        self._unchanged: tuple[object, ...] = ()
        """What the last look for a change, which found none, went by."""

    def check(self, t: float) -> None:
        """Check the calibration on the rests since the last check, if there are any (4.7). t: s.

        Whatever the accelerometer's check says, the gyroscope's bias is measured anew. How it wanders, and
        the accelerometer's bias, which moves less, are learnt anew by the first check of an hour; the latter
        also by one that fails, and where it is expected to have wandered too far.
        """
        state = self._state
        if state.record is None:
            state.check_due = False
            return
        since = state.checked
        recent = self._rests_since(since)
        if state.record.accelerometer is None:
            self._check_gyroscope_alone(t, recent)
            return
        check = check_calibration(state.record, recent, self._settings.quality)
        if check.verdict is Verdict.WAIT:
            self._update_bias_when_due(t)
            return
        state.check_due, state.checked, state.suspected = False, t, {}
        state.counters.checks += 1
        self._actions.append(Log(t, Level.INFO, "check", f"{check.verdict}", check.figures()))
        first = first_of_its_hour(state, since, self._settings.schedule)
        self.update_bias(t, since, search=first)
        if check.verdict is Verdict.RECALIBRATE:
            wrong_since = since if check.off_since is None else check.off_since
            self._degrade(t, wrong_since, check.accel_largest or 0.0)
        else:
            state.trouble = None
        if state.degraded or first or accelerometer_wandered(state, t, self._settings.schedule):
            self._follow(t)
        state.early_check = wandered_by(state, t, self._settings.schedule)

    def inspect_sensors(self, t: float, silent: bool) -> None:
        """Log at t (s) which sensors have failed since the last time, and which are well again.

        silent: whether the accelerometer sends no samples.
        """
        state, ledger = self._state, self._detector.ledger
        before, has_gyroscope = state.faults, Sensor.GYROSCOPE in state.latest
        state.faults = sensor_faults(state.inspected, ledger, has_gyroscope, silent, before)
        if state.rates_doubted:
            state.faults[Sensor.GYROSCOPE] = state.rates_doubted
        if is_deaf(state.inspected, ledger):
            self._detector.learn_gyroscope_anew()
        if shows_enough(state.inspected, ledger):
            state.inspected = ledger
        self._actions += told(t, before, state.faults)

    def notice_change(self, t: float) -> None:
        """Check at t (s) before a check is due where the rests since the last one already show a change.

        A step of the gyroscope's bias is followed at once too, by the rests since then.
        """
        state = self._state
        if state.record is None:
            return
        goes_by = (state.record, state.pool, state.checked, state.degraded, *self._detector.judged_by)
        if goes_by == self._unchanged:
            return
        if not self._noticed_change(t, state.record):
            self._unchanged = goes_by

    def _noticed_change(self, t: float, record: CalibrationRecord) -> bool:
        """Follow a change that the rests since the last check show; tell whether there was one."""
        state = self._state
        recent, quality = self._rests_since(state.checked), self._settings.quality
        sound = record.accelerometer is not None and not state.degraded
        if sound and check_calibration(record, recent, quality).verdict is Verdict.RECALIBRATE:
            self.check(t)
            return True
        part = record.gyroscope
        if part is None or record.provisional:
            return False
        held = compensated(recent.since(part.zeroed_at), record).held
        since = stepped_since(part.bias, held, quality)
        if since is not None:
            self.update_bias(t, since)
        return since is not None

    def update_bias(self, t: float, since: float | None, *, search: bool = True) -> None:
        """Measure the gyroscope's bias anew on the rests since a time, s, if they have rates (4.7).

        search: whether how it wanders is looked for too.
        """
        record = self._state.record
        if record is None or record.provisional:
            self.measure_gyroscope_alone(t)
        else:
            recent = compensated(self._rests_since(since), record)
            updated = with_updated_bias(record, recent, t)
            self._publish_bias(None if updated is None else self._learnt(updated, t, search=search), t)

    def measure_gyroscope_alone(self, t: float) -> None:
        """Before the first full calibration, publish the gyroscope's bias, or confirm the one published.

        The first one is provisional: a gyroscope's bias moves while the phone warms up after its start.
        gyroscope_alone.py has the rules. Both are logged. Does nothing where there is a full calibration.
        """
        state = self._state
        if not any(held.rest.rate is not None for held in state.pool.held):
            return
        if state.record is None:
            rests = self._rests_since(None)
            alone = first_bias(rests, state.gravity, t, self._settings.quality)
        elif state.record.provisional:
            alone = followed_up(state.record, self._rests_since(None), t, self._settings.quality)
        else:
            return
        if alone is None or alone.gyroscope is None:
            return
        learnt = self._learn(alone, t)
        self._publish_bias(alone if learnt is None else with_learnt_forecast(alone, learnt), t)
        figures = {"largest": float(np.abs(alone.gyroscope.bias).max())}
        self._actions.append(Log(t, Level.INFO, "gyroscope", alone.acceptance.reason, figures))

    def _check_gyroscope_alone(self, t: float, recent: Pool) -> None:
        """Carry out a check of a calibration that has no accelerometer part yet."""
        state = self._state
        if not any(rest.rate is not None for rest in recent.rests):
            return
        since, state.checked, state.check_due = state.checked, t, False
        state.counters.checks += 1
        self.update_bias(t, since)

    def _update_bias_when_due(self, t: float) -> None:
        """Measure the bias once per check interval while the accelerometer's check waits for more rests."""
        state = self._state
        part = None if state.record is None else state.record.gyroscope
        measured = None if part is None else part.zeroed_at
        if measured is None:
            self.update_bias(t, state.checked)
        elif t - measured >= self._settings.schedule.check_interval_s:
            self.update_bias(t, measured)

    def _publish_bias(self, updated: CalibrationRecord | None, t: float) -> None:
        if updated is not None:
            state = self._state
            updated = with_rotation_bound(updated, self._rests_since(None))
            state.record, state.suspected = updated, _without(state.suspected, Sensor.GYROSCOPE)
            state.counters.zeroings += 1
            self._actions.append(Publish(t, updated, updated.acceptance.reason))

    def _learnt(self, record: CalibrationRecord, t: float, *, search: bool = True) -> CalibrationRecord:
        """Return a record with the gyroscope's bias by temperature and time as all rests kept show it."""
        learnt = self._learn(record, t, search=search)
        return record if learnt is None else with_learnt_gyroscope(record, learnt, t)

    def _learn(self, record: CalibrationRecord, t: float, *, search: bool = True) -> Learnt | None:
        """Return what the rests kept show of the gyroscope's bias; None where it is not to be learnt."""
        if not self._settings.schedule.learn_temperature:
            return None
        return learn_gyroscope(self._state.memory, record, t, self._settings.quality, search=search)

    def _refined(self, record: CalibrationRecord, t: float) -> CalibrationRecord:
        """Return a calibration fitted just now with the gyroscope's bias as learnt; its reason says both."""
        learnt = self._learnt(record, t)
        if learnt.acceptance.how != "terms":
            return replace(learnt, acceptance=record.acceptance)
        return with_remark(replace(learnt, acceptance=record.acceptance), learnt.acceptance.reason)

    def _follow(self, t: float) -> None:
        """Renew what is known of the accelerometer at t (s); replace its calibration where that is allowed.

        One that failed its check stays degraded until the uncertainty of its fit is below what a check
        notices.
        """
        state, limit = self._state, self._settings.quality.accel_limit
        before = state.record
        accepted = self._followed(t, fresh=False)
        if state.record is None or before is None:
            return
        if not accepted:
            if state.record.accelerometer is not before.accelerometer:
                self._actions.append(Publish(t, state.record, state.record.acceptance.reason))
            return
        fit = state.record.forecast[str(Sensor.ACCELEROMETER)].of_fit()
        if fit.bias_uncertainty(t, None).max() < limit:
            state.degraded = False
        state.checked = t
        self._publish(t, "check")

    def _followed(self, t: float, fresh: bool) -> bool:
        """Learn the accelerometer's calibration at t (s); tell whether the one in use was replaced.

        fresh: it was fitted just now.
        """
        state = self._state
        if state.record is None or not self._settings.schedule.learn_temperature:
            return False
        followed = follow_accelerometer(
            state.record,
            state.memory,
            t,
            self._settings.quality,
            degraded=state.degraded,
            fresh=fresh,
            centre=state.centre,
        )
        if followed is None:
            return False
        state.record, state.centre = followed.record, followed.centre
        return followed.accepted

    def _rests_since(self, t: float | None) -> Pool:
        """Return the rests from t (s) on, None for all, that the noise floor known now confirms."""
        return self._state.pool.since(t).where(self._detector.still_valid)

    def consider(self, t: float, findings: Iterable[Mapping[str, Any]]) -> None:
        """Judge the terms on trial at t (s), then put those that a diagnosis has found anew on trial.

        A term that was found is tested on later rests only, whether it is in use by then or not.
        """
        state = self._state
        if state.record is None or state.record.gyroscope is None or state.record.provisional:
            return
        going_on = {}
        for trial in state.trials:
            outcome = judge(trial, state.record, state.memory, t, self._settings.quality)
            if outcome.record is not None:
                state.record = outcome.record
                self._actions.append(Publish(t, state.record, state.record.acceptance.reason))
                self._actions.append(Log(t, Level.INFO, "terms", state.record.acceptance.reason))
            elif not outcome.decided:
                going_on[trial.term.effect] = trial
        held = {term.effect: term for term in state.record.terms}
        testable = [finding for finding in findings if finding["effect"] in TESTED]
        proposed = {**terms_of(state.record, testable), **held}
        new = {e: Trial(proposed[e], t) for e in TESTED if e in proposed}
        state.trials = tuple({**new, **{e: going_on[e] for e in new if e in going_on}}.values())

    def calibrate(self, t: float, occasion: Occasion) -> None:
        """Try a full calibration at t (s) if one is due on this occasion."""
        state = self._state
        since_try = math.inf if state.tried is None else t - state.tried
        status = CalibrationStatus(state.complete, state.degraded, state.fresh, since_try)
        if not calibration_due(status, occasion, self._settings.schedule):
            return
        state.fresh, state.tried = 0, t
        if state.trouble is not None:
            state.trouble = replace(state.trouble, tried=True)
        self._apply(t, fit_and_decide(self._task(t, occasion)), occasion)

    def calibrate_by_faces(self, t: float, laid: Pool, unquestioned: Collection[int]) -> str:
        """Calibrate at t (s) from rests among which are the six faces; return the reason to be told.

        Faces show the rotation common to all axes. Bias, scale and cross-axis terms stay as rests have shown
        them, where rests alone have or do so now. unquestioned: faces that may disagree with the others.
        Raises NotSupported where faces are too far from square and level, or another one disagrees.
        """
        state = self._state
        faces = calibrate_faces(laid, state.gravity, t, self._settings.calibrate, unquestioned)
        if state.degraded or not _is_whole(state.record):
            outcome = fit_and_decide(self._task(t, Occasion.ASKED))
            if outcome.accepted and _is_whole(outcome.record):
                self._apply(t, outcome, Occasion.ASKED)
        if _is_whole(state.record) and not state.degraded:
            self._turn(t, faces)
        else:
            known = None if state.record is None else turned_as(faces, state.record)
            self._adopt(t, inherit_scale(known, faces), Occasion.ASKED)
        return faces.acceptance.reason

    def _turn(self, t: float, faces: CalibrationRecord) -> None:
        """Turn the calibration in use at t (s) as known faces show it."""
        state = self._state
        assert state.record is not None
        state.record = replace(turned_as(faces, state.record), acceptance=faces.acceptance)
        state.centre = None if state.centre is None else turned_as(faces, state.centre)
        self._publish(t, Occasion.ASKED)

    def _task(self, t: float, occasion: Occasion) -> FitTask:
        """Return a full calibration to be tried at t (s)."""
        state = self._state
        return FitTask(
            t=t,
            occasion=occasion,
            pool=state.pool,
            confirmed=tuple(self._detector.still_valid(h.rest) for h in state.pool.held),
            gravity=state.gravity,
            current=state.record,
            degraded=state.degraded,
            sound_until=state.sound_until,
            settings=self._settings.calibrate,
            quality=self._settings.quality,
        )

    def _degrade(self, t: float, since: float | None, size: float) -> None:
        """Mark the calibration as degraded; `since` (s) is from when on it may have been wrong.

        size: m/s^2, the largest residual of a rest: the bias may be off by as much.
        """
        state = self._state
        if not state.degraded:
            state.degraded, state.sound_until = True, since
            state.counters.degradations += 1
            why = "the calibration no longer fits: gathering rests again"
            self._actions.append(Log(t, Level.WARNING, "degraded", why))
        state.trouble = (state.trouble or Trouble(t)).after_failed_check(size)
        if state.trouble.failed == self._settings.schedule.diagnose_after_checks:
            self._actions.append(Diagnose(t, state.trouble.reason))
        if state.charging:
            self.calibrate(t, Occasion.CHARGING)

    def _apply(self, t: float, outcome: FitOutcome, occasion: Occasion) -> None:
        """Change the state as a full calibration's outcome says, and report it."""
        state = self._state
        if outcome.record is None:
            self._report_refusal(t, outcome, occasion)
            return
        if outcome.since is not None:
            state.pool = state.pool.since(outcome.since)
            state.attitudes = len(state.pool.attitudes(self._settings.pool))
        fields = {"occasion": str(occasion)}
        if not outcome.accepted:
            state.degraded = state.degraded and not outcome.settled
            if state.calibrated and not state.complete:
                self._actions.append(Log(t, Level.DEBUG, "rejected", outcome.reason, fields))
                return
            state.counters.rejected += 1
            self._actions.append(Reject(t, outcome.record, outcome.reason))
            self._actions.append(Log(t, Level.INFO, "rejected", outcome.reason, fields))
            return
        if outcome.other_phone:
            state.trials = ()
            state.memory = state.memory.where(state.memory.t >= (outcome.since or state.sound_until or t))
        self._adopt(t, outcome.record, occasion)
        if outcome.late is not None:
            self._degrade(t, outcome.late.since, outcome.late.largest)

    def _adopt(self, t: float, record: CalibrationRecord, occasion: Occasion) -> None:
        """Use a calibration fitted at t (s) from now on, refined by what was learnt from all rests kept."""
        state = self._state
        state.record, state.checked, state.degraded, state.refusal = record, t, False, None
        state.centre, state.suspected = None, {}
        if record.gyroscope is not None:
            state.record = with_rotation_bound(self._refined(record, t), self._rests_since(None))
        self._followed(t, fresh=True)
        self._publish(t, occasion)

    def _publish(self, t: float, occasion: str) -> None:
        """Publish a new calibration, the one in use at t (s), and log it."""
        state = self._state
        assert state.record is not None
        state.counters.calibrations += 1
        reason = state.record.acceptance.reason
        self._actions.append(Publish(t, state.record, reason))
        self._actions.append(Log(t, Level.INFO, "calibrated", reason, {"occasion": str(occasion)}))

    def _report_refusal(self, t: float, outcome: FitOutcome, occasion: Occasion) -> None:
        """Report why there is no fit; one that asks for the same rests again goes to the debug log."""
        state = self._state
        state.counters.refused += 1
        is_new = state.refusal is None or state.refusal.missing != outcome.missing
        state.refusal = Refusal(outcome.reason, outcome.missing)
        why = str(NotSupported(outcome.reason, outcome.missing))
        level = Level.INFO if is_new else Level.DEBUG
        self._actions.append(Log(t, level, "refused", why, {"occasion": str(occasion)}))
