"""Quantiles of Student's t, without the 25 MB of memory that scipy.stats takes.

The daemon fits in its own process and runs on for months afterwards; it keeps in memory what a fit imports.
"""

from __future__ import annotations

import math
from functools import lru_cache

_TERMS, _ROUNDS = 500, 100  # most terms of the continued fraction, and most of Newton's steps
_PRECISION = 1e-15  # relative; a few rounding errors of a float


@lru_cache(maxsize=4096)
def quantile(freedom: float, p: float) -> float:
    """Return the p-quantile of Student's t with `freedom` degrees of freedom.

    p: between 0 and 1, both excluded. freedom: positive and finite. Newton's method is applied to the
    logarithm of the tail over the logarithm of the quantile; that curve is concave, so that it converges from
    any start. Raises ValueError on other arguments.
    """
    if not 0.0 < p < 1.0 or not 0.0 < freedom < math.inf:
        raise ValueError(f"no quantile {p} of Student's t with {freedom} degrees of freedom")
    tail = min(p, 1.0 - p)
    if tail == 0.5:
        return 0.0
    goal, u = math.log(tail), 0.0
    for _ in range(_ROUNDS):
        t = math.exp(u)
        tail_now = _log_tail(t, freedom)
        step = (tail_now - goal) / math.exp(u + _log_density(t, freedom) - tail_now)
        u += step
        if abs(step) < 4 * _PRECISION:
            break
    return math.copysign(math.exp(u), p - 0.5)


def _log_density(t: float, freedom: float) -> float:
    """Return the logarithm of the density at t."""
    half = 0.5 * freedom
    norm = math.lgamma(half + 0.5) - math.lgamma(half) - 0.5 * math.log(math.pi * freedom)
    return norm - (half + 0.5) * math.log1p(t * t / freedom)


def _log_tail(t: float, freedom: float) -> float:
    """Return the log probability of exceeding t > 0 (Abramowitz and Stegun 26.7.1, 26.5.27)."""
    x = freedom / (freedom + t * t)
    a, b = 0.5 * freedom, 0.5
    if x < (a + 1.0) / (a + b + 2.0):
        return math.log(0.5) + log_beta_share(a, b, x)
    return math.log(0.5) + math.log1p(-math.exp(log_beta_share(b, a, t * t / (freedom + t * t))))


def log_beta_share(a: float, b: float, x: float) -> float:
    """Return log I_x(a, b), the regularised incomplete beta function, by its continued fraction.

    DLMF 8.17.22, evaluated forwards (Lentz 1976).
    """
    beta = math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)
    front = a * math.log(x) + b * math.log1p(-x) - math.log(a) - beta
    c, d = 1.0, 1.0 / (1.0 - (a + b) * x / (a + 1.0))
    value = d
    for m in range(1, _TERMS):
        even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        for term in (even, odd):
            d = 1.0 / (1.0 + term * d)
            c = 1.0 + term / c
            value *= c * d
        if abs(c * d - 1.0) < _PRECISION:
            break
    return front + math.log(value)
