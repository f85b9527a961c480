"""Samples that stand in the wrong order: two exchanged, or a stretch of some that runs backwards.

Turned round, they follow their neighbours again on all axes. An order that is right has no reason to look
better turned round: the power that neighbours leave about such a place has six independent numbers and more,
and it takes all of them to fall together by chance. At rest every order is alike, so motion tells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import Seen, direct_finding, sized
from stillcal.calib_core.diagnosis.model.records import NAME, Finding, Where
from stillcal.calib_core.diagnosis.sequence.neighbours import REACH, residual, spread
from stillcal.calib_core.streams.samples import Samples

DRIVER = "order of the samples"
INDEPENDENT = 6
"""Residuals that an exchange of two samples changes on one axis.

All axes count as one: what moves a phone may go along one line."""

LONGEST = 64
"""Samples in a stretch that runs backwards, at most: what FIFOs of phones hold at once."""

CLEAR = 30.0
"""Times the power of noise, and of the residuals about it, that the ends of a stretch stand out by."""

NEARBY = 33
"""Residuals, on either side together, that an end is held against."""

MOST_ENDS = 400
"""Ends that are tried, the clearest, and ten times as many that may be."""


@dataclass(frozen=True, slots=True)
class Turned:
    """Rows `first` to `last` (not included), which follow their neighbours when turned round; nats for it."""

    first: int
    last: int
    nats: float


def wrong_order(samples: Samples, sensor: str) -> Finding | None:
    """Find samples of one sensor that follow their neighbours only in another order."""
    if len(samples) < 2 * NEARBY:
        return None
    found = turned(samples.xyz)
    if not found:
        return None
    t, count = samples.t, float(sum(one.last - one.first for one in found))
    longest = max(one.last - one.first for one in found)
    where = Where(float(t[found[0].first]), float(t[found[-1].last - 1]), (0.0, 0.0), DRIVER)
    say = (
        f"Samples of the {NAME[sensor]} are in the wrong order at {len(found)} places of motion, up to"
        f" {longest} at a time: turned round, they follow their neighbours."
    )
    sizes = sized(
        {"places": (float(len(found)), "1"), "samples": (count, "1"), "longest": (float(longest), "1")}
    )
    seen = Seen(sum(one.nats for one in found))
    return direct_finding("unknown", sensor, [0, 1, 2], where, sizes, statement=say, seen=seen)


def turned(xyz: Array) -> list[Turned]:
    """Return the stretches of values (n, 3) that are better turned round, in order, each worth its tries."""
    moved = xyz / spread(residual(xyz))
    every = sorted([*_exchanged(moved), *_backwards(moved)], key=lambda one: -one.nats)
    taken = np.zeros(len(xyz), dtype=np.bool_)
    kept = []
    for one in every:
        rows = slice(max(one.first - REACH, 0), one.last + REACH)
        if not taken[rows].any():
            taken[rows] = True
            kept.append(one)
    return sorted(kept, key=lambda one: one.first)


def _nats(before: Array, after: Array, count: float, tries: float) -> Array:
    """Return nats for an order by the power left before and after, of `count` noises of power one each."""
    ratio = (before + count) / (np.maximum(after, 0.0) + count)
    return np.asarray(0.5 * INDEPENDENT * np.log(ratio) - np.log(tries))


def _exchanged(moved: Array) -> list[Turned]:
    """Return all pairs of neighbours that are better exchanged; moved: (n, 3) in units of noise."""
    left = residual(moved)
    n = len(left) - INDEPENDENT + 1
    if n < 1:
        return []
    # Row 4 + i and the one after are exchanged: residuals that know either change by `change` times the step.
    change = residual(np.array([0, 0, 0, 0, 1, -1, 0, 0, 0, 0], dtype=np.float64)[:, None])[:, 0]
    step = np.diff(moved, axis=0)[2 * REACH : 2 * REACH + n]
    rows = [left[i : i + n] for i in range(INDEPENDENT)]
    before = np.asarray(sum((r**2).sum(axis=1) for r in rows))
    along = np.asarray(sum((step * r).sum(axis=1) * c for r, c in zip(rows, change, strict=True)))
    after = before + 2.0 * along + (step**2).sum(axis=1) * float(change @ change)
    nats = _nats(before, after, float(INDEPENDENT * moved.shape[1]), 2.0 * len(moved))
    return [Turned(int(i) + 4, int(i) + 6, float(nats[i])) for i in np.flatnonzero(nats > 0.0)]


def _backwards(moved: Array) -> list[Turned]:
    """Return stretches of three samples and more that are better turned round.

    They begin and end where residuals stand out of those nearby: within, a smooth motion is as smooth turned.
    """
    ends = _ends(moved)
    tries = 2.0 * len(moved) * LONGEST
    found = []
    for i, begin in enumerate(ends):
        for end in ends[i + 1 :]:
            length = int(end - begin)
            if length > LONGEST + 1:
                break
            for first, last in ((begin, end), (begin, end + 1), (begin + 1, end), (begin + 1, end + 1)):
                if last - first < 3 or first < 2 * REACH or last + 2 * REACH > len(moved):
                    continue
                found += _tried(moved, int(first), int(last), tries)
    return found


def _tried(moved: Array, first: int, last: int, tries: float) -> list[Turned]:
    part = moved[first - 2 * REACH : last + 2 * REACH]
    other = part.copy()
    other[2 * REACH : -2 * REACH] = part[2 * REACH : -2 * REACH][::-1]
    before, after = residual(part) ** 2, residual(other) ** 2
    nats = float(_nats(before.sum(), after.sum(), float(before.size), tries))
    return [Turned(first, last, nats)] if nats > 0.0 else []


def _ends(moved: Array) -> Array:
    """Return the rows before which a stretch may begin or end, in order."""
    power = (residual(moved) ** 2).sum(axis=1)
    clear = np.flatnonzero(power > CLEAR * moved.shape[1])
    clear = clear[np.argsort(-power[clear], kind="stable")[: 10 * MOST_ENDS]]
    around = np.clip(clear[:, None] + np.arange(NEARBY) - NEARBY // 2, 0, power.size - 1)
    usual = np.median(power[around], axis=1)
    best = clear[power[clear] > CLEAR * usual][:MOST_ENDS]
    return np.asarray(np.sort(best) + REACH)
