"""A full calibration as one pure function: a FitTask goes in, a FitOutcome comes out.

What the engine has gathered is fitted, and the fit replaces the calibration in use or does not. The
statistical rules are those of acceptance.py, drift_check.py and constancy.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from stillcal.calib_core.accelerometer.fit import AccelerometerFit
from stillcal.calib_core.calibration.acceptance import decide, with_decision, with_remark
from stillcal.calib_core.calibration.candidate import (
    CalibrateSettings,
    Candidate,
    fit_candidate,
    inherit_scale,
)
from stillcal.calib_core.calibration.constancy import LateChange, Shape, find_late_change
from stillcal.calib_core.calibration.drift_check import QualitySettings, Verdict, check_calibration
from stillcal.calib_core.calibration.fingerprint import is_other_phone
from stillcal.calib_core.calibration.known_faces import inherit_rotation
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.engine.schedule import Occasion
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import Gravity

LEAST_UNSEEN_S = 300.0
"""A recording that ends so long after its last rest, s, may have become another phone's."""

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
        record = with_remark(record, "bias and scale are as another phone's: no term of the old one is kept")
    else:
        record = inherit_scale(task.current, inherit_rotation(task.current, record))
    if since is not None and not task.degraded:
        record = with_remark(record, f"the sensor changed: only its rests from {since:.0f} s on are used")
    if (unseen := _unseen(task)) is not None:
        record = with_remark(record, f"no rest in the last {unseen:.0f} s: unknown whether it holds there")
    late = find_late_change(candidate.accelerometer, candidate.pool.held)
    if late is not None:
        record = with_remark(record, f"the newest rests, from {late.since:.0f} s on, do not fit it")
    reason = record.acceptance.reason
    return FitOutcome(record, decision.accepted, reason, (), decision.settled, since, other_phone, late)


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
    if len(certain.held) == len(pool.held):
        return of_all
    both = (_candidate_or_refusal(certain, task), of_all)
    fits = [one for one in both if isinstance(one, Candidate)]
    return min(fits, key=lambda c: _rank(c.accelerometer)) if fits else of_all


def _candidate_or_refusal(pool: Pool, task: FitTask) -> Candidate | NotSupported:
    try:
        return fit_candidate(pool, task.gravity, task.t, task.settings, task.current)
    except NotSupported as refusal:
        return refusal


def _rank(fit: AccelerometerFit) -> tuple[bool, int, float]:
    """Order fits: those without a prior, more parameters, less uncertain along the worst direction first."""
    return fit.with_prior, -fit.parameters, fit.worst_norm_uncertainty
