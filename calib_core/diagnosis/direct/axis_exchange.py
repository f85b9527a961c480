"""Axes that are exchanged or have the wrong sign, for a while or throughout.

Gravity then does not go where the gyroscope takes it.

Only turns between rests are looked at. A stretch is garbled where most of its turns miss by far, the others
do not, and one exchange of axes or signs of one sensor, the same for the whole stretch, makes them fit. Where
one makes the turns of the whole recording fit, the two sensors are not told in the same axes. Turns about the
axes that are right fit in any case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding, sized
from stillcal.calib_core.diagnosis.model.records import NAME, Finding, Where
from stillcal.calib_core.diagnosis.model.residuals import fit_baseline
from stillcal.calib_core.diagnosis.model.sound_phones import log_mean_exp
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.turns import cuts
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.maths.rotation import attitudes, matrix
from stillcal.calib_core.streams.samples import Samples

LEAST_TURNS = 8
LEAST_THROUGHOUT = 5
"""Turns from which an exchange for a while is looked for, and one throughout, which needs no stretch."""

LEAST_BAD = 3
FAR = 0.25
TIMES = 8.0
MOST_BAD = 0.6
SOUND_PART = 0.3
"""Quantile of the misses that is a sound turn's even where as many as may be are bad."""
SOME = 40
"""Turns, spread over the recording, from which the gyroscope's scale or an exchange is chosen."""
DENSE = 0.6
MENDED = 0.75
LEAST_MISS, STRAY = 0.02, 0.05
"""rad, least scatter of a turn (a hand is no bench), and part of the turns that something else spoils."""
AXES = "xyz"


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One turn between rests. start, end: s; t (n,), rate (n, 3): of its samples; up: (2, 3) around it."""

    start: float
    end: float
    t: Array
    rate: Array
    up: Array

    def miss(self, accel: Array, gyro: Array, inside: tuple[bool, bool, bool]) -> float:
        """Return how far gravity is from where the rates take it, rad.

        accel, gyro: (3, 3), what mends each; inside: whether rest, rates and rest are to be mended.
        """
        rate = self.rate @ gyro.T if inside[1] else self.rate
        before = accel @ self.up[0] if inside[0] else self.up[0]
        after = accel @ self.up[1] if inside[2] else self.up[1]
        predicted = matrix(attitudes(self.t, rate))[-1].T @ before
        return float(np.linalg.norm(after - predicted))


def garbled(found: list[Step]) -> Finding | None:
    """Find the stretch of time in which one sensor's axes are not what they were, by the turns found."""
    if len(found) < LEAST_TURNS:
        return None
    found, size = _rescaled(found)
    bad = size > max(FAR, TIMES * float(np.quantile(size, SOUND_PART)))
    span = _stretch(bad)
    return None if span is None else _explained(found, size, bad, span)


def other_axes(found: list[Step]) -> Finding | None:
    """Find axes of the gyroscope that are others than the accelerometer's in all of the turns found.

    Which of the two has the other convention, no recording tells. Few turns may fit with several exchanges.
    """
    if len(found) < LEAST_THROUGHOUT:
        return None
    _, size = _rescaled(found)
    if _far(size) < LEAST_BAD:
        return None
    some = [*_spread(_chosen(found, size > FAR)), *_spread(_chosen(found, size <= FAR))]
    every = exchanges()
    misses = [_misses(some, change) for change in every]
    best, second = sorted(range(len(every)), key=lambda i: (_far(misses[i]), float(np.median(misses[i]))))[:2]
    if len(found) < LEAST_TURNS and _far(misses[second]) == _far(misses[best]):
        return None
    _, left = _rescaled([replace(s, rate=s.rate @ every[best].T) for s in found])
    if _far(left) > (1.0 - MENDED) * _far(size):
        return None
    none = np.empty(0)
    nats = _nats([*left[:, None]], none, float(len(every))) - _nats([*size[:, None]], none, 1.0)
    return _stated(found, size, (0, size.size - 1), ("gyro", every[best]), DirectEvidence(nats))


def _far(size: Array) -> int:
    """Return how many turns miss by far. size: (n,) rad."""
    return int(np.count_nonzero(size > FAR))


def turns_between(gyroscope: Samples | None, bins: Bins, gravity: float) -> list[Step]:
    """Return the turns between rests; none without a gyroscope, or where rests are too few to be judged."""
    if gyroscope is None or bins.rate is None or len(bins) <= LEAST_THROUGHOUT:
        return []
    baseline = fit_baseline(bins.force, bins.force_variance, bins.rest, gravity)
    return [
        Step(float(c.t[0]), float(c.t[-1]), c.t, c.rate, baseline.up[c.first : c.first + 2])
        for c in cuts(gyroscope, bins)
    ]


def _rescaled(found: list[Step]) -> tuple[list[Step], Array]:
    """Return the turns, rates multiplied by the factor that lets most of them fit, and their misses, rad.

    A wrong common scale of the gyroscope, as of a nominal value of one count, would else hide what is
    exchanged behind its own misses. Within a factor of 1.5, and to 1 %: what is left is within `LEAST_MISS`.
    Few turns tell no factor: some two of them fit with one by chance.
    """
    size = _misses(found, np.eye(3))
    if len(found) < LEAST_TURNS or TIMES * float(np.quantile(size, SOUND_PART)) <= FAR:
        return found, size
    some = _spread(found)

    def scatter(factor: float) -> float:
        return float(np.quantile(_misses(some, factor * np.eye(3)), SOUND_PART))

    best = min(np.exp(np.arange(-0.4, 0.41, 0.05)), key=scatter)
    best = min(best * np.exp(np.arange(-0.04, 0.041, 0.01)), key=scatter)
    scaled = [replace(s, rate=best * s.rate) for s in found]
    return scaled, _misses(scaled, np.eye(3))


