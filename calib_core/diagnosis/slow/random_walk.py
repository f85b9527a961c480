"""Bias random walk: part of the twin's noise, and a finding only beyond what Android allows a phone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.bayes_factor import LEAST_PROBABILITY
from stillcal.calib_core.diagnosis.inference.likelihood import Reduced, joint, log_sum, log_terms
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.hypothesis import Scene
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
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT

BOUNDED = 2.0
"""How far beyond what a walk may have a slow Gauss-Markov process must begin to be called a walk."""

MIXED = 0.25
"""Odds beforehand of a second wander as strong as a walk that is itself a fault."""

LEAST_SPREAD = 0.15
"""Strengths of walks are tried half a decade of variance apart: no density is known better than this (ln)."""


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """Posterior of one view.

    weight, prior: (G,) probability of each shape, after and before; density: (G,) unit/sqrt(s) of its walk;
    alike: (G,) density of a walk that moves the bias as much as all of the shape's wander does;
    bounded: (G,) whether a shape is a Gauss-Markov process, a walk only at first; mixed: (G,) whether another
    wander is in it.
    """

    weight: Array
    prior: Array
    density: Array
    alike: Array
    bounded: NDArray[np.bool_]
    mixed: NDArray[np.bool_]

    def beyond(self, limit: float) -> float:
        """Probability of a walk above `limit`, or of a bounded one above `BOUNDED` times that."""
        return float(self.weight[self._above(limit)].sum())

    def log_bayes_factor(self, limit: float) -> float:
        """Return the evidence for such a walk, nats, against one that moves the bias as `limit` at most."""
        above, below = self._above(limit), self.alike <= limit
        return self._log_evidence(above) - self._log_evidence(below)

    def _log_evidence(self, some: NDArray[np.bool_]) -> float:
        after, before = self.weight[some].sum(), self.prior[some].sum()
        return float(np.log(max(after, LEAST_PROBABILITY)) - np.log(max(before, LEAST_PROBABILITY)))

    def _above(self, limit: float) -> NDArray[np.bool_]:
        return np.asarray(self.density > limit * np.where(self.bounded, BOUNDED, 1.0))

    def summary(self) -> tuple[float, float, float]:
        """Return the middle and 95 % interval of the density, given that there is a walk.

        Where a walk is beyond what a phone may have, that nothing else wanders as strongly is likelier.
        """
        some = self.density > 0.0
        share = (self.weight * np.where(self.mixed, MIXED, 1.0))[some]
        share = share / max(float(share.sum()), 1e-300)
        logs = np.log(self.density[some])
        middle = float(share @ logs)
        spread = float(np.hypot(np.sqrt(share @ (logs - middle) ** 2), LEAST_SPREAD))
        return (
            float(np.exp(middle)),
            float(np.exp(middle - NORMAL_95 * spread)),
            float(np.exp(middle + NORMAL_95 * spread)),
        )


def walks_of(views: Sequence[Reduced]) -> list[Walk]:
    """Return the posterior of every view's walk, the axes of a sensor made alike as in the search."""
    _, weights = joint(views, [log_terms(v, v.left) for v in views])
    out = []
    for view, weight in zip(views, weights, strict=True):
        scale = (view.known + view.left) / max(view.dof - 2.0, 1.0)
        bounded = np.array(["walk" not in name for name in view.family])
        mixed = np.array(["+" in name for name in view.family])
        pure = ~bounded & ~mixed
        rate = view.walk[pure].sum() / view.power[pure].sum()
        prior = np.exp(view.prior - log_sum(view.prior))
        density, alike = np.sqrt(view.walk * scale), np.sqrt(view.power * scale * rate)
        out.append(Walk(weight, prior, density, alike, bounded, mixed))
    return out


def random_walk(scene: Scene, reduced: Sequence[Reduced]) -> list[Finding]:
    """Find a bias random walk beyond what Android allows. reduced: the scene, what was found taken out."""
    limit = thresholds.RANDOM_WALK[scene.sensor]
    walks = [w for v, w in zip(scene.views, walks_of(reduced), strict=True) if v.name != "tangent"]
    sure = max(w.beyond(limit) for w in walks)
    if sure < thresholds.CERTAIN:
        return []
    by_axis = walks if len(walks) == 3 else walks * 3
    axes = [a for a, w in zip(AXES, by_axis, strict=True) if w.beyond(limit) >= thresholds.CERTAIN]
    numbers = [w.summary() for w in by_axis]
    unit = f"{UNIT[scene.sensor]}/sqrt(s)"
    density = Parameter([n[0] for n in numbers], [[n[1], n[2]] for n in numbers], unit)
    worst = max(n[0] for n in numbers)
    say = f"The {NAME[scene.sensor]}'s bias random walk is {worst:.2g} {unit}; update the bias often."
    where = Where(*scene.bins.span, SLOW_BAND, "nothing")
    evidence = Evidence(log_bayes_factor=max(w.log_bayes_factor(limit) for w in walks))
    return [
        Finding(
            f"{scene.sensor}_bias_random_walk",
            scene.sensor,
            axes,
            where,
            {"density": density},
            evidence,
            [],
            say,
        )
    ]
