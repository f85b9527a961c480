"""Whose an effect is that one of several sensors on one body shows: a vote.

What a sensor reads less the mean of the others holds all of its own effect, and of another one's only a part,
with the other sign: of three sensors a half. So the difference of the sensor that has it speaks for it most.
Two sensors' differences are the same but for the sign, and say nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.quantity import posterior
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy
from stillcal.calib_core.diagnosis.inference.bayes_factor import log_bayes_factor
from stillcal.calib_core.diagnosis.inference.likelihood import log_sum, reduce_residuals
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.diagnosis.slow.wander import wander


def shares(
    stated: Stated, beside: Sequence[Stated], sensors: Sequence[SensorResiduals], alone: Array
) -> Array:
    """Return how likely an effect is each sensor's (m,), if it is one's.

    stated: from the first of `sensors`, of one kind of sensor: each sensor's readings less the mean of the
    others', the recording's first; none of two sensors. beside: what was found in it besides. alone: (m,)
    nats, what each sensor shows of it by itself.
    """
    others = [s.hypothesis for s in beside if s is not stated and s.hypothesis is not None]
    nats = alone.copy()
    if sensors:
        nats = nats + np.array([_speaks_for(stated, residuals, others) for residuals in sensors])
    return shares_alone(nats)


def shares_alone(nats: Array) -> Array:
    """Return how likely an effect is each sensor's (m,), by what speaks for that (m,), nats."""
    return np.asarray(np.exp(nats - log_sum(nats)))


def shown_alone(findings: Sequence[Finding], found: Discrepancy) -> Finding | None:
    """Return what one sensor shows by itself of an effect, where that speaks for it; None for other effects.

    Something without a name is the same effect where it follows the same.
    """
    alike = [f for f in findings if (f.effect, f.sensor) == (found.effect, found.sensor)]
    if found.effect == "unknown":
        alike = [f for f in alike if f.where.driver == found.where.driver]
    clearest = max(alike, key=lambda f: f.evidence.log_bayes_factor, default=None)
    return clearest if clearest is not None and clearest.evidence.log_bayes_factor > 0.0 else None


def nats_of(finding: Finding | None) -> float:
    """Return the evidence of what a sensor shows by itself, nats; 0 where it shows nothing."""
    return 0.0 if finding is None else finding.evidence.log_bayes_factor


def _speaks_for(stated: Stated, residuals: SensorResiduals, others: Sequence[Hypothesis]) -> float:
    """Return the log Bayes factor, nats, of the same effect in another sensor's difference."""
    if stated.hypothesis is not None:
        return log_bayes_factor(reduce_residuals(residuals, [stated.hypothesis], others, parts=True), 1, 1.0)
    left = reduce_residuals(residuals, found=others)
    return max((f.evidence.log_bayes_factor for f in wander(residuals, left)), default=0.0)


def of_share(nats: float, share: float, comparisons: int) -> float:
    """Return the log Bayes factor, nats, of an effect being the recording's against it having none.

    nats: that of one of the sensors having it; share: how likely it is then the recording's. Another sensor
    has it as readily beforehand as the recording: one of `comparisons` effects.
    """
    anothers = np.log(max(1.0 - share, 1e-300)) + nats - np.log(comparisons)
    return float(np.log(max(share, 1e-300)) + nats - np.logaddexp(0.0, anothers))


def voted(found: Comparison, shared: Sequence[tuple[Discrepancy, float]]) -> Comparison:
    """Return a comparison in which effects count as far as they are the recording's.

    shared: discrepancies with how likely each is the recording's; one with 0 is left out.
    """
    count = max(found.comparisons + len(found.not_compared), 1)
    kept, evidence = list(found.discrepancies), list(found.evidence)
    for one, share in shared:
        nats = of_share(one.log_bayes_factor, share, count)
        if (entry := (one.effect, one.log_bayes_factor)) in evidence:
            evidence[evidence.index(entry)] = (one.effect, nats)
        own = [replace(one, log_bayes_factor=nats, probability=posterior(nats, count))] if share else []
        at = kept.index(one)
        kept[at : at + 1] = own
    return replace(found, discrepancies=kept, evidence=evidence)