def _spread(found: list[Step]) -> list[Step]:
    """Return `SOME` of the turns or fewer, spread over the recording."""
    return found[:: max(1, -(-len(found) // SOME))]


def _chosen(found: Sequence[Step], which: NDArray[np.bool_]) -> list[Step]:
    return [step for step, wanted in zip(found, which, strict=True) if wanted]


def _misses(found: Sequence[Step], gyro: Array) -> Array:
    """Return how far gravity is, rad, from where the rates, mended by `gyro` (3, 3), take it in each turn."""
    return np.array([s.miss(np.eye(3), gyro, (False, True, False)) for s in found])


def _stretch(bad: NDArray[np.bool_]) -> tuple[int, int] | None:
    """Return first and last turn of the stretch that holds the bad ones.

    None where there is no one stretch.
    """
    gain = np.concatenate([[0.0], np.cumsum(np.where(bad, 1.0, -1.0))])
    lowest = np.minimum.accumulate(gain)
    last = int(np.argmax(gain - lowest))
    first = int(np.argmin(gain[: last + 1]))
    inside = bad[first:last]
    if inside.sum() < LEAST_BAD or inside.mean() < DENSE or bad.mean() > MOST_BAD:
        return None
    if bad.sum() - inside.sum() > 0.1 * bad.size:
        return None
    return first, last - 1


def exchanges() -> list[Array]:
    """Return all exchanges of axes and signs but the one that changes nothing, the simplest first."""
    made = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        made.append(np.diag(signs) @ np.eye(3)[list(order)])
    made.sort(key=lambda m: float(np.abs(m - np.eye(3)).sum()))
    return made[1:]


def _explained(
    found: list[Step], size: Array, bad: NDArray[np.bool_], span: tuple[int, int]
) -> Finding | None:
    """Return the finding of the simplest exchange that mends the stretch."""
    limit = max(FAR, TIMES * float(np.quantile(size, SOUND_PART)))
    rows = range(span[0], span[1] + 1)
    same = np.eye(3)
    best = (0.0, "", same)
    for change, sensor in product(exchanges(), ("accel", "gyro")):
        accel, gyro = (change, same) if sensor == "accel" else (same, change)
        mended = [min(found[i].miss(accel, gyro, e) for e in _edges(i, span)) < limit for i in rows if bad[i]]
        share = float(np.mean(mended)) - 1e-3 * float(np.abs(change - same).sum())
        if share > best[0] + 1e-9:
            best = share, sensor, change
    share, sensor, change = best
    if share < MENDED:
        return None
    mends = (change, same) if sensor == "accel" else (same, change)
    misses = [np.array([found[i].miss(*mends, e) for e in _edges(i, span)]) for i in rows]
    seen = DirectEvidence(_nats(misses, size[~bad], 2.0 * len(exchanges()) * 0.5 * size.size**2))
    return _stated(found, size, span, (sensor, change), seen)


def _nats(misses: Sequence[Array] | Array, sound: Array, tries: float) -> float:
    """Return the evidence for an exchange that leaves `misses`, rad, in turns that fitted nothing.

    misses: (e,) of each turn, by which of its parts are exchanged (`_edges`), alike before the data. With
    the exchange they are those of the other turns, `sound` (n,), Rayleigh distributed, but one in
    `1 / STRAY`; without it gravity goes anywhere on the sphere. Where no others are, how far sound turns
    miss is not known but for its range. tries: exchanges of both sensors, times spans of turns.
    """
    least = LEAST_MISS**2
    scales = [max(float(np.mean(sound**2)) / 2.0, least)] if sound.size else np.geomspace(least, FAR**2, 6)
    told = []
    for scale in scales:
        ratio = np.array([2.0 / scale * np.exp(-0.5 * miss**2 / scale).mean() for miss in misses])
        told.append(float(np.log((1.0 - STRAY) * ratio + STRAY).sum()))
    return log_mean_exp(np.array(told)) - float(np.log(tries))


def _edges(i: int, span: tuple[int, int]) -> list[tuple[bool, bool, bool]]:
    """Return which of rest, rates, rest may be garbled in a turn: all within, some at the stretch's edges."""
    if span[0] < i < span[1]:
        return [(True, True, True)]
    return [
        (False, False, True),
        (False, True, True),
        (True, True, True),
        (True, True, False),
        (True, False, False),
    ]


def _stated(
    found: list[Step], size: Array, span: tuple[int, int], exchange: tuple[str, Array], seen: DirectEvidence
) -> Finding | None:
    (first, last), (sensor, change) = span, exchange
    start, end = found[first].start, found[last].end
    inside = np.zeros(size.size, dtype=bool)
    inside[first : last + 1] = True
    axes = [a for a in range(3) if change[a, a] != 1.0]
    told = ", ".join(
        f"{AXES[a]} is {'-' if change[a].sum() < 0 else ''}{AXES[int(np.argmax(np.abs(change[a])))]}"
        for a in axes
    )
    say = f"From {start:.0f} to {end:.0f} s the {NAME[sensor]}'s axes are exchanged: {told}."
    before = rms(size[inside])
    where = Where(start, end, (0.0, 10.0), "rate of turn")
    sizes = sized({"miss": (before, "rad"), "exchange": (change.tolist(), "1")})
    return direct_finding("axis_exchange", sensor, axes, where, sizes, statement=say, seen=seen)


def outside(bins: Bins, t_start: float, t_end: float) -> Bins:
    """Return the bins that do not touch a stretch of time."""
    return bins.chosen((bins.t + bins.duration / 2 < t_start) | (bins.t - bins.duration / 2 > t_end))
