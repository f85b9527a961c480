"""A bias that switches to and fro between two levels, at times that nobody told: the likeliest such course.

Supplies of other parts that switch, strain that a move leaves one way or the other, bursts of one size, and
popcorn noise all look so. There are too many courses to try; from a first stretch one is grown by flipping
whichever interval gains most, each switch paid for by the number of places where it could have been.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array

FEWEST = 3
MOST = 100
FLIPS = 200
LEAST_LEFT = 0.02
SHARES = (0.4, 1.0)
"""Parts of their price that switches pay at first, so that a course may grow, and at last."""


@dataclass(frozen=True, slots=True, eq=False)
class TwoLevelPath:
    """Changes (n,) of level, +1, 0 or -1, at each of n borders; switches: how many.

    log_trials: log of the number of courses that it was chosen from.
    """

    changes: NDArray[np.int64]
    switches: int
    log_trials: float


def grown(gram: Array, target: Array, power: float, first: int, last: int) -> TwoLevelPath | None:
    """Return the likeliest course about one stretch between borders `first` and `last`.

    gram: (n, 3, n, 3) and target (n, 3): inner products of steps at the borders, on each axis, with each
    other and with the data, all whitened and scaled to unit prior variance; power: of the data. None where
    fewer than `FEWEST` switches gain what they cost: a step or a stretch, which have hypotheses of their own.
    """
    n = len(target)
    prices = _prices(n)
    changes = np.zeros(n + 1, dtype=np.int64)
    changes[first], changes[last] = 1, -1
    for share in SHARES:
        # What a course explains is not noise: the more, the surer is what it gains.
        size = _amplitude(gram, target, changes[:n])
        sure = power / max(power - float(size @ (changes[:n].astype(float) @ target)), LEAST_LEFT * power)
        for _ in range(FLIPS):
            size = _amplitude(gram, target, changes[:n])
            flip = _best_flip(gram, target, changes, size, share / sure * prices)
            if flip is None:
                break
            changes = _flipped(changes, *flip)
    switches = int(np.abs(changes[:n]).sum())
    if not FEWEST <= switches <= MOST:
        return None
    return TwoLevelPath(changes[:n], switches, float(prices[switches]))


def _prices(n: int) -> Array:
    """Log of the number of courses with m switches among n borders, and of the m tried; m up to n + 2."""
    m = np.arange(1, n + 3)
    ways = np.concatenate([[0.0], np.cumsum(np.log(np.maximum(n + 1 - m, 1) / m))])
    ways[MOST + 1 :] = np.inf
    return np.asarray(ways + np.log(np.maximum(np.arange(ways.size), 1)))


def _amplitude(gram: Array, target: Array, changes: NDArray[np.int64]) -> Array:
    """Return the most probable difference (3,) of the levels."""
    at = np.flatnonzero(changes)
    signs = changes[at].astype(float)
    information = np.einsum("i,iajb,j->ab", signs, gram[at][:, :, at], signs) + np.eye(3)
    return np.asarray(np.linalg.solve(information, signs @ target[at]))


def _best_flip(
    gram: Array, target: Array, changes: NDArray[np.int64], size: Array, prices: Array
) -> tuple[int, int] | None:
    """Return the interval between two borders whose flip gains most with its price paid, if any gains."""
    n = len(target)
    products = np.zeros((n + 1, n + 1))
    products[:n, :n] = size @ (gram @ size)
    pull = np.append(target @ size, 0.0) - products @ changes
    own = np.diag(products)
    level = np.cumsum(changes)[:n]
    run = np.cumsum(np.diff(level, prepend=level[0]) != 0)
    at = np.arange(n)
    inside = (run[:, None] == run[None, :]) & (at[:, None] <= at[None, :])
    sign = 1.0 - 2.0 * level[:, None]
    gain = sign * (pull[:n, None] - pull[None, 1:])
    gain -= 0.5 * (own[:n, None] + own[None, 1:] - 2.0 * products[:n, 1:])
    switched = np.where(changes == 0, 1, -1)
    switched[n] = 0
    before = int(np.abs(changes[:n]).sum())
    after = np.clip(before + switched[:n, None] + switched[None, 1:], 0, prices.size - 1)
    gain = np.where(inside, gain - prices[after] + prices[before], -np.inf)
    best = int(np.argmax(gain))
    a, b = divmod(best, n)
    return (a, b + 1) if gain[a, b] > 1e-6 else None


def _flipped(changes: NDArray[np.int64], a: int, b: int) -> NDArray[np.int64]:
    """Return the changes of level with the level turned over between borders a and b (n: the end)."""
    out = changes.copy()
    sign = 1 - 2 * int(np.cumsum(changes)[a])
    out[a] += sign
    out[b] -= sign
    return out
