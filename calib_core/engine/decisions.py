"""What the engine decides: checks, updates of the gyroscope's bias, and full calibrations.

`fit_and_decide` is a full calibration as one pure function: a FitTask goes in, a FitOutcome comes out.
`CalibrationPolicy` applies that, the hourly check and the bias update to what the engine has gathered, and
changes the engine's state accordingly. When a decision is due is not decided here (schedule.py, engine.py);
the statistical rules are those of drift_check.py and acceptance.py.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stillcal.calib_core.accelerometer.fit import AccelerometerFit
from stillcal.calib_core.calibration.acceptance import decide, with_decision
from stillcal.calib_core.calibration.adoption import terms_of
from stillcal.calib_core.calibration.bias_curve import Learnt, learn_gyroscope
from stillcal.calib_core.calibration.candidate import (
    CalibrateSettings,
    Candidate,
    fit_candidate,
    inherit_scale,
    with_rotation_bound,
    with_updated_bias,
)
from stillcal.calib_core.calibration.constancy import LateChange, Shape, find_late_change
from stillcal.calib_core.calibration.drift_check import (
    QualitySettings,
    Verdict,
    check_calibration,
    stepped_since,
)
from stillcal.calib_core.calibration.fingerprint import is_other_phone
from stillcal.calib_core.calibration.following import (
    follow_accelerometer,
    with_learnt_forecast,
    with_learnt_gyroscope,
)
from stillcal.calib_core.calibration.gyroscope_alone import first_bias, followed_up
from stillcal.calib_core.calibration.known_faces import calibrate_faces, inherit_rotation, turned_as
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.calibration.suspicion import Suspicion
from stillcal.calib_core.calibration.terms import compensated
from stillcal.calib_core.calibration.trial import TESTED, Trial, judge
from stillcal.calib_core.engine.actions import Action, Diagnose, Level, Log, Publish, Reject
from stillcal.calib_core.engine.schedule import (
    CalibrationStatus,
    Occasion,
    calibration_due,
    wandered_by,
)
from stillcal.calib_core.engine.sensor_faults import is_deaf, sensor_faults, shows_enough, told
from stillcal.calib_core.engine.settings import EngineSettings
from stillcal.calib_core.engine.state import EngineState, Refusal, Trouble
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.streams.samples import Sensor

LEAST_UNSEEN_S = 300.0
"""A recording that ends so long after its last rest, s, may have become another phone's."""

RESTS_SHOW = 9
"""Parameters of an accelerometer that rests in unknown attitudes can show."""

STEP_LIMIT = 0.05
"""m/s^2 (5 mg): a bias that steps by more is another sensor's from then on. Temperature and time change a
phone's bias by less from one rest to the next."""


@dataclass(frozen=True, slots=True, eq=False)
class FitTask:
    """All that a full calibration needs.

    t: s, sample time of the fit. confirmed: for each rest of the pool, whether the noise floor as it is known
    by now confirms that it was a rest. current: the calibration in use. degraded: whether that one has failed
    its check. sound_until: s, when it last passed a check.
    """

    t: float
    occasion: Occasion
    pool: Pool
    confirmed: tuple[bool, ...]
    gravity: Gravity
    current: CalibrationRecord | None = None
    degraded: bool = False
    sound_until: float | None = None
    settings: CalibrateSettings = field(default_factory=CalibrateSettings)
    quality: QualitySettings = field(default_factory=QualitySettings)


@dataclass(frozen=True, slots=True, eq=False)
class FitOutcome:
    """The result of a full calibration.

    record: None where the rests do not support a fit; `reason` then says why and `missing` what to gather.
    accepted: whether the record replaces the current one. settled: whether enough rests were held out to
    tell. since: s, where the sensor has changed: rests from before were left out; else None. other_phone:
    whether bias and scale are those of another phone than the current calibration's. late: what the newest
    rests show that do not fit, None where they do.
    """

    record: CalibrationRecord | None
    accepted: bool
    reason: str
    missing: tuple[str, ...] = ()
    settled: bool = True
    since: float | None = None
    other_phone: bool = False
    late: LateChange | None = None


def fit_and_decide(task: FitTask) -> FitOutcome:
    """Fit the rests gathered, and decide whether the fit replaces the current calibration."""
    candidate, since = _candidate(task)
    other_phone = isinstance(candidate, Candidate) and is_other_phone(candidate.record, task.current)
    if other_phone:
        candidate, since = _candidate(replace(task, current=None))  # nothing else is the other phone's either
    if isinstance(candidate, NotSupported):
        return FitOutcome(None, False, candidate.reason, candidate.missing)
    decision = decide(candidate, task.current, task.degraded, task.quality)
    record = with_decision(candidate, decision, task.occasion)
    if other_phone:
        record = _remarked(record, "bias and scale are as another phone's: no term of the old one is kept")
    else:
        record = inherit_scale(task.current, inherit_rotation(task.current, record))
    if since is not None and not task.degraded:
        record = _remarked(record, f"the sensor changed: only its rests from {since:.0f} s on are used")
    if (unseen := _unseen(task)) is not None:
        record = _remarked(record, f"no rest in the last {unseen:.0f} s: unknown whether it holds there")
    late = find_late_change(candidate.accelerometer, candidate.pool.held)
    if late is not None:
        record = _remarked(record, f"the newest rests, from {late.since:.0f} s on, do not fit it")
    reason = record.acceptance.reason
    return FitOutcome(record, decision.accepted, reason, (), decision.settled, since, other_phone, late)


