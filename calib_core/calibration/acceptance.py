"""The acceptance rule: whether a new calibration may replace the one in use.

The new calibration must explain rests that neither calibration was fitted to better than the old one does,
by more than chance would. The rests held out are those taken since the old calibration was fitted; the new
one is refitted without each of them (cross-validation by attitude). The test is a sign-flip test on paired
log scores (Fisher 1935, The Design of Experiments, section 21).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.accelerometer.parameters import BIAS, basis, norm_rows
from stillcal.calib_core.accelerometer.prior import SOUND_PHONES
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.candidate import ASSUMED_SCATTER, Candidate, fit_accelerometer
from stillcal.calib_core.calibration.drift_check import QualitySettings, norm_residuals
from stillcal.calib_core.calibration.record import (
    AccelerometerRecord,
    Acceptance,
    CalibrationRecord,
    Evidence,
)
from stillcal.calib_core.calibration.terms import compensated
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.model import SensorModel

_PATTERNS_AT_ONCE = 128
_ALL_SIGN_PATTERNS = 12
"""Up to this many attitudes all 2^n sign patterns are tried, 4096 at most; beyond it 4096 are drawn, which
leaves a standard error of 0.0024 on a chance of 0.025."""


CLEARLY = 0.7
"""A stated uncertainty below this share of another one is clearly smaller: half the variance."""

_DIRECTIONS = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z])
_DIRECTIONS = _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)


@dataclass(frozen=True, slots=True)
class Decision:
    """Whether a candidate replaces the calibration in use, the reason, and the figures behind it.

    settled: whether enough attitudes were held out to tell. If so, an old calibration that stays is sound.
    """

    accepted: bool
    reason: str
    evidence: Evidence = field(default_factory=dict)
    settled: bool = True


@dataclass(frozen=True, slots=True)
class Comparison:
    """A new calibration against the old one on rests that neither was fitted to.

    rests: attitudes compared, one value each. gain: mean log score per attitude that the new calibration
    gains, nats. chance: probability that swapping the two at random gains as much. rms_old, rms_new: m/s^2,
    root mean square of the held-out residuals. better: the gain is more than chance. chance_worse:
    probability that swapping the two at random loses as much.
    """

    rests: int
    gain: float
    chance: float
    rms_old: float
    rms_new: float
    better: bool
    chance_worse: float = 1.0


def decide(
    new: Candidate, old: CalibrationRecord | None, degraded: bool, settings: QualitySettings
) -> Decision:
    """Decide whether `new` replaces `old`: only if it explains held-out rests better, by more than chance.

    degraded: the old calibration has failed its check. The rests that it failed on are then the evidence
    against it, and the new one only has to be no worse. A first calibration is always accepted. One that is
    not worse by more than chance is accepted too where its stated uncertainty is clearly smaller. Where a
    prior entered the old one, any number of rests held out suffices for that: the new one assumes less.
    """
    if old is None or old.accelerometer is None:
        return Decision(True, "the first calibration", {"rms_residual": new.accelerometer.rms_residual})
    comparison = compare_on_held_out_rests(new, old.accelerometer.model, old.fitted_at, settings, old)
    evidence: Evidence = {f"held_out_{name}": value for name, value in asdict(comparison).items()}
    figures = "no attitude was held since the one in use was fitted"
    if comparison.rests:
        rms = f"{comparison.rms_new:.2g} after {comparison.rms_old:.2g} m/s^2"
        figures = f"held-out rms {rms} on {comparison.rests} attitudes"
    if comparison.better:
        return Decision(True, f"better by more than chance: {figures}", evidence)
    if degraded and comparison.rests and comparison.rms_new < comparison.rms_old:
        return Decision(True, f"the old one failed its check: {figures}", evidence)
    enough = comparison.rests >= settings.held_out_rests or old.accelerometer.with_prior
    as_good = enough and comparison.chance_worse > settings.chance
    if as_good and new.record.accelerometer and clearly_smaller(new.record.accelerometer, old.accelerometer):
        return Decision(True, f"as good and less uncertain: {figures}", evidence)
    return Decision(False, f"not better by more than chance: {figures}", evidence, settled=enough)


def clearly_smaller(new: AccelerometerRecord, old: AccelerometerRecord) -> bool:
    """Tell whether a calibration's stated uncertainty, over all directions, is clearly below another's.

    Each step of a chain of such calibrations must shrink the stated uncertainty by CLEARLY, so that all of
    them together cannot lead further than a few times the first one's: the chain cannot creep.
    """
    ours, theirs = stated_uncertainty(new), stated_uncertainty(old)
    return ours is not None and theirs is not None and ours < CLEARLY * theirs


def stated_uncertainty(part: AccelerometerRecord) -> float | None:
    """Return the root mean square over all directions of a norm's stated uncertainty, m/s^2, None if unknown.

    A direction's is that of the calibrated norm of a force of gravity's size, by the parameters' covariance.
    """
    if part.covariance is None or not np.isfinite(part.covariance).all():
        return None
    rows = norm_rows(_DIRECTIONS, basis(part.parameters)) * np.where(
        np.isin(part.names, BIAS), 1.0, part.gravity
    )
    return float(np.sqrt(np.mean(np.einsum("ni,ij,nj->n", rows, part.covariance, rows))))


def with_decision(new: Candidate, decision: Decision, occasion: str) -> CalibrationRecord:
    """Return the candidate's record with the reason and the figures that it was decided on."""
    evidence: Evidence = {"occasion": occasion, **decision.evidence}
    reason = decision.reason
    if new.change is not None:
        evidence |= {"bias_change": new.change.largest, "bias_change_p": new.change.p_value}
        reason = f"{reason}; {new.change.words()}, which widens its interval"
    if new.accelerometer.with_prior:
        evidence |= {"with_prior": True, "worst_direction": new.accelerometer.worst_norm_uncertainty}
        reason = (
            f"{reason}; {new.accelerometer.n_states} attitudes and what is known of sound phones: gravity is "
            f"known to {new.accelerometer.worst_norm_uncertainty:.2g} m/s^2 along the least known direction"
        )
    elif new.accelerometer.n_states <= new.accelerometer.parameters:
        evidence["untested"] = True
        reason = (
            f"{reason}; as many parameters as attitudes: nothing is left to test it, and its interval "
            f"assumes a scatter of {ASSUMED_SCATTER:g} m/s^2"
        )
    return replace(new.record, acceptance=Acceptance(reason=reason, evidence=evidence))


