"""Parameters of what was found, all findings of a sensor together, with intervals.

Linear parameters and grid parameters (time constants, times of steps) are averaged over a fine grid with the
shape-averaged likelihood as weight, so that an amplitude's interval knows how uncertain the time constant is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.bayes_factor import log_bayes_factor
from stillcal.calib_core.diagnosis.inference.likelihood import (
    Fit,
    fit_hypothesis,
    highest,
    null_log_likelihood,
    reduce_residuals,
)
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95
from stillcal.calib_core.diagnosis.model.records import Parameter

GRID_PARAMETERS = ("tau_s", "period_s")

COARSE, POINTS = 2.0, 17
"""Nats that the neighbours of the likeliest point lie below it where a grid is too coarse, by two standard
errors a step; and the points between these neighbours that are tried then."""

UNLIKELY = 7.0
"""nats below the likeliest point from which another weighs less than a thousandth, and is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A hypothesis at its best grid point: mean (k,), covariance (k, k) in SI, grid quantiles, gain."""

    hypothesis: Hypothesis
    value: Array
    covariance: Array
    grid: dict[str, tuple[float, float, float]]
    gain: float

    @property
    def sigma(self) -> Array:
        """Standard errors (k,)."""
        return np.asarray(np.sqrt(np.maximum(self.covariance.diagonal(), 0.0)))

    def chance(self) -> float:
        """Return the probability of values as far from nothing by chance (Wald's chi-squared)."""
        from scipy.special import chdtrc  # noqa: PLC0415 - the daemon stays light

        scaled = self.covariance / np.outer(self.sigma, self.sigma)
        unit = self.value / self.sigma
        return float(chdtrc(float(unit.size), float(unit @ np.linalg.solve(scaled, unit))))


def estimate(residuals: SensorResiduals, hypothesis: Hypothesis, others: Sequence[Hypothesis]) -> Estimate:
    """Fit one finding with the others' columns free beside it."""
    candidates = _candidates(residuals, hypothesis, others)
    reduced = reduce_residuals(residuals, candidates, others)
    fits = [fit_hypothesis(reduced, h) for h in range(len(candidates))]
    gains = np.array([f.log_likelihood for f in fits])
    weight = np.exp(gains - gains.max())
    weight /= weight.sum()
    mean, covariance = averaged(fits, weight, hypothesis.sizes)
    top = candidates[int(gains.argmax())]
    grid = {
        name: _quantiles(candidates, name, weight, _choice(top))
        for name in hypothesis.grid
        if name in hypothesis.effect.grid_units
    }
    return Estimate(top, mean, covariance, grid, float(gains.max() - null_log_likelihood(reduced)))


def evidence_of(residuals: SensorResiduals, hypothesis: Hypothesis, others: Sequence[Hypothesis]) -> float:
    """Return the log Bayes factor of an effect over its fine grid, with `others` beside it."""
    candidates = residuals.finer(hypothesis)
    reduced = reduce_residuals(residuals, candidates, others, parts=True)
    return log_bayes_factor(
        reduced, len(candidates), max(tried(residuals, hypothesis) / len(candidates), 1.0)
    )


def tried(residuals: SensorResiduals, hypothesis: Hypothesis) -> float:
    """Return of how many curves or grid points a hypothesis is the best."""
    return max(hypothesis.multiplicity, len(residuals.hypotheses(hypothesis.effect)), 1)


def _candidates(
    residuals: SensorResiduals, hypothesis: Hypothesis, others: Sequence[Hypothesis]
) -> list[Hypothesis]:
    """Return the points of the fine grid, also about coarse ones that differ in what that leaves as it is.

    The shares of a latent heat's sources are of the coarse grid alone, and hardly told: with those of the
    likeliest point only, its intervals were too narrow. Of each choice the likeliest point counts.
    """
    made, known = finest(residuals, hypothesis, others), {_choice(hypothesis)}
    if made == [hypothesis] or not _choice(hypothesis):
        return made
    coarse = residuals.hypotheses(hypothesis.effect)
    reduced = reduce_residuals(residuals, coarse, others)
    heights = np.array([highest(reduced, i) for i in range(len(coarse))])
    for i in np.argsort(-heights):
        if heights[i] > heights.max() - UNLIKELY and _choice(coarse[i]) not in known:
            known.add(_choice(coarse[i]))
            made = [*made, *residuals.finer(coarse[i])]
    return made


def finest(
    residuals: SensorResiduals, hypothesis: Hypothesis, others: Sequence[Hypothesis]
) -> list[Hypothesis]:
    """Return the fine grid about a hypothesis, as fine as the recording tells a time constant or a period.

    Half a step beside the true one, what a large effect leaves is as large as a small effect.
    """
    made = residuals.finer(hypothesis)
    name = next((n for n in GRID_PARAMETERS if n in hypothesis.grid), None)
    while name is not None and len(made) > 2:
        reduced = reduce_residuals(residuals, made, others)
        heights = np.array([highest(reduced, i) for i in range(len(made))])
        best = int(np.argmax(heights))
        if not 0 < best < len(made) - 1 or heights[best] - max(heights[[best - 1, best + 1]]) < COARSE:
            break
        low, high = (made[i].grid[name] for i in (best - 1, best + 1))
        grids = [made[best].grid | {name: float(v)} for v in np.geomspace(low, high, POINTS)]
        made = [residuals.measured(hypothesis.effect, g, hypothesis.multiplicity) for g in grids]
    return made


def _choice(hypothesis: Hypothesis) -> tuple[float, ...]:
    """Return the values of a grid point that its fine grid leaves as they are: those without a unit."""
    return tuple(v for k, v in sorted(hypothesis.grid.items()) if k not in hypothesis.effect.grid_units)


def averaged(fits: Sequence[Fit], weight: Array, sizes: Array) -> tuple[Array, Array]:
    """Return mean (k,) and covariance (k, k) of a mixture of fits, in SI: of their first k numbers.

    weight: of each fit, with a sum of 1; sizes: (k,) the numbers' units.
    """
    k = sizes.size
    betas = np.array([f.beta[:k] for f in fits])
    mean = weight @ betas
    away = betas - mean
    total = sum(
        w * (f.covariance[:k, :k] + np.outer(a, a)) for w, f, a in zip(weight, fits, away, strict=True)
    )
    return np.asarray(mean * sizes), np.asarray(np.asarray(total) * np.outer(sizes, sizes))


def _quantiles(
    candidates: list[Hypothesis], name: str, weight: Array, choice: tuple[float, ...]
) -> tuple[float, float, float]:
    """Median and 95 % interval of a grid parameter, by its weight; at least half a grid step wide.

    choice: of the likeliest point, whose own grid the step is of.
    """
    values = np.array([c.grid[name] for c in candidates])
    order = np.argsort(values)
    own = np.array([_choice(c) == choice for c in candidates])[order]
    values, weight = values[order], weight[order]
    if values.size == 1:
        return float(values[0]), float(values[0]), float(values[0])
    middle = np.cumsum(weight) - weight / 2.0
    low, median, high = np.interp((0.025, 0.5, 0.975), middle, values)
    values, weight = values[own], weight[own]
    k = int(np.argmax(weight))
    floor, ceiling = values[max(k - 1, 0)], values[min(k + 1, values.size - 1)]
    return (
        float(median),
        float(min(low, (floor + values[k]) / 2)),
        float(max(high, (ceiling + values[k]) / 2)),
    )


def parameters(found: Estimate) -> dict[str, Parameter]:
    """Return the parameters as the answer wants them."""
    out, first, effect = {}, 0, found.hypothesis.effect
    sigma = np.hypot(found.sigma, effect.rough * found.value)
    for p in effect.parameters:
        rows = slice(first, first + p.count)
        out[p.name] = _linear(found.value[rows], sigma[rows], p.unit)
        first += p.count
    for name, (value, low, high) in found.grid.items():
        if name in GRID_PARAMETERS:
            # Half-widths of the logarithm, and of what the model is off by, add up as squares.
            down, up = (np.hypot(np.log(x / value), NORMAL_95 * effect.rough) for x in (low, high))
            interval = [float(value * np.exp(-down)), float(value * np.exp(up))]
            out[name] = Parameter(value, interval, effect.grid_units[name])
    return out


def _linear(value: Array, sigma: Array, unit: str) -> Parameter:
    ci = np.stack([value - NORMAL_95 * sigma, value + NORMAL_95 * sigma], axis=-1)
    if value.size == 9:
        return Parameter(value.reshape(3, 3).tolist(), ci.reshape(3, 3, 2).tolist(), unit)
    return Parameter(value.tolist(), ci.tolist(), unit)