def _remarked(record: CalibrationRecord, remark: str) -> CalibrationRecord:
    """Return the record with a remark after the reason that it was decided on."""
    acceptance = replace(record.acceptance, reason=f"{record.acceptance.reason}; {remark}")
    return replace(record, acceptance=acceptance)


def _unseen(task: FitTask) -> float | None:
    """Return for how long (s) there was no rest before a recording's end, if for longer than it had rests."""
    begin = min(rest.t_start for rest in task.pool.rests)
    end = max(rest.t_end for rest in task.pool.rests)
    long = task.t - end > max(LEAST_UNSEEN_S, end - begin)
    return task.t - end if task.occasion is Occasion.END and long else None


def _candidate(task: FitTask) -> tuple[Candidate | NotSupported, float | None]:
    """Fit the pool, or its rests since the sensor changed; return the fit and since when (s), else None.

    A bias that steps by more than STEP_LIMIT among the rests is another sensor's from then on: another phone,
    a fall, a restart. What came before it is left out, and where too little came after it nothing is fitted.
    """
    confirmed = {id(held.rest): sound for held, sound in zip(task.pool.held, task.confirmed, strict=True)}
    candidate, since = _since_sound(task, confirmed)
    change = None if isinstance(candidate, NotSupported) else candidate.change
    if change is None or change.shape is not Shape.STEP or change.largest <= STEP_LIMIT:
        return candidate, since
    newer = _fit(task.pool.since(change.at), confirmed, task)
    if isinstance(newer, NotSupported):
        reason = f"{change.words()}, as if it were another sensor's from then on; since then, {newer.reason}"
        return NotSupported(reason, newer.missing), None
    return newer, change.at


def _since_sound(task: FitTask, confirmed: dict[int, bool]) -> tuple[Candidate | NotSupported, float | None]:
    """Fit the pool, or after a failed check perhaps only the rests since the last passed one.

    The older rests stay only if one calibration explains them and the recent ones. Otherwise the sensor has
    changed, and only the recent rests are used.
    """
    recent = task.pool.since(task.sound_until) if task.degraded else task.pool
    whole = _fit(task.pool, confirmed, task)
    if len(recent.held) == len(task.pool.held):
        return whole, None
    if isinstance(whole, Candidate):
        check = check_calibration(whole.record, recent, task.quality)
        if check.verdict is not Verdict.RECALIBRATE:
            return whole, None
    candidate = _fit(recent, confirmed, task)
    return candidate, None if isinstance(candidate, NotSupported) else task.sound_until


def _fit(pool: Pool, confirmed: dict[int, bool], task: FitTask) -> Candidate | NotSupported:
    """Fit the confirmed rests, or all rests: whichever leaves less uncertain.

    A doubtful rest that was still adds an attitude; one that was not adds scatter.
    """
    certain = pool.where(lambda rest: confirmed[id(rest)])
    of_all = _candidate_or_refusal(pool, task)
    if len(certain.held) == len(pool.held) or isinstance(of_all, NotSupported):
        return of_all
    of_certain = _candidate_or_refusal(certain, task)
    if isinstance(of_certain, NotSupported):
        return of_all
    return min(of_certain, of_all, key=lambda c: _rank(c.accelerometer))


def _candidate_or_refusal(pool: Pool, task: FitTask) -> Candidate | NotSupported:
    try:
        return fit_candidate(pool, task.gravity, task.t, task.settings, task.current)
    except NotSupported as refusal:
        return refusal


def _rank(fit: AccelerometerFit) -> tuple[bool, int, float]:
    """Order fits: those without a prior, more parameters, less uncertain along the worst direction first."""
    return fit.with_prior, -fit.parameters, fit.worst_norm_uncertainty


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

        Whatever the accelerometer's check says, the gyroscope's bias is measured anew.
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
        self.update_bias(t, since)
        if check.verdict is Verdict.RECALIBRATE:
            wrong_since = since if check.off_since is None else check.off_since
            self._degrade(t, wrong_since, check.accel_largest or 0.0)
        else:
            state.trouble = None
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

    def update_bias(self, t: float, since: float | None) -> None:
        """Measure the gyroscope's bias anew on the rests since a time, s, if they have rates (4.7)."""
        record = self._state.record
        if record is None or record.provisional:
            self.measure_gyroscope_alone(t)
        else:
            recent = compensated(self._rests_since(since), record)
            updated = with_updated_bias(record, recent, t)
            self._publish_bias(None if updated is None else self._learnt(updated, t), t)

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

    def _learnt(self, record: CalibrationRecord, t: float) -> CalibrationRecord:
        """Return a record with the gyroscope's bias by temperature and time as all rests kept show it."""
        learnt = self._learn(record, t)
        return record if learnt is None else with_learnt_gyroscope(record, learnt, t)

    def _learn(self, record: CalibrationRecord, t: float) -> Learnt | None:
        """Return what the rests kept show of the gyroscope's bias; None where it is not to be learnt."""
        if not self._settings.schedule.learn_temperature:
            return None
        return learn_gyroscope(self._state.memory, record, t, self._settings.quality)

    def _refined(self, record: CalibrationRecord, t: float) -> CalibrationRecord:
        """Return a calibration fitted just now with the gyroscope's bias as learnt; its reason says both."""
        learnt = self._learnt(record, t)
        if learnt.acceptance.how != "terms":
            return replace(learnt, acceptance=record.acceptance)
        return _remarked(replace(learnt, acceptance=record.acceptance), learnt.acceptance.reason)

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