def with_remark(record: CalibrationRecord, remark: str) -> CalibrationRecord:
    """Return the record with a remark after the reason that it was decided on."""
    acceptance = replace(record.acceptance, reason=f"{record.acceptance.reason}; {remark}")
    return replace(record, acceptance=acceptance)


def compare_on_held_out_rests(
    new: Candidate,
    old: SensorModel,
    since: float | None,
    settings: QualitySettings,
    known: CalibrationRecord | None = None,
) -> Comparison:
    """Compare a candidate with an old model on the attitudes taken from `since` (s) on; None takes all.

    The old model took no part in those rests, and the candidate is refitted without each attitude. Rests
    that share an attitude are not independent, so each attitude enters as one mean. known: the old
    calibration with its terms; each calibration corrects the rests by its own.
    """
    held = new.pool.held
    fresh = np.array([since is None or h.rest.t_start >= since for h in held])
    refitted = _cross_validated(new, fresh)
    fresh &= np.isfinite(refitted)
    old_residuals, own = norm_residuals(
        old, (new.pool if known is None else compensated(new.pool, known)).held
    )
    sd = np.hypot(own, new.accelerometer.rms_residual)
    attitudes = [fresh & (new.labels == k) for k in np.unique(new.labels[fresh])]
    old_means, new_means, sd_means = (
        np.array([float(values[a].mean()) for a in attitudes]) for values in (old_residuals, refitted, sd)
    )
    return compare_residuals(old_means, new_means, sd_means, settings)


