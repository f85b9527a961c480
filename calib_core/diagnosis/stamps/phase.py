"""How many periods lie between stamps that jitter much, told by the phase of the grid that they lie on."""

from __future__ import annotations

import numpy as np
from scipy.optimize import isotonic_regression

from stillcal.calib_core.arrays import Array

BLOCK = 64
"""Stamps whose phases are added up to find the period, which is tried in steps of 1 / (4 BLOCK) of itself."""

BLOCKS = 400
"""Blocks, spread over the recording, that are enough to find the period."""

LONGER, SHORTER = 0.05, 0.4
"""Parts by which the true period may be longer or shorter than the usual interval.

Missing samples make intervals longer: with 40 % missing and much jitter, by 0.37.
"""

CLEAR = 5.0
"""Standard errors by which the phases of a period must agree, of some hundred periods tried."""

CERTAIN = 32.0
"""Times the squared resultant length, stamps in one window: they tell the phase to 0.02 periods."""


def periods_between(t: Array, usual: float) -> Array:
    """Return how many periods (n - 1,) lie between stamps t (n,) s that jitter. usual: their interval, s.

    Missing samples leave the phase of the grid as it is and put all later stamps a whole number of periods
    back; jitter does neither. So the whole numbers that never fall and lie nearest to the stamps' lag are
    sought: isotonic regression, rounded. All are one where jitter hides the grid.
    """
    one_each = np.ones(t.size - 1)
    period, agreement = _period(t, usual)
    if agreement <= 0.0 or (window := CERTAIN / agreement) > t.size / 4:
        return one_each
    turns = (t - t[0]) / period
    lag = turns - _phase(turns, int(window)) - np.arange(t.size)
    return np.asarray(one_each + np.diff(np.rint(isotonic_regression(lag).x)))


def _period(t: Array, usual: float) -> tuple[float, float]:
    """Return the period, s, at which phases agree best, and their squared resultant length; 0 if unclear."""
    starts = np.arange(0, t.size - BLOCK + 1, BLOCK)
    if starts.size == 0:
        return usual, 0.0
    rows = t[starts[:: -(-starts.size // BLOCKS), None] + np.arange(BLOCK)] / usual
    rates = np.arange(1.0 - LONGER, 1.0 + SHORTER, 1.0 / (4.0 * BLOCK))
    power = np.array([np.mean(np.abs(np.exp(2j * np.pi * rate * rows).mean(axis=1)) ** 2) for rate in rates])
    top = int(np.clip(np.argmax(power), 1, rates.size - 2))
    # Independent phases have a squared resultant of 1 / BLOCK, and of the same standard deviation.
    agreement = (power[top] - 1.0 / BLOCK) / (1.0 - 1.0 / BLOCK)
    if agreement < CLEAR / (BLOCK * np.sqrt(len(rows))):
        return usual, 0.0
    before, at, after = power[top - 1 : top + 2]
    off = 0.5 * (before - after) / (before - 2.0 * at + after)
    return usual / (rates[top] + off * (rates[1] - rates[0])), float(agreement)


def _phase(turns: Array, window: int) -> Array:
    """Return the phase (n,) of stamps (n,), both in periods, as the circular mean of `window` neighbours."""
    total = np.concatenate([[0.0], np.cumsum(np.exp(2j * np.pi * turns))])
    places = np.arange(turns.size)
    before = np.maximum(places - window // 2, 0)
    after = np.minimum(places + window // 2 + 1, turns.size)
    return np.asarray(np.unwrap(np.angle(total[after] - total[before])) / (2.0 * np.pi))
