"""The size at which an effect on noise, values, time stamps or motion has a given d'.

d' is the effect divided by the standard deviation of the measured quantity among phones without effects:
sampling error and the phones' own spread together (see `phones`). Each function returns the size, in the
documented parameter's unit. n: samples at rest; all d' above 0.
"""

from __future__ import annotations

import math

from stillcal.replay.blind_test.world.phones import (
    AXIS_SPREAD,
    JITTER_SPAN,
    LATE_SPREAD_S,
    LEVEL_SPREAD,
    SKEW_SPREAD,
)

UNIFORM = 1.0 / math.sqrt(3.0)
"""Standard deviation of a uniform distribution from -1 to 1."""

KURTOSIS_SPREAD, DROP_SPREAD, STALL_SPREAD, BANDWIDTH_SPREAD = 0.1, 1.5e-4, 4e-3, 0.06
"""Assumed spread among phones without effects: excess kurtosis, share of samples lost, share of time stalled,
logarithm of the bandwidth relative to 0.45 of the rate."""


def noise_ratio(d: float, n: int) -> float:
    """Return the ratio of all axes' noise to the claim; a logarithm of sigma has the error 1 / sqrt(2n)."""
    return math.exp(d * math.hypot(LEVEL_SPREAD * UNIFORM, 1.0 / math.sqrt(6.0 * n)))


def axis_ratio(d: float, n: int) -> float:
    """Return the ratio of one axis' noise to the others'."""
    return math.exp(d * math.hypot(AXIS_SPREAD * UNIFORM, 1.0 / math.sqrt(2.0 * n)))


def excess_kurtosis(ratio: float, fraction: float) -> float:
    """Return the excess kurtosis of a normal of which a fraction is `ratio` times as wide."""
    second = 1.0 - fraction + fraction * ratio**2
    return 3.0 * (1.0 - fraction + fraction * ratio**4) / second**2 - 3.0


def tail_ratio(d: float, n: int, fraction: float = 0.02) -> float:
    """Return the ratio of heavy-tailed samples, by bisection on the kurtosis (error sqrt(24 / n) an axis)."""
    target, low, high = d * math.hypot(KURTOSIS_SPREAD, math.sqrt(8.0 / n)), 1.0, 7.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess_kurtosis(middle, fraction) < target else (low, middle)
    return high


def skew(d: float, duration: float, n: int, latency_scatter: float) -> float:
    """Return a clock's skew; the slope of arrivals has the error scatter sqrt(12 / n) / duration."""
    return d * math.hypot(SKEW_SPREAD * UNIFORM, latency_scatter * math.sqrt(12.0 / n) / duration)


def jitter(d: float, period: float) -> float:
    """Return the scatter of stamps, s, all in all."""
    low, high = JITTER_SPAN
    return period * ((low + high) / 2.0 + d * (high - low) / 2.0 * UNIFORM)


def dropped(d: float, n: int) -> float:
    """Return the share of samples lost: counted, so with Poisson error."""
    square = d * d
    return 0.5 * (square / n + math.sqrt((square / n) ** 2 + 4.0 * square * DROP_SPREAD**2))


def stalled(d: float) -> float:
    """Return the share of time in which delivery stalls."""
    return d * STALL_SPREAD


def comb_step(d: float, n: int, sigma: float) -> float:
    """Return a step of the values: their phase on it has the mean length exp(-2 pi^2 sigma^2 / step^2)."""
    return math.pi * sigma * math.sqrt(2.0 / math.log(max(math.sqrt(6.0 * n) / d, 1.2)))


def tone_amplitude(d: float, n: int, sigma: float) -> float:
    """Return a tone's amplitude on one axis, by the matched filter."""
    return d * sigma * math.sqrt(2.0 / n)


def cutoff(d: float, rate_hz: float) -> float:
    """Return a low-pass' cutoff, Hz."""
    return 0.45 * rate_hz * math.exp(-d * BANDWIDTH_SPREAD)


def delay(d: float, information: float) -> float:
    """Return a delay between the sensors, s. information: of the motion about it, 1/s^2."""
    return d * math.hypot(LATE_SPREAD_S * UNIFORM, 1.0 / math.sqrt(information))
