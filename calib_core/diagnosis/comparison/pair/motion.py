"""What two sensors' readings differ by where they move, beyond what they differ by at rest.

With bias, scale, misalignment and what was found taken out, bins in motion should scatter as bins at rest do:
by white noise and slow noise. What they scatter by besides is a component of their variance, estimated by
likelihood together with the noise. It keeps what fits no model from being taken for a bias or a scale, and
where a simulation without it is refuted it is a finding: something that follows motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.bayes_factor import ALL_AXES
from stillcal.calib_core.diagnosis.inference.likelihood import log_sum, null_log_likelihood, reduce_residuals
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding, sized
from stillcal.calib_core.diagnosis.model.records import NAME, SLOW_BAND, Finding, Where, only_unknown
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT

STRENGTHS = 10.0 ** np.arange(-1.0, 9.0)
"""Excess variances that are tried, as parts of the bins' median white variance, all equally likely: from what
no bins show up to what a sensor at the end of its range makes of a quiet one's mean."""

NEGLIGIBLE = 40.0
"""Nats below the likeliest strength from where on larger ones are not tried: e^-40 is less than rounding."""

FINER = 10.0 ** np.array([-0.75, -0.5, -0.25, 0.25, 0.5, 0.75])
"""Steps about the best of these: an excess is then known to a seventh, which is less than its own error."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Variance (3,) that bins in motion have besides, with the evidence (3,) for one on each axis, nats."""

    variance: Array
    log_bayes_factors: Array

    @property
    def log_bayes_factor(self) -> float:
        """The evidence, nats, for an excess on all axes or on one, as an effect's is counted."""
        one = np.log((1.0 - ALL_AXES) / 3.0) + self.log_bayes_factors
        return log_sum(np.append(one, np.log(ALL_AXES) + self.log_bayes_factors.sum()))

    def allowed(self, residuals: SensorResiduals) -> SensorResiduals:
        """Return residuals whose bins in motion have this variance besides."""
        return with_excess(residuals, self.variance)

    def beyond(self, allowed: Array) -> Motion:
        """Return it on the axes where it is more than what is allowed in a mean, sd (3,)."""
        more = self.variance > allowed**2
        evidence = np.where(more, self.log_bayes_factors, np.minimum(self.log_bayes_factors, 0.0))
        return Motion(np.where(more, self.variance, 0.0), evidence)

    def finding(self, residuals: SensorResiduals) -> Finding | None:
        """Return what is left in motion as something unknown; None where chance or steps leave as much."""
        bins = residuals.bins
        rounding = bins.force_rounding if residuals.sensor == "accel" else bins.rate_rounding
        # Steps leave less in motion than at rest, but of a shaking that beats with the samples no less.
        allowed = [sd for sd in (rounding, residuals.unsure) if sd is not None]
        own = self.beyond(np.linalg.norm(allowed, axis=0)) if allowed else self
        if not own.variance.any():
            return None
        return direct_finding(
            "unknown",
            residuals.sensor,
            [int(a) for a in np.flatnonzero(own.variance > 0.0)],
            Where(*bins.span, SLOW_BAND, "motion"),
            sized({"rms": (np.sqrt(own.variance).tolist(), UNIT[residuals.sensor])}),
            statement=only_unknown(f"({NAME[residuals.sensor]})", "motion"),
            seen=DirectEvidence(own.log_bayes_factor),
        )


def with_excess(residuals: SensorResiduals, variance: Array) -> SensorResiduals:
    """Return residuals whose moving bins have variance (3,) besides, axis by axis; the same ones for none."""
    if not variance.any():
        return residuals
    views = [replace(v, excess=float(x)) for v, x in zip(residuals.views, variance, strict=True)]
    return replace(residuals, views=tuple(views))


def left_in_motion(residuals: SensorResiduals, found: Sequence[Hypothesis] = ()) -> Motion | None:
    """Return the excess of the bins that move, `found` projected out; None where it is not judged.

    An axis has one where it is likelier than none; it is then the likeliest.
    """
    moving = residuals.views[0].moving
    if moving is None or not moving.any():
        return None
    residuals = _without_jumps(residuals, found)
    unit = np.array([float(np.median(v.variance)) for v in residuals.views])
    none = _log_likelihood(residuals, np.zeros(3), found)
    coarse = _coarse(residuals, unit, found)
    evidence = np.array([log_sum(axis) for axis in coarse.T]) - np.log(STRENGTHS.size) - none
    about = STRENGTHS[coarse.argmax(axis=0)]
    if not (evidence > 0.0).any():
        return Motion(np.zeros(3), evidence)
    tried = about * np.append(1.0, FINER)[:, None]
    fine = np.array([coarse.max(axis=0), *(_log_likelihood(residuals, s * unit, found) for s in tried[1:])])
    best = tried[fine.argmax(axis=0), np.arange(3)] * unit
    return Motion(np.where(evidence > 0.0, best, 0.0), evidence)


def _without_jumps(residuals: SensorResiduals, found: Sequence[Hypothesis]) -> SensorResiduals:
    """Return a sensor's residuals in which the bins beside a jump of what was found are free.

    The jump is somewhere in one of the two, whose mean then lies between both levels: that is no motion.
    """
    free = np.unique(np.concatenate([_beside_jumps(h) for h in found])) if found else np.zeros(0, np.int64)
    if not free.size:
        return residuals
    alone = np.eye(len(residuals.bins))[None, :, free]
    views = [replace(v, baseline=np.concatenate([v.baseline, alone], axis=2)) for v in residuals.views]
    return replace(residuals, views=tuple(views))


def _beside_jumps(hypothesis: Hypothesis) -> NDArray[np.int64]:
    """Return the bins on both sides of each jump; none of what changes in more than half of the bins."""
    columns = np.concatenate([c[0] for c in hypothesis.columns], axis=1)
    jumps = np.flatnonzero((np.diff(columns, axis=0) != 0.0).any(axis=1))
    return np.concatenate([jumps, jumps + 1]) if 2 * jumps.size < len(columns) else jumps[:0]


def _coarse(residuals: SensorResiduals, unit: Array, found: Sequence[Hypothesis]) -> Array:
    """Return the log likelihood (k, 3) of each axis at the strengths, as far as they are not hopeless.

    Beyond the likeliest strength the likelihood only falls: the bins that move count for less and less.
    """
    tried: list[Array] = []
    for strength in STRENGTHS:
        tried.append(_log_likelihood(residuals, strength * unit, found))
        if (tried[-1] < np.max(tried, axis=0) - NEGLIGIBLE).all():
            break
    return np.array(tried)


def _log_likelihood(residuals: SensorResiduals, variance: Array, found: Sequence[Hypothesis]) -> Array:
    """Return the log likelihood (3,) of each axis with an excess variance (3,) of the bins that move."""
    trial = with_excess(residuals, variance)
    return np.array([null_log_likelihood([view]) for view in reduce_residuals(trial, found=found)])
