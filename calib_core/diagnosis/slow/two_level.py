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
SWEEPS = 3
"""Times that every switch is placed within its bin, the others where they were placed before."""


@dataclass(frozen=True, slots=True, eq=False)
class TwoLevelPath:
    """Changes (n,) of level at each of n borders; switches: how many.

    A switch is a change of +1 or -1, or shared by two borders where it came within the bin between them.
    log_trials: log of the number of courses that it was chosen from.
    """

    changes: Array
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
    placed, paid = _within_bins(gram, target, changes[:n])
    return TwoLevelPath(placed, switches, float(prices[switches]) + paid)


def _prices(n: int) -> Array:
    """Log of the number of courses with m switches among n borders, and of the m tried; m up to n + 2."""
    m = np.arange(1, n + 3)
    ways = np.concatenate([[0.0], np.cumsum(np.log(np.maximum(n + 1 - m, 1) / m))])
    ways[MOST + 1 :] = np.inf
    return np.asarray(ways + np.log(np.maximum(np.arange(ways.size), 1)))


def _amplitude(gram: Array, target: Array, changes: NDArray[np.int64] | Array) -> Array:
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


def _within_bins(gram: Array, target: Array, changes: NDArray[np.int64]) -> tuple[Array, float]:
    """Return changes whose switches come within a bin where that is likelier, and what they pay for it, nats.

    The mean of such a bin lies between both levels. Taken for one of them it would be an outlier, and a
    wander that follows outliers also takes up a part of each switch: the levels would seem less far apart.
    """
    at = np.flatnonzero(changes)
    places, signs, n = at.astype(float), changes[at], len(changes)
    # Two switches at neighbouring borders share the bin between them, and stay where they are.
    alone = [j for j, i in enumerate(at) if np.count_nonzero(changes[max(i - 1, 0) : i + 2]) == 1]
    placed, paid = changes.astype(float), np.zeros(at.size)
    for _ in range(SWEEPS):
        size = _amplitude(gram, target, placed)
        products, pull = size @ (gram @ size), target @ size
        for j in alone:
            others = placed - signs[j] * _step(places[j], n)
            left = signs[j] * (pull - products @ others)
            places[j], paid[j] = _likeliest(products, left, int(at[j]))
            placed = others + signs[j] * _step(places[j], n)
    return placed, float(paid.sum())


def _step(place: float, n: int) -> Array:
    """Return a step as a sum of those at n borders: shared by two of them where it comes between these."""
    before = int(place)
    out = np.zeros(n)
    out[before : before + 2] = [1.0 - (place - before), place - before][: n - before]
    return out


def _likeliest(products: Array, pull: Array, border: int) -> tuple[float, float]:
    """Return the place of a step at a border or within one of its two bins, and what it pays for that, nats.

    products: (n, n) of steps at the borders; pull: (n,) of these with what other steps leave of the data. A
    place pays for the number of places in a bin that the data tell apart (Laplace).
    """
    place, paid, most = float(border), 0.0, 0.0
    for near in (border - 1, border + 1):
        if not 0 <= near < len(pull):
            continue
        own, both, other = products[border, border], products[border, near], products[near, near]
        steep, curved = pull[near] - pull[border] - both + own, own - 2.0 * both + other
        share = min(max(steep / curved, 0.0), 1.0) if curved > 0.0 else 0.0
        price = 0.5 * np.log(max(curved / (2.0 * np.pi), 1.0))
        gain = share * steep - 0.5 * share**2 * curved - price
        if gain > most:
            place, paid, most = border + share * (near - border), price, gain
    return place, paid


def _flipped(changes: NDArray[np.int64], a: int, b: int) -> NDArray[np.int64]:
    """Return the changes of level with the level turned over between borders a and b (n: the end)."""
    out = changes.copy()
    sign = 1 - 2 * int(np.cumsum(changes)[a])
    out[a] += sign
    out[b] -= sign
    return out
