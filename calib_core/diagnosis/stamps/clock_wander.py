"""A clock whose rate is not constant: arrival less stamp, without its line, follows a smooth curve.

Only the quickest delivery of each piece counts, since others waited. A delivery that becomes slower or
quicker at once shifts all that follow: in the rate it is one value, which robust weights leave out. A curve
is what many neighbouring values share.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import (
    FOLDS,
    HeldOut,
    Measured,
    direct_finding,
    of_measured,
)
from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.maths.rms import rms

DRIVER = "a clock whose rate is not constant"
PIECES = 40
COSINES = 6
"""Half-periods of the quickest curve in the recording: nearly seven values to each."""

HUBER = 1.345
"""Standard deviations beyond which a value's weight falls (Huber, Ann. Math. Stat. 35, 1964)."""

UPPER_QUARTILE = 1.1503
"""Standard deviations that a quarter of a normal distribution is beyond, on either side together."""

ROUNDS = 20
FLOOR = 1e-7
"""Relative rate that is none: 0.1 ppm, far below what any clock keeps."""


def wander(t: Array, arrival: Array, usual: Usual, where: Where) -> Finding | None:
    """Find a clock whose rate changes smoothly against the host's. usual: of the rms change of its rate.

    Its swing is the range of arrival less stamp, without a straight line, s.

    t, arrival: (n,) s by the device's clock and the host's.
    """
    at, rate, weight = rates(t, arrival)
    curves = _cosines(at)
    curve, spread = _curve(rate, curves, weight)
    noise = spread * np.sqrt(COSINES / rate.size)
    size = Measured(float(np.sqrt(max(float(np.mean(curve**2)) - noise**2, 0.0))), max(noise, FLOOR))
    seen = of_measured(size, usual, _held_out(rate, curves, weight))
    lead = np.cumsum(curve * np.gradient(at))
    lead -= np.polyval(np.polyfit(at, lead, 1), at)
    swing = Measured(float(np.ptp(lead)), float(np.ptp(lead)) * size.error / max(size.value, FLOOR))
    say = f"The clock's rate is not constant: arrival less stamp swings by {swing.value * 1e3:.3g} ms."
    there = Where(where.t_start, where.t_end, (0.0, COSINES / 2.0 / float(np.ptp(at))), DRIVER)
    parameters = {"swing": swing.parameter("s"), "relative": size.parameter("1")}
    return direct_finding("unknown", "timing", [], there, parameters, statement=say, seen=seen)


def rates(t: Array, arrival: Array) -> tuple[Array, Array, Array]:
    """Return host seconds per device second, less 1, between the quickest deliveries of neighbouring pieces.

    (m,) each: when, s of the device's clock; the rate; and its weight, the time between the two.
    """
    late = arrival - t
    pieces = np.array_split(np.arange(t.size), PIECES)
    quickest = np.array([p[np.argmin(late[p])] for p in pieces])
    x, y = t[quickest], late[quickest]
    apart = np.maximum(np.diff(x), 1e-9)
    return (x[1:] + x[:-1]) / 2.0, np.diff(y) / apart, apart / apart.mean()


def _cosines(at: Array) -> Array:
    """Return a constant and `COSINES` cosines over times (m,), (m, COSINES + 1)."""
    place = (at - at[0]) / float(np.ptp(at))
    return np.asarray(np.cos(np.pi * np.outer(place, np.arange(COSINES + 1))))


def _curve(rate: Array, curves: Array, weight: Array) -> tuple[Array, float]:
    """Return the curve through rates (m,) less its mean, and the spread of one rate about it, robustly."""
    fit, spread = _robust(rate, curves, weight)
    curve = curves @ fit
    return np.asarray(curve - curve.mean()), spread


def _robust(rate: Array, curves: Array, weight: Array) -> tuple[Array, float]:
    """Return coefficients by Huber's weights, and the spread about them, by their upper quartile.

    A quarter of the rates may be off by any amount, and half may scatter more than the others.

    A rate between deliveries that are twice as far apart is twice as sure.
    """
    trust: Array = np.ones(rate.size)
    freedom = np.sqrt(rate.size / (rate.size - curves.shape[1]))
    fit: Array = np.zeros(curves.shape[1])
    spread = 0.0
    for _ in range(ROUNDS):
        root = np.sqrt(trust) * weight
        fit = np.asarray(np.linalg.lstsq(curves * root[:, None], rate * root, rcond=None)[0], np.float64)
        off = np.abs(rate - curves @ fit) * weight
        spread = max(float(np.quantile(off, 0.75)) / UPPER_QUARTILE * freedom, 1e-12)
        trust = np.asarray(np.minimum(1.0, HUBER * spread / np.maximum(off, 1e-300)), dtype=np.float64)
    return fit, spread


def _held_out(rate: Array, curves: Array, weight: Array) -> HeldOut:
    """Predict each fifth of the rates by the curve through the others, and by their level."""
    fold, gain = np.arange(rate.size) % FOLDS, 0.0
    before, after = np.zeros(rate.size), np.zeros(rate.size)
    for k in range(FOLDS):
        train, test = fold != k, fold == k
        for design, left in ((curves, after), (curves[:, :1], before)):
            fit, spread = _robust(rate[train], design[train], weight[train])
            left[test] = (rate - design @ fit)[test]
            off = np.minimum(np.abs(left[test]) * weight[test] / spread, 2.0 * HUBER)
            score = float(-0.5 * (off**2).sum() - test.sum() * np.log(spread))
            gain += score if left is after else -score
    return HeldOut(gain, rms(before), rms(after))
