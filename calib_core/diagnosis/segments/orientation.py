"""Where a resting phone kept its pose, by the gyroscope: jumps of specific force are then the sensor's own.

Specific force that jumps across gravity is a nudge of the phone or a step of the bias. A nudge shows in the
gyroscope. Rests between which nothing turned are one rest, and a nudge parts the poses within one. What jumps
by no more than a turn that the gyroscope may have missed parts them too. What jumps by more than a bias can
was turned, whatever the gyroscope says: it may have stopped.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths.robust import MAD_TO_SD, means

Index = NDArray[np.int64]

NUDGED = 5.5
"""Standard deviations of the angle by noise alone, beyond which the phone turned."""

LONGEST_GAP = 10
"""Windows between two rests that may be one."""

LARGEST = 0.02
"""rad/s in a window of a gap, beyond which what the gyroscope adds up to is not that exact."""

CLEARLY = 3.0
"""Times the largest turn that the gyroscope may have missed, above which a jump is the sensor's own."""

MOST_OF_BIAS = 1.2
"""m/s^2, beyond which no bias jumps: four standard deviations of what a step of it is at most (`SIZE` in
effects/bias.py)."""

GRAVITY = 9.8
AROUND = 15
"""Windows to either side whose mean is the gyroscope's bias at a window."""


def poses(
    runs: list[tuple[int, int]], force: Array, rate: Array, count: Array, window: float
) -> tuple[Index, Index]:
    """Return the rest (r,) of each run, and the pose (n,) of every window, counted up at each turn.

    runs: [first, last) windows at rest; force, rate: (n, 3) means of windows, m/s^2 and rad/s; count: (n,)
    their samples; window: s.
    """
    turned, rest = np.zeros(len(rate), dtype=np.int64), np.zeros(len(runs), dtype=np.int64)
    if not runs:
        return rest, turned
    angles = [_less_bias(rate[a:b]) * window for a, b in runs]
    noise = np.maximum(MAD_TO_SD * np.median(np.abs(np.concatenate(angles)), axis=0), 1e-9)
    for k, ((a, b), own) in enumerate(zip(runs, angles, strict=True)):
        rest[k] = rest[k - 1] if k else 0
        if k:
            before = runs[k - 1]
            jump = _jump(force, before, (a, b))
            moved = jump > MOST_OF_BIAS or _turned(before, (a, b), rate, count, noise / window)
            missed = NUDGED * np.sqrt(a - before[1] + 2) * float(noise.max()) * GRAVITY
            rest[k] += moved
            turned[a] += moved or jump < CLEARLY * missed
        pairs = np.abs(own[1:] + own[:-1]) > NUDGED * np.sqrt(2.0) * noise
        turned[a + 1 : b] += pairs.any(axis=1)
    return rest, np.cumsum(turned)


def _less_bias(rate: Array) -> Array:
    """Take the mean of their neighbourhood off the rates (n, 3) of a rest."""
    at = np.arange(len(rate))
    return rate - means(rate, np.maximum(at - AROUND, 0), np.minimum(at + AROUND + 1, len(rate)))


def _turned(before: tuple[int, int], after: tuple[int, int], rate: Array, count: Array, noise: Array) -> bool:
    """Whether the phone turned between two rests, or whether that cannot be told. noise: (3,) of a rate."""
    first, last = before[1] - 1, after[0] + 1
    if last - first > LONGEST_GAP + 2 or count[first:last].min() < 0.5 * float(np.median(count)):
        return True
    own = rate[first:last] - np.concatenate(_ends(rate, before, after)).mean(axis=0)
    total = np.abs(own.sum(axis=0)) > NUDGED * np.sqrt(len(own)) * noise
    return bool(total.any() or np.abs(own).max() > LARGEST)


def _jump(force: Array, before: tuple[int, int], after: tuple[int, int]) -> float:
    """Return by how much specific force differs between two rests, m/s^2."""
    end, start = _ends(force, before, after)
    return float(np.linalg.norm(start.mean(axis=0) - end.mean(axis=0)))


def _ends(values: Array, before: tuple[int, int], after: tuple[int, int]) -> tuple[Array, Array]:
    """Return the last windows of one rest and the first of the next."""
    return values[before[0] : before[1]][-AROUND:], values[after[0] : after[1]][:AROUND]


def of_bins(pose: Index, first: Array, last: Array) -> Index:
    """Return the pose (n,) of bins of windows [first, last); one that was turned in has a pose of its own."""
    start, end = pose[first.astype(int)], pose[last.astype(int) - 1]
    return np.asarray(np.unique(2 * start + (end > start), return_inverse=True)[1], dtype=np.int64)
