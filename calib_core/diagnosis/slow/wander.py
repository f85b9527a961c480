"""The wander of a bias: part of the twin's noise, and a finding only beyond what Android allows a phone.

It is called a random walk where it surely is one. Where only its strength is sure, it has no name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.bayes_factor import LEAST_PROBABILITY
from stillcal.calib_core.diagnosis.inference.likelihood import joint, log_sum, log_terms, reduce_residuals
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
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT

WALK = "_bias_random_walk"
"""How the name of wander ends, of either sensor, where it has one."""

NO_DRIVER = "nothing that was recorded"
"""What wander without a name follows."""

BOUNDED = 2.0
"""How far beyond what a walk may have a slow Gauss-Markov process must begin to be called a walk."""

MIXED = 0.25
"""Odds beforehand of a second wander as strong as a walk that is itself a fault."""

LEAST_SPREAD = 0.15
"""Strengths of walks are tried half a decade of variance apart: no density is known better than this (ln)."""


@dataclass(frozen=True, slots=True, eq=False)
class Wander:
    """Posterior of one view.

    weight, prior: (G,) probability of each shape, after and before; density: (G,) unit/sqrt(s) of its walk;
    alike: (G,) density of a walk that moves the bias as much as all of the shape's wander does; size: (G,)
    standard deviation, unit, by which it moves the bias from one moment to another, over sqrt(2); jump: (G,)
    that of what is another in every rest;
    bounded: (G,) whether a shape is a Gauss-Markov process, a walk only at first; mixed: (G,) whether another
    wander is in it.
    """

    weight: Array
    prior: Array
    density: Array
    alike: Array
    size: Array
    jump: Array
    bounded: NDArray[np.bool_]
    mixed: NDArray[np.bool_]

    def walks_beyond(self, limit: float) -> float:
        """Probability of a walk above `limit`, or of a bounded one above `BOUNDED` times that."""
        return float(self.weight[self._walks_above(limit)].sum())

    def beyond(self, limit: float) -> float:
        """Probability that wander of any kind moves the bias more than a walk of `limit` does."""
        return float(self.weight[self.alike > limit].sum())

    def log_bayes_factor_of_walk(self, limit: float) -> float:
        """Return the evidence for such a walk, nats, against wander that moves a bias as `limit` at most."""
        return self._log_evidence(self._walks_above(limit)) - self._log_evidence(self.alike <= limit)

    def log_bayes_factor(self, limit: float) -> float:
        """Return the evidence, nats, for wander of any kind against such that moves it as `limit` at most."""
        return self._log_evidence(self.alike > limit) - self._log_evidence(self.alike <= limit)

    def _log_evidence(self, some: NDArray[np.bool_]) -> float:
        after, before = self.weight[some].sum(), self.prior[some].sum()
        return float(np.log(max(after, LEAST_PROBABILITY)) - np.log(max(before, LEAST_PROBABILITY)))

    def _walks_above(self, limit: float) -> NDArray[np.bool_]:
        return np.asarray(self.density > limit * np.where(self.bounded, BOUNDED, 1.0))

    def density_of_walk(self) -> tuple[float, float, float]:
        """Return the middle and 95 % interval of the walk's density, given that there is a walk.

        Where a walk is beyond what a phone may have, that nothing else wanders as strongly is likelier.
        """
        return _middle(self.density, self.weight * np.where(self.mixed, MIXED, 1.0))

    def size_of_all(self) -> tuple[float, float, float]:
        """Return the middle and 95 % interval of the size of all wander, given that there is any."""
        return _middle(self.size, self.weight)


def _middle(values: Array, weight: Array) -> tuple[float, float, float]:
    """Return the geometric mean and 95 % interval of values (G,) above 0 with their weights (G,)."""
    some = values > 0.0
    share = weight[some] / max(float(weight[some].sum()), 1e-300)
    logs = np.log(values[some])
    middle = float(share @ logs)
    spread = NORMAL_95 * float(np.hypot(np.sqrt(share @ (logs - middle) ** 2), LEAST_SPREAD))
    return float(np.exp(middle)), float(np.exp(middle - spread)), float(np.exp(middle + spread))


def wanders_of(views: Sequence[Reduced]) -> list[Wander]:
    """Return the posterior of every view's wander, the axes of a sensor made alike as in the search."""
    _, weights = joint(views, [log_terms(v, v.left) for v in views])
    out = []
    for view, weight in zip(views, weights, strict=True):
        scale = (view.known + view.left) / max(view.dof - 2.0, 1.0)
        bounded = np.array(["walk" not in name for name in view.family])
        mixed = np.array(["+" in name for name in view.family])
        pure = ~bounded & ~mixed
        rate = view.walk[pure].sum() / view.power[pure].sum()
        prior = np.exp(view.prior - log_sum(view.prior))
        density, size = np.sqrt(view.walk * scale), np.sqrt(view.power * scale)
        jump = np.sqrt(view.jump * scale)
        out.append(Wander(weight, prior, density, size * np.sqrt(rate), size, jump, bounded, mixed))
    return out


