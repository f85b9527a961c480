"""The ends of rests that belong to a slow move: a motor or a careful hand begins and ends without haste."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths.robust import MAD_TO_SD

SURELY = 4.0
"""Standard deviations of a window's mean rate beyond which it is not that of the rest."""

FALLS, AS_SLOWLY = 1.1, 10.0
"""Times that the rate falls from one window to the next, at least and at most, where a slow move ends. What a
bias does falls less in a second; a hand that puts a phone down leaves less by far."""


def without_slow_moves(runs: list[tuple[int, int]], rate: Array, shortest: int) -> list[tuple[int, int]]:
    """Return rests [first, last) without the windows at their ends in which the phone turned already.

    rate: (n, 3) rad/s, means of windows. A move that grows from nothing is below any limit at first; its rate
    falls steadily from the moving windows inwards until it is that of the rest. Rests that keep fewer than
    `shortest` windows are left out.
    """
    kept = []
    for first, last in runs:
        apart = _apart(rate, first, last)
        at_start = _turning(apart[: last - first + 2])
        at_end = _turning(apart[::-1][: last - first + 2])
        if last - at_end - (first + at_start) >= shortest:
            kept.append((first + at_start, last - at_end))
    return kept


def _apart(rate: Array, first: int, last: int) -> Array:
    """Return how far the rates of a rest, and of two windows on either side, are from its own.

    (last - first + 4,), in standard deviations of the axis that is farthest; 0 beyond the recording.
    """
    own = rate[first:last]
    noise = MAD_TO_SD * np.median(np.abs(np.diff(own, axis=0)), axis=0) / np.sqrt(2.0)
    inside = np.arange(first - 2, last + 2)
    there = (inside >= 0) & (inside < len(rate))
    off = np.abs(rate[inside[there]] - np.median(own, axis=0)) / np.maximum(noise, 1e-9)
    apart = np.zeros(inside.size)
    apart[there] = off.max(axis=1)
    return apart


def _turning(apart: Array) -> int:
    """Return how many windows of a rest turn already. apart: of two windows outside it, then of its own.

    None where the recording begins or ends with the rest: there is no move.
    """
    before, turning = float(apart[:2].max()), 0
    for off in apart[2:] if apart[0] else ():
        if off < SURELY or not off * FALLS < before < off * AS_SLOWLY:
            break
        before, turning = float(off), turning + 1
    return turning
