"""A bias that is another in every rest: what strain after a move leaves, or a field about the phone.

No wander is quiet within rests and jumps between them. There is no mean to it that a column could have: it
shows in the covariance of what nothing else explains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.bayes_factor import of_probabilities
from stillcal.calib_core.diagnosis.inference.likelihood import joint, log_sum, log_terms
from stillcal.calib_core.diagnosis.inference.reduction import Reduced
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95
from stillcal.calib_core.diagnosis.model.records import (
    AXES,
    NAME,
    SLOW_BAND,
    Evidence,
    Finding,
    Parameter,
    Where,
)
from stillcal.calib_core.diagnosis.model.residuals import View
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.diagnosis.slow.search import Scored

DRIVER = "the rest it lies in"


@dataclass(frozen=True, slots=True, eq=False)
class Jumps:
    """Jumps of the bias from rest to rest, view by view.

    sure: (v,) probability that they are beyond what is allowed; prior: (v,) the same before the data;
    size: (v,) standard deviation, m/s^2 or
    rad/s; freedom: (v,) degrees of freedom with which it is known.
    """

    sure: Array
    prior: Array
    size: Array
    freedom: Array


def jumps(
    residuals: SensorResiduals, explained: Sequence[Hypothesis], reduced: Sequence[Reduced]
) -> Jumps | None:
    """Return the jumps of a bias beside what is `explained`, where there surely are any.

    reduced: the residuals, what is explained taken out. The norm of gravity tells of the accelerometer's
    three axes together.
    """
    _, weights = joint(reduced, [log_terms(v, v.left) for v in reduced])
    limit, told = thresholds.JUMP[residuals.sensor], []
    explained = [*explained, *([] if residuals.shared is None else [residuals.shared])]
    for i, (view, left, weight) in enumerate(zip(residuals.views, reduced, weights, strict=True)):
        if view.name == "tangent":
            continue
        allowed = limit**2 * (left.dof - 2.0) / (left.known + left.left)
        above = left.jump > allowed
        prior = float(np.exp(left.prior[above] - log_sum(left.prior)).sum())
        told.append(
            (float(weight[above].sum()), prior, *_scatter(view, [h.columns[i][0] for h in explained]))
        )
    sure, prior, size, freedom = np.array(told).T
    return Jumps(sure, prior, size, freedom) if sure.max() >= thresholds.CERTAIN_NAMELESS else None


def _scatter(view: View, explained: list[Array]) -> tuple[float, float]:
    """Return the standard deviation of the means of rests, and its degrees of freedom.

    Beside jumps that are sure, what noise and wander add to it is little. The degrees of freedom are the
    expected sum of squares that jumps of variance one leave in the means: courses within rests, of which a
    support that turns has many, take nothing off them.
    """
    each = (view.rest[:, None] == np.unique(view.rest)).astype(float)
    averages = (each / each.sum(axis=0)).T
    means = averages @ view.left(*explained)
    freedom = max(float(((averages @ view.without(each, *explained)) ** 2).sum()), 1.0)
    return float(np.sqrt((means**2).sum() / freedom)), freedom


def stands(residuals: SensorResiduals, one: Scored, found: Jumps) -> bool:
    """Whether a hypothesis has no name, or explains the larger part, more than the jumps that it leaves."""
    own = one.hypothesis
    if own.effect.name == "unknown":
        return True
    beta = own.sizes * one.fit.beta
    seen = [v for v in zip(residuals.views, own.columns, strict=True) if v[0].name != "tangent"]
    explained = sum(float((columns @ beta).var()) for _, columns in seen)
    return explained >= float((found.size**2).sum())


def finding(residuals: SensorResiduals, found: Jumps) -> Finding:
    """State the jumps: they have no name, for many a cause may have them."""
    sure, size, freedom = (np.broadcast_to(x, 3) for x in (found.sure, found.size, found.freedom))
    axes = [a for a, p in zip(AXES, sure, strict=True) if p >= thresholds.CERTAIN_NAMELESS]
    spread = NORMAL_95 / np.sqrt(2.0 * freedom)
    ci = np.stack([size * np.exp(-spread), size * np.exp(spread)], axis=1)
    sensor = residuals.sensor
    say = (
        f"The {NAME[sensor]}'s bias changes from rest to rest by {size.max():.2g} {UNIT[sensor]}"
        " (one standard deviation); possible causes are strain after handling and surrounding fields."
    )
    where = Where(*residuals.bins.span, SLOW_BAND, DRIVER)
    odds = [of_probabilities(p, prior) for p, prior in zip(found.sure, found.prior, strict=True)]
    evidence = Evidence(log_bayes_factor=max(odds))
    parameters = {"size": Parameter(size.tolist(), ci.tolist(), UNIT[residuals.sensor])}
    return Finding("unknown", residuals.sensor, axes, where, parameters, evidence, [], say)
