"""The slow diagnosis of one sensor: what its rests show, what its turns show, and what wanders."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.effects.catalogue import effects_in
from stillcal.calib_core.diagnosis.inference.likelihood import reduce_residuals
from stillcal.calib_core.diagnosis.inference.reduction import Reduced
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.slow import between_rest_variance as jumps
from stillcal.calib_core.diagnosis.slow.search import Step, adequate, beside_each_other, forward
from stillcal.calib_core.diagnosis.slow.standing import statements_of
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.diagnosis.slow.wander import wander

TURNING = 0.1
"""Variance across gravity, by direction, over that along it, below which what is left of a gyroscope's rates
may be turns of the support. A bias that wanders or jumps does so on each axis."""


def slow_statements(
    residuals: SensorResiduals, without: Collection[str] = (), sought: Sequence[Hypothesis] | None = None
) -> list[Stated]:
    """Return what the still bins of one sensor show, in the order it was found.

    without: effects that are left out of the catalogue. sought: the only ones that may be there, of any
    sensor, each at its point; None: all of the catalogue are searched for. What jumps from rest to rest
    leaves is not called wander besides. Where nothing stands, nothing is explained, and wander is all that
    there is.
    """
    if len(residuals.bins) < thresholds.LEAST_BINS:
        return []
    if sought is None:
        steps = forward(residuals, effects_in(residuals, without))
    elif known := [h for h in sought if _may_show(residuals, h)]:
        steps = beside_each_other(residuals, [residuals.hypothesis(h.effect, h.grid) for h in known])
    else:
        return []
    found, left = _jumps(residuals, steps)
    if found:
        steps = [step for step in adequate(steps) if jumps.stands(residuals, step.winner, found)]
        found, left = _jumps(residuals, steps)
    stated = statements_of(residuals, steps)
    moved = _moved_at_rest(residuals)
    if moved:  # what has no name is the motion's
        stated = [s for s in stated if s.finding.effect != "unknown"]
    if moved or _along_gravity(residuals, _explained(steps)):
        beside = []
    elif found:
        beside = [jumps.finding(residuals, found)]
    else:
        withdrawn = steps and not stated
        wandering = wander(residuals, reduce_residuals(residuals) if withdrawn else left)
        beside = not_unknown_twice(stated, wandering)
    return [
        *stated,
        *(Stated(replace(f, effect="unknown") if f.effect in without else f) for f in beside),
    ]


def _may_show(residuals: SensorResiduals, other: Hypothesis) -> bool:
    """Whether an effect of other residuals shows in these, if it is there."""
    effect, moments = other.effect, residuals.moments
    return effect.sensor == residuals.sensor and not effect.in_turns and effect.can_play(moments, other.grid)


def _explained(steps: Sequence[Step]) -> list[Hypothesis]:
    """Return the hypotheses of the steps that are adequate."""
    return [h for step in adequate(steps) for h in step.explained]


def _moved_at_rest(residuals: SensorResiduals) -> bool:
    """Whether a ship moves a sensor in its rests, or a hand a gyroscope: it reads as if its bias wandered.

    A deck that rolls heaves, too: the force is longer and shorter by turns.
    """
    bins = residuals.bins
    return bins.swings or (residuals.sensor == "gyro" and (bins.held or bins.breathes))


def _along_gravity(residuals: SensorResiduals, explained: Sequence[Hypothesis]) -> bool:
    """Whether what is left of a gyroscope's rates is along gravity alone, as where the support turns."""
    if residuals.sensor != "gyro" or residuals.turns or residuals.up is None:
        return False
    left = [v.left(*(h.columns[i][0] for h in explained)) for i, v in enumerate(residuals.views)]
    rates = np.stack(left, axis=1)
    along = float(((rates * residuals.up).sum(axis=1) ** 2).sum())
    return float((rates**2).sum()) - along < 2.0 * TURNING * along


def not_unknown_twice(stated: Sequence[Stated], wandering: Sequence[Finding]) -> list[Finding]:
    """Return the wander without what has no name beside other structure without one, which leaves some."""
    nameless = any(s.finding.effect == "unknown" for s in stated)
    return [f for f in wandering if not (nameless and f.effect == "unknown")]


def _jumps(residuals: SensorResiduals, steps: Sequence[Step]) -> tuple[jumps.Jumps | None, list[Reduced]]:
    """Return a bias' jumps beside the steps, and the residuals with these taken out."""
    explained = _explained(steps)
    left = reduce_residuals(residuals, found=explained)
    return jumps.jumps(residuals, explained, left), left


def turn_statements(residuals: SensorResiduals | None, without: Collection[str] = ()) -> list[Stated]:
    """Return what gravity carried by the gyroscope from rest to rest shows; `without`: effects left out.

    residuals: the turns (`turn_residuals`). Where rests are too few to judge the accelerometer, its errors
    would be taken for the gyroscope's.
    """
    if residuals is None or len(residuals.bins) < thresholds.LEAST_BINS:
        return []
    return statements_of(residuals, forward(residuals, effects_in(residuals, without)))
