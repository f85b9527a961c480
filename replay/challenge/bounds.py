"""Rates with honest bounds, and the power curve: no rate is told without how sure it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.samples import Array


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
    """A mean over n cases with the 95 % interval of the percentile bootstrap; value None for n = 0."""

    n: int
    value: float | None
    low: float
    high: float


def mean(values: list[float], seed: int = 0) -> Mean:
    """Return a mean with its bootstrap interval (2,000 resamples of cases)."""
    if not values:
        return Mean(0, None, -math.inf, math.inf)
    data, rng = np.array(values), np.random.default_rng(seed)
    means = data[rng.integers(data.size, size=(2000, data.size))].mean(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return Mean(data.size, float(data.mean()), float(low), float(high))


@dataclass(frozen=True, slots=True)
class Power:
    """P(detected) = false + (1 - false) / (1 + exp(-(a + b ln d'))), and where it reaches 90 %.

    low, high: 95 % interval of d90, by the bootstrap over cases; None where the curve never gets there.
    """

    a: float
    b: float
    false_alarm: float
    d90: float | None
    low: float | None
    high: float | None


def power(d: list[float], found: list[bool], false_alarm: float, seed: int = 0) -> Power | None:
    """Fit the power curve by penalised likelihood; None for fewer than ten cases."""
    if len(d) < 10:
        return None
    x, y, rng = np.log(np.array(d)), np.array(found, dtype=np.float64), np.random.default_rng(seed)
    a, b = _logistic(x, y, false_alarm)
    draws = [rng.integers(x.size, size=x.size) for _ in range(200)]
    resampled = [_ninety(*_logistic(x[rows], y[rows], false_alarm), false_alarm) for rows in draws]
    low, high = np.quantile(
        [math.inf if v is None else v for v in resampled], (0.025, 0.975), method="nearest"
    )
    told = [None if math.isinf(v) else float(v) for v in (low, high)]
    return Power(a, b, false_alarm, _ninety(a, b, false_alarm), *told)


def _ninety(a: float, b: float, false_alarm: float) -> float | None:
    share = (0.9 - false_alarm) / (1.0 - false_alarm)
    if share <= 0.0:
        return 0.0
    where = (math.log(share / (1.0 - share)) - a) / b if b > 1e-3 else math.inf
    return math.exp(where) if where < math.log(1e3) else None


def _logistic(x: Array, y: Array, false_alarm: float) -> tuple[float, float]:
    """Return (a, b >= 0) of highest likelihood, with a weak prior N(0, 10^2) on both against separation."""
    from scipy.optimize import minimize  # noqa: PLC0415 - the command line starts without it

    def loss(p: Array) -> float:
        chance = false_alarm + (1.0 - false_alarm) / (1.0 + np.exp(-np.clip(p[0] + p[1] * x, -30.0, 30.0)))
        chance = np.clip(chance, 1e-9, 1.0 - 1e-9)
        likelihood = y * np.log(chance) + (1.0 - y) * np.log1p(-chance)
        return float(-likelihood.sum() + 0.005 * (p @ p))

    fit = minimize(loss, np.array([-3.0, 2.0]), method="L-BFGS-B", bounds=[(-40.0, 40.0), (0.0, 20.0)])
    return float(fit.x[0]), float(fit.x[1])
