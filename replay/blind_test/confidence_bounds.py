"""Rates and means with 95 % intervals, and the power curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array


@dataclass(frozen=True, slots=True)
class Rate:
    """A rate of `hits` in `n` with the 95 % interval of Clopper and Pearson (1934); value None for n = 0."""

    hits: int
    n: int
    value: float | None
    low: float
    high: float


def rate(hits: int, n: int, confidence: float = 0.95) -> Rate:
    """Return a rate with its exact binomial interval."""
    from scipy.stats import beta  # noqa: PLC0415 - the command line starts without it

    tail = (1.0 - confidence) / 2.0
    low = float(beta.ppf(tail, hits, n - hits + 1)) if hits > 0 else 0.0
    high = float(beta.ppf(1.0 - tail, hits + 1, n - hits)) if hits < n else 1.0
    return Rate(hits, n, hits / n if n else None, low, high)


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean over n cases with the 95 % interval of the percentile bootstrap; all None for n = 0."""

    n: int
    value: float | None
    low: float | None
    high: float | None


def mean(values: list[float], seed: int = 0) -> Mean:
    """Return a mean with its bootstrap interval (2,000 resamples of cases)."""
    if not values:
        return Mean(0, None, None, None)
    data, rng = np.array(values), np.random.default_rng(seed)
    means = data[rng.integers(data.size, size=(2000, data.size))].mean(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return Mean(data.size, float(data.mean()), float(low), float(high))


@dataclass(frozen=True, slots=True)
class Power:
    """P(detected) = f + (1 - f) / (1 + (d50 / d')^slope), f the false alarms, and where it reaches 90 %.

    low, high: 95 % interval of d90, by the bootstrap over cases; None where the curve never gets there.
    """

    d50: float
    slope: float
    false_alarm: float
    d90: float | None
    low: float | None
    high: float | None


D50 = np.geomspace(0.5, 200.0, 121)
SLOPES = np.geomspace(0.5, 20.0, 25)
"""The grid of power curves; the most likely one is taken."""


def power(d: list[float], detected: list[bool], false_alarm: float, seed: int = 0) -> Power | None:
    """Return the most likely power curve; None for fewer than ten cases.

    d: d' of each case; detected: whether anything was found in it.
    """
    if len(d) < 10:
        return None
    x, y, rng = np.array(d), np.array(detected, dtype=np.float64)[:, None], np.random.default_rng(seed)
    d50, slope = (grid.ravel() for grid in np.meshgrid(D50, SLOPES))
    chance = false_alarm + (1.0 - false_alarm) / (1.0 + (d50 / x[:, None]) ** slope)
    chance = np.clip(chance, 1e-6, 1.0 - 1e-6)
    likelihood = y * np.log(chance) + (1.0 - y) * np.log1p(-chance)
    counts = rng.multinomial(x.size, np.full(x.size, 1.0 / x.size), size=500)
    best = np.argmax(np.vstack([np.ones(x.size), counts]) @ likelihood, axis=1)
    ninety = _ninety(d50[best], slope[best], false_alarm, float(x.max()))
    low, high = np.quantile(ninety[1:], (0.025, 0.975), method="nearest")
    values = [float(v) if np.isfinite(v) else None for v in (ninety[0], low, high)]
    return Power(float(d50[best[0]]), float(slope[best[0]]), false_alarm, *values)


def _ninety(d50: Array, slope: Array, false_alarm: float, largest: float) -> Array:
    """Return the d' at which curves reach 90 %; infinity where that is above the largest d' that was tried.

    With false alarms in 90 % of nulls nothing is detected, so the result is infinity too.
    """
    if false_alarm >= 0.9:
        return np.full(d50.size, np.inf)
    share = (0.9 - false_alarm) / (1.0 - false_alarm)
    reached = d50 * (share / (1.0 - share)) ** (1.0 / slope)
    return np.where(reached <= largest, reached, np.inf)
