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

AS_WELL = 0.9
"""Part of the best agreement from which a period is tried, too.

Stamps that are rounded to steps agree equally well at a mirrored rate: the steps' rate less the true one. At
that rate the lag falls where two stamps are close, and numbers that never fall follow it less closely.
"""


def periods_between(t: Array, usual: float) -> Array:
    """Return how many periods (n - 1,) lie between stamps t (n,) s that jitter. usual: their interval, s.

    Missing samples leave the phase of the grid as it is and put all later stamps a whole number of periods
    back; jitter does neither. So the whole numbers that never fall and lie nearest to the stamps' lag are
    sought: isotonic regression, rounded. Of several periods, the one whose lag they follow most closely
    counts. All are one where jitter hides the grid.
    """
    best, nearest = np.zeros(t.size), np.inf
    for period, agreement in _periods(t, usual):
        window = int(CERTAIN / agreement)
        if window > t.size / 4:
            continue
        turns = (t - t[0]) / period
        lag = turns - _phase(turns, window) - np.arange(t.size)
        lost = np.rint(isotonic_regression(lag).x)
        off = float(np.var(lag - lost))
        if off < nearest:
            best, nearest = lost, off
    return np.asarray(1.0 + np.diff(best))


def _periods(t: Array, usual: float) -> list[tuple[float, float]]:
    """Return the periods, s, at which phases agree best, and their squared resultant lengths."""
    starts = np.arange(0, t.size - BLOCK + 1, BLOCK)
    if starts.size == 0:
        return []
    rows = t[starts[:: -(-starts.size // BLOCKS), None] + np.arange(BLOCK)] / usual
    rates = np.arange(1.0 - LONGER, 1.0 + SHORTER, 1.0 / (4.0 * BLOCK))
    power = np.array([np.mean(np.abs(np.exp(2j * np.pi * rate * rows).mean(axis=1)) ** 2) for rate in rates])
    # Independent phases have a squared resultant of 1 / BLOCK, and of the same standard deviation.
    agreement = (power - 1.0 / BLOCK) / (1.0 - 1.0 / BLOCK)
    peaks = 1 + np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:]))
    clear = max(CLEAR / (BLOCK * np.sqrt(len(rows))), AS_WELL * float(agreement.max()))
    found = []
    for top in peaks[agreement[peaks] >= clear]:
        before, at, after = power[top - 1 : top + 2]
        off = 0.5 * (before - after) / (before - 2.0 * at + after)
        found.append((usual / (rates[top] + off * (rates[1] - rates[0])), float(agreement[top])))
    return found


def _phase(turns: Array, window: int) -> Array:
    """Return the phase (n,) of stamps (n,), both in periods, as the circular mean of `window` neighbours."""
    total = np.concatenate([[0.0], np.cumsum(np.exp(2j * np.pi * turns))])
    places = np.arange(turns.size)
    before = np.maximum(places - window // 2, 0)
    after = np.minimum(places + window // 2 + 1, turns.size)
    return np.asarray(np.unwrap(np.angle(total[after] - total[before])) / (2.0 * np.pi))