def sizes_along_gravity(residuals: SensorResiduals, explained: Sequence[Hypothesis]) -> tuple[float, float]:
    """Return by how much an accelerometer's bias wanders beside what is explained, m/s^2.

    The first is what moves slowly, the second what is another in every rest: each one standard deviation
    about the mean, as the norm of gravity shows it, rms over the shapes.
    """
    reduced = reduce_residuals(residuals, found=explained)
    pairs = zip(residuals.views, wanders_of(reduced), strict=True)
    seen = next((w for v, w in pairs if v.name == "norm"), None)
    if seen is None:
        return 0.0, 0.0
    slow = np.maximum(seen.size**2 - seen.jump**2, 0.0)
    return float(np.sqrt(seen.weight @ slow)), float(np.sqrt(seen.weight @ seen.jump**2))


def wander(residuals: SensorResiduals, reduced: Sequence[Reduced]) -> list[Finding]:
    """Find wander of a bias beyond what Android allows. reduced: the residuals, what was found taken out."""
    limit, seen = thresholds.RANDOM_WALK[residuals.sensor], _of_views(residuals, reduced)
    by_axis = seen if len(seen) == 3 else seen * 3
    axes = [a for a, w in zip(AXES, by_axis, strict=True) if w.walks_beyond(limit) >= thresholds.CERTAIN_WALK]
    if axes:
        return [_random_walk(residuals, by_axis, axes, limit)]
    axes = [a for a, w in zip(AXES, by_axis, strict=True) if w.beyond(limit) >= thresholds.CERTAIN_NAMELESS]
    return [_without_name(residuals, by_axis, axes, limit)] if axes else []


def log_evidence(residuals: SensorResiduals, reduced: Sequence[Reduced]) -> float:
    """Return the evidence, nats, for wander beyond what a phone may have, on the axis that shows it best."""
    limit = thresholds.RANDOM_WALK[residuals.sensor]
    return max(w.log_bayes_factor(limit) for w in _of_views(residuals, reduced))


def probability_beyond(residuals: SensorResiduals, explained: Sequence[Hypothesis]) -> float:
    """Return the probability of more wander than a phone may have beside what is explained.

    It is that of the axis which shows it best.
    """
    reduced, limit = reduce_residuals(residuals, found=explained), thresholds.RANDOM_WALK
    return max(w.beyond(limit[residuals.sensor]) for w in _of_views(residuals, reduced))


def _of_views(residuals: SensorResiduals, reduced: Sequence[Reduced]) -> list[Wander]:
    """Return the wander of the views that show all of it; across gravity there is what a pose has."""
    wanders = wanders_of(reduced)
    return [w for v, w in zip(residuals.views, wanders, strict=True) if v.name != "tangent"]


def _random_walk(
    residuals: SensorResiduals, by_axis: Sequence[Wander], axes: list[str], limit: float
) -> Finding:
    numbers = [w.density_of_walk() for w in by_axis]
    unit = f"{UNIT[residuals.sensor]}/sqrt(s)"
    worst = max(n[0] for n in numbers)
    say = f"The {NAME[residuals.sensor]}'s bias random walk is {worst:.2g} {unit}; update the bias often."
    where = Where(*residuals.bins.span, SLOW_BAND, "nothing")
    evidence = Evidence(log_bayes_factor=max(w.log_bayes_factor_of_walk(limit) for w in by_axis))
    name = f"{residuals.sensor}{WALK}"
    return Finding(
        name, residuals.sensor, axes, where, {"density": _parameter(numbers, unit)}, evidence, [], say
    )


def _without_name(
    residuals: SensorResiduals, by_axis: Sequence[Wander], axes: list[str], limit: float
) -> Finding:
    numbers = [w.size_of_all() for w in by_axis]
    unit = UNIT[residuals.sensor]
    worst = max(n[0] for n in numbers)
    say = (
        f"The {NAME[residuals.sensor]}'s bias changes by {worst:.2g} {unit} (one standard deviation) in the"
        " course of the recording, more than a phone's may; no driver that was recorded explains it."
    )
    where = Where(*residuals.bins.span, SLOW_BAND, NO_DRIVER)
    evidence = Evidence(log_bayes_factor=max(w.log_bayes_factor(limit) for w in by_axis))
    return Finding(
        "unknown", residuals.sensor, axes, where, {"size": _parameter(numbers, unit)}, evidence, [], say
    )


def _parameter(numbers: Sequence[tuple[float, float, float]], unit: str) -> Parameter:
    return Parameter([n[0] for n in numbers], [[n[1], n[2]] for n in numbers], unit)