def compare_residuals(old: Array, new: Array, sd: Array, settings: QualitySettings) -> Comparison:
    """Compare held-out residuals of the old and the new calibration, (n,) each, m/s^2.

    sd: (n,) standard uncertainty of each residual, the same for both, so that no score is won by claiming
    certainty. The gain is a paired mean of Gaussian log scores. If both calibrations were equally good, each
    rest might as well have had its two residuals the other way round. The gain is therefore compared with
    the gains of all such swaps (a sign-flip test, Fisher 1935), which assumes no distribution.
    """
    gains = (old**2 - new**2) / (2 * sd**2)
    n = gains.size
    chance = flipped_share(gains) if n else 1.0
    rms_old, rms_new = rms(old), rms(new)
    better = n >= settings.held_out_rests and chance <= settings.chance
    worse = flipped_share(-gains) if n else 1.0
    return Comparison(n, float(gains.mean()) if n else 0.0, chance, rms_old, rms_new, better, worse)


def _cross_validated(new: Candidate, asked: NDArray[np.bool_]) -> Array:
    """Return residuals (n,), m/s^2, of the rests asked for, each under a fit without its fold of attitudes.

    NaN where the other attitudes do not support a fit, and for rests that were not asked for.
    """
    held = compensated(new.pool, new.record).held
    residuals = np.full(len(held), np.nan)
    folds = new.labels % new.settings.folds
    fitted = new.accelerometer
    parameters, prior = (None, SOUND_PHONES) if fitted.with_prior else (fitted.parameters, None)
    for fold in np.unique(folds[asked]):
        out = folds == fold
        training = [h for h, left_out in zip(held, out, strict=True) if not left_out]
        test = [h for h, left_out in zip(held, out, strict=True) if left_out]
        try:
            fit = fit_accelerometer(training, new.gravity, new.settings.accelerometer, parameters, prior)
        except NotSupported:
            continue
        residuals[out] = norm_residuals(fit.model, test)[0]
    return residuals


def sums_by_block(block: NDArray[np.intp], gains: Array) -> Array:
    """Return the sums of gains (n,) of the same block (n,), so that each block is one piece of evidence."""
    return np.bincount(block, gains).astype(np.float64) if gains.size else np.zeros(0)


MOST_GAIN, ENOUGH_GAIN = 4.5, 10.0
"""nats that one piece of evidence may count, as three standard uncertainties do, and nats that decide."""


def beyond_doubt(gains: Array) -> bool:
    """Tell whether few pieces of held-out evidence leave no doubt. gains: (n,) nats, in log likelihood.

    Three are needed at least. If what is in use were right, and the uncertainties stated too, they would gain
    as much once in 20 000 times at most, however often one looks (Ville's inequality, exp(-ENOUGH_GAIN)). The
    test of signs needs more of them, and no uncertainties.
    """
    return float(np.minimum(gains, MOST_GAIN).sum()) > ENOUGH_GAIN


def flipped_share(gains: Array) -> float:
    """Return the share of sign patterns, all or 4096 drawn ones, whose sum reaches that of `gains`."""
    rounding = 1e-12 * float(np.abs(gains).sum())  # so that the unchanged pattern counts, whatever its sign
    reached = [signs @ gains >= gains.sum() - rounding for signs in _sign_patterns(gains.size)]
    return float(np.mean(np.concatenate(reached)))


def _sign_patterns(n: int) -> Iterator[Array]:
    """Yield patterns of n signs, (m, n), some at a time: those of a month's hours would fill megabytes."""
    if n <= _ALL_SIGN_PATTERNS:
        yield np.asarray(1.0 - 2.0 * (np.arange(2**n)[:, None] >> np.arange(n) & 1), dtype=np.float64)
        return
    yield np.ones((1, n))
    generator = np.random.default_rng(n)
    for _ in range(2**_ALL_SIGN_PATTERNS // _PATTERNS_AT_ONCE):
        drawn = generator.integers(0, 2, (_PATTERNS_AT_ONCE, n))
        yield np.asarray(1.0 - 2.0 * drawn, dtype=np.float64)
