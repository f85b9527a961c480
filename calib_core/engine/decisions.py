"""A full calibration as one task: all that it takes goes in, all that follows comes out; pure."""

from __future__ import annotations

from dataclasses import dataclass, field

from stillcal.calib_core.accelerometer.fit import AccelerometerFit
from stillcal.calib_core.calibration import candidate as calibrate
from stillcal.calib_core.calibration.candidate import CalibrateSettings, Candidate
from stillcal.calib_core.calibration.drift_check import QualitySettings, Verdict
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.calibration.terms import inherit_terms
from stillcal.calib_core.engine.schedule import Occasion
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gravity import Gravity


@dataclass(frozen=True, slots=True, eq=False)
class FitTask:
    """What is to be fitted, and against what it is to be held. t: s, when.

    sure: for each rest of the pool, whether the noise floor as known by now confirms it. current: the
    calibration in use; degraded: whether it has failed its check; sound_until: s, when it last passed.
    """

    t: float
    occasion: Occasion
    pool: Pool
    sure: tuple[bool, ...]
    gravity: Gravity
    current: CalibrationRecord | None = None
    degraded: bool = False
    sound_until: float | None = None
    settings: CalibrateSettings = field(default_factory=CalibrateSettings)
    quality: QualitySettings = field(default_factory=QualitySettings)


@dataclass(frozen=True, slots=True, eq=False)
class FitOutcome:
    """What came of it. record: None where the rests support none, for the `reason`, and what is `missing`.

    accepted: whether the record replaces the current one; settled: whether there was enough to tell.
    recent_only: whether the rests from before sound_until were left out, being of another sensor by now.
    """

    record: CalibrationRecord | None
    accepted: bool
    reason: str
    missing: tuple[str, ...] = ()
    settled: bool = True
    recent_only: bool = False


def fitted(task: FitTask) -> FitOutcome:
    """Fit what was gathered, and decide whether it replaces the current calibration."""
    found, recent_only = _candidate(task)
    if isinstance(found, NotSupported):
        return FitOutcome(None, False, found.reason, found.missing)
    decision = calibrate.decide(found, task.current, task.degraded, task.quality)
    record = inherit_terms(task.current, found.accepted(decision, task.occasion))
    return FitOutcome(record, decision.accepted, decision.reason, (), decision.settled, recent_only)


def _candidate(task: FitTask) -> tuple[Candidate | NotSupported, bool]:
    """Fit the pool, and say whether only what came after the last check that passed.

    After a failed check, what was gathered before it is only kept as long as one calibration
    explains both: otherwise the sensor has changed, and the older rests go.
    """
    sure = {id(held.rest): sound for held, sound in zip(task.pool.held, task.sure, strict=True)}
    recent = task.pool.since(task.sound_until) if task.degraded else task.pool
    whole = _fit(task.pool, sure, task)
    if len(recent.held) == len(task.pool.held):
        return whole, False
    if isinstance(whole, Candidate):
        check = calibrate.checked(whole.record, recent, task.quality)
        if check.verdict is not Verdict.RECALIBRATE:
            return whole, False
    found = _fit(recent, sure, task)
    return found, not isinstance(found, NotSupported)


def _fit(pool: Pool, sure: dict[int, bool], task: FitTask) -> Candidate | NotSupported:
    """Fit the rests that the noise floor, as known by now, confirms, or all: whichever leaves less open.

    A doubtful rest that is one adds an attitude; one that is none adds scatter.
    """
    confirmed = pool.where(lambda rest: sure[id(rest)])
    everything = _fitted_or_refused(pool, task)
    if len(confirmed.held) == len(pool.held) or isinstance(everything, NotSupported):
        return everything
    fewer = _fitted_or_refused(confirmed, task)
    if isinstance(fewer, NotSupported):
        return everything
    return min(fewer, everything, key=lambda c: _left_open(c.accelerometer))


def _fitted_or_refused(pool: Pool, task: FitTask) -> Candidate | NotSupported:
    try:
        return calibrate.candidate(pool, task.gravity, task.t, task.settings)
    except NotSupported as refusal:
        return refusal


def _left_open(fit: AccelerometerFit) -> tuple[int, float]:
    """Order fits: more parameters first, then the smaller uncertainty along the worst direction."""
    return -fit.parameters, fit.worst_norm_uncertainty
