"""Bias random walk: part of the twin's noise, and a finding only beyond what Android allows a phone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.misfit import thresholds
from stillcal.calib_core.misfit.catalogue.bias import NAME, UNIT
from stillcal.calib_core.misfit.catalogue.entry import AXES, Hypothesis, Scene, nothing
from stillcal.calib_core.misfit.evidence import PRIOR_DOF, Reduced, posterior_weights
from stillcal.calib_core.misfit.records import Evidence, Finding, Parameter, Where
from stillcal.calib_core.misfit.search import reduce_scene
from stillcal.calib_core.samples import Array

LEAST_SPREAD = 0.15
"""Strengths of walks are tried half a decade of variance apart: no density is known better than this (ln)."""


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """Posterior of one view. kinds: probability of each kind of wander; density: (G,) unit/sqrt(s) of shapes
    with a walk and their weight (G,).
    """  # noqa: D205 - the kinds and the walk are one posterior

    kinds: dict[str, float]
    weight: Array
    density: Array

    def beyond(self, limit: float) -> float:
        """Probability that the density is above `limit`, given that there is a walk."""
        return float(self.weight[self.density > limit].sum() / max(float(self.weight.sum()), 1e-300))

    def summary(self) -> tuple[float, float, float]:
        """Return the middle and 95 % interval of the density, given that there is a walk."""
        share = self.weight / max(float(self.weight.sum()), 1e-300)
        logs = np.log(self.density)
        middle = float(share @ logs)
        spread = float(np.hypot(np.sqrt(share @ (logs - middle) ** 2), LEAST_SPREAD))
        return (
            float(np.exp(middle)),
            float(np.exp(middle - 1.96 * spread)),
            float(np.exp(middle + 1.96 * spread)),
        )


def walk_of(reduced: Reduced) -> Walk:
    """Return the posterior of a view's wander."""
    weight = posterior_weights(reduced)
    scale = (PRIOR_DOF + reduced.yy) / max(reduced.dof - 2.0, 1.0)
    kinds: dict[str, float] = {}
    for family, w in zip(reduced.family, weight, strict=True):
        kind = "walk" if family.startswith("walk") else family
        kinds[kind] = kinds.get(kind, 0.0) + float(w)
    some = reduced.walk > 0.0
    return Walk(kinds, weight[some], np.sqrt(reduced.walk * scale)[some])


def walking(walks: Sequence[Walk]) -> float:
    """Probability that the wander of all views, taken to be of one kind, is a random walk."""
    joint = {k: float(np.prod([w.kinds.get(k, 0.0) for w in walks])) for k in walks[0].kinds}
    return joint["walk"] / max(sum(joint.values()), 1e-300)


def random_walk(scene: Scene, explained: Sequence[Hypothesis]) -> list[Finding]:
    """Find a bias random walk beyond what Android allows, in what the effects leave."""
    limit = thresholds.RANDOM_WALK[scene.sensor]
    reduced = reduce_scene(scene, [nothing(scene)], explained)
    walks = [walk_of(r) for v, r in zip(scene.views, reduced, strict=True) if v.name != "tangent"]
    sure = walking(walks) * max(w.beyond(limit) for w in walks)
    if sure < thresholds.CERTAIN:
        return []
    by_axis = walks if len(walks) == 3 else walks * 3
    axes = [a for a, w in zip(AXES, by_axis, strict=True) if w.beyond(limit) >= thresholds.CERTAIN]
    numbers = [w.summary() for w in by_axis]
    unit = f"{UNIT[scene.sensor]}/sqrt(s)"
    density = Parameter([n[0] for n in numbers], [[n[1], n[2]] for n in numbers], unit)
    worst = max(n[0] for n in numbers)
    say = f"The {NAME[scene.sensor]}'s bias walks at random, {worst:.2g} {unit}: zero it often."
    where = Where(*scene.bins.span, (0.0, 0.05), "nothing")
    evidence = Evidence(max(1.0 - sure, 1e-12), 0.0, 0.0, 0.0, 0)
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
