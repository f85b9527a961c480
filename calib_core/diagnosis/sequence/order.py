"""Samples in the wrong order: two exchanged, stretches that run backwards, or two stretches exchanged.

Put back, they follow their neighbours again on all axes. An order that is right has no reason to look
better in another: the power that neighbours leave about such a place has six independent numbers and more,
and it takes all of them to fall together by chance. At rest every order is alike, so motion tells.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding, sized
from stillcal.calib_core.diagnosis.model.records import NAME, Finding, Where
from stillcal.calib_core.diagnosis.sequence.neighbours import LEAST_SPREAD, REACH, WEIGHTS, residual, spread
from stillcal.calib_core.streams.samples import Samples

DRIVER = "order of the samples"
EXCHANGED = 6
"""Residuals that an exchange of two samples changes on one axis."""

ACROSS = len(WEIGHTS) - 1
"""Residuals on one axis that span the border between two samples."""

LONGEST = 64
"""Samples of a place in the wrong order, at most: what FIFOs of phones hold at once."""

NEXT = 6
"""Ends after a first one among which the next one is looked for, where two stretches are exchanged."""

CLEAR = 30.0
"""Times the power of noise, and of the residuals about it, that the ends of a stretch stand out by."""

NEARBY = 33
"""Residuals, on either side together, that an end is held against."""

MOST_ENDS = 400
"""Ends that are tried, the clearest, and ten times as many that may be."""


Rows = NDArray[np.int64]

Place = tuple[int, int, int]
"""First row, rows, and how many of these are the first of two exchanged stretches; 0: they run backwards."""


@dataclass(frozen=True, slots=True)
class Misplaced:
    """Rows `first` to `last` (not included), which follow their neighbours in another order; nats for it.

    stretches: how many of one length they are, each in the wrong order.
    """

    first: int
    last: int
    nats: float
    stretches: int = 1


def wrong_order(samples: Samples, sensor: str) -> Finding | None:
    """Find samples of one sensor that follow their neighbours only in another order."""
    if len(samples) < 2 * NEARBY:
        return None
    found = misplaced(samples.xyz)
    if not found:
        return None
    t, count = samples.t, float(sum(one.last - one.first for one in found))
    places = sum(one.stretches for one in found)
    longest = max((one.last - one.first) // one.stretches for one in found)
    where = Where(float(t[found[0].first]), float(t[found[-1].last - 1]), (0.0, 0.0), DRIVER)
    say = (
        f"Samples of the {NAME[sensor]} are in the wrong order at {places} places of motion, up to"
        f" {longest} at a time: put back, they follow their neighbours."
    )
    sizes = sized({"places": (float(places), "1"), "samples": (count, "1"), "longest": (float(longest), "1")})
    seen = DirectEvidence(sum(one.nats for one in found))
    return direct_finding("unknown", sensor, [0, 1, 2], where, sizes, statement=say, seen=seen)


def misplaced(xyz: Array) -> list[Misplaced]:
    """Return the places of values (n, 3) that are better in another order; each is worth its tries."""
    moved = xyz / _unit(residual(xyz))
    ends = _ends(moved)
    tries = 2.0 * len(moved) * LONGEST
    turned = _better(moved, _backwards(ends), tries)
    crossed = _better(moved, _exchanged_stretches(ends), tries * LONGEST)
    batches = _batches(moved, ends, tries * LONGEST)
    every = sorted([*_exchanged(moved), *turned, *crossed, *batches], key=lambda one: -one.nats)
    taken = np.zeros(len(xyz), dtype=np.bool_)
    kept = []
    for one in every:
        rows = slice(max(one.first - REACH, 0), one.last + REACH)
        if not taken[rows].any():
            taken[rows] = True
            kept.append(one)
    return sorted(kept, key=lambda one: one.first)


def _unit(left: Array) -> Array:
    """Return the spread (k,) of residuals (n, k), of those that are not nothing.

    Where values are the same for long, the others tell the steps of the code, which are noise here.
    """
    moving = [axis[np.abs(axis) > LEAST_SPREAD] for axis in left.T]
    return np.array([spread(axis[:, None])[0] if axis.size else LEAST_SPREAD for axis in moving])


def _nats(before: Array, after: Array, axes: int, changed: int | Array, tries: float) -> Array:
    """Return nats for an order by the power before and after of the residuals that it changes.

    changed: how many, on each axis. All axes count as one: what moves a phone may go along one line.
    """
    noise = axes * changed
    ratio = (before + noise) / (np.maximum(after, 0.0) + noise)
    return np.asarray(0.5 * changed * np.log(ratio) - np.log(tries))


def _exchanged(moved: Array) -> list[Misplaced]:
    """Return all pairs of neighbours that are better exchanged; moved: (n, 3) in units of noise."""
    left = residual(moved)
    n = len(left) - EXCHANGED + 1
    if n < 1:
        return []
    # Row 4 + i and the one after are exchanged: residuals that know either change by `change` times the step.
    change = residual(np.array([0, 0, 0, 0, 1, -1, 0, 0, 0, 0], dtype=np.float64)[:, None])[:, 0]
    step = np.diff(moved, axis=0)[2 * REACH : 2 * REACH + n]
    power = (left**2).sum(axis=1)
    before = np.asarray(sum(power[i : i + n] for i in range(EXCHANGED)))
    changed = np.asarray(sum(left[i : i + n] * c for i, c in enumerate(change)))
    along = (step * changed).sum(axis=1)
    after = before + 2.0 * along + (step**2).sum(axis=1) * float(change @ change)
    nats = _nats(before, after, moved.shape[1], EXCHANGED, 2.0 * len(moved))
    return [Misplaced(int(i) + 4, int(i) + 6, float(nats[i])) for i in np.flatnonzero(nats > 0.0)]


def _backwards(ends: Array) -> Iterator[Place]:
    """Propose stretches of three samples and more that may run backwards.

    They begin and end where residuals stand out of those nearby: within, a smooth motion is as smooth turned.
    """
    for i, begin in enumerate(ends):
        for end in ends[i + 1 :]:
            if end - begin > LONGEST + 1:
                break
            for first, last in product((begin, begin + 1), (end, end + 1)):
                if last - first >= 3:
                    yield int(first), int(last - first), 0


def _batches(moved: Array, ends: Array, tries: float) -> list[Misplaced]:
    """Return batches of one length, one after the other, that all run backwards: a FIFO read newest first.

    One that is put back alone still misses those beside it. However many they are, the residuals count as
    those about one batch: noise has no more reason to fall with many.
    """
    found, borders = [], np.unique(np.concatenate([ends, ends + 1]))
    power = (residual(moved) ** 2).sum(axis=1)
    for length in range(3, LONGEST + 1):
        changed = len(_across([0, length]))
        for first, count in _runs(borders, length):
            rows = slice(first - 2 * REACH, first + count * length + 2 * REACH)
            if count < 2 or rows.start < 0 or rows.stop > len(moved):
                continue
            part = moved[rows]
            batches = part[2 * REACH : -2 * REACH].reshape(count, length, -1)
            other = part.copy()
            other[2 * REACH : -2 * REACH] = batches[:, ::-1].reshape(count * length, -1)
            across = _across([k * length for k in range(count + 1)])
            before = changed * power[rows.start + across].mean()
            after = changed * (residual(other)[across] ** 2).sum(axis=1).mean()
            nats = float(_nats(before, after, moved.shape[1], changed, tries))
            if nats > 0.0:
                found.append(Misplaced(first, first + count * length, nats, count))
    return found


def _runs(borders: Array, length: int) -> Iterator[tuple[int, int]]:
    """Return first rows and counts of batches of a length between successive borders."""
    within = set(borders.tolist())
    for first in sorted(within):
        if first - length not in within:
            last = first
            while last + length in within:
                last += length
            yield first, (last - first) // length


def _exchanged_stretches(ends: Array) -> Iterator[Place]:
    """Propose places where a stretch follows the one after it, as halves of a buffer that are read crosswise.

    All three ends of two such stretches stand out.
    """
    borders = np.unique(np.concatenate([ends, ends + 1]))
    for i, first in enumerate(borders):
        for j in range(i + 1, min(i + 1 + NEXT, borders.size)):
            for last in borders[j + 1 : j + 1 + NEXT]:
                if 3 <= last - first <= LONGEST:
                    yield int(first), int(last - first), int(borders[j] - first)


def _better(moved: Array, places: Iterable[Place], tries: float) -> list[Misplaced]:
    """Return the places whose samples are better put back; tries: how many places may be proposed."""
    rows = np.array(list(places), dtype=np.int64).reshape(-1, 3)
    rows = rows[(rows[:, 0] >= 2 * REACH) & (rows[:, 0] <= len(moved) - rows[:, 1] - 2 * REACH)]
    nats = _tried(moved, rows, tries)
    return [
        Misplaced(int(i), int(i + n), float(x)) for (i, n, _), x in zip(rows, nats, strict=True) if x > 0.0
    ]


def _tried(moved: Array, places: Rows, tries: float) -> Array:
    """Return nats (m,) for places (m, 3) on being put back, all of them at once.

    Power is compared where residuals span an end of a stretch.
    """
    first, length, half = places.T

    def put_back(row: Rows) -> Array:
        before = row - 2 * REACH
        values = [w * moved[first + _source(before + i, length, half)] for i, w in enumerate(WEIGHTS)]
        return np.asarray((np.sum(values, axis=0) ** 2).sum(axis=1))

    power, start = (residual(moved) ** 2).sum(axis=1), np.zeros_like(first)
    before, changed = _summed([start, half, length], lambda row: power[first + row - 2 * REACH])
    after, _ = _summed([start, length - half, length], put_back)
    return _nats(before, after, moved.shape[1], changed, tries)


def _source(row: Rows, length: Rows, half: Rows) -> Rows:
    """Return where the sample is that belongs in a row, both counted from the first of its place."""
    within = np.where(half > 0, (row + half) % length, length - 1 - row)
    return np.where((row >= 0) & (row < length), within, row)


def _summed(ends: Sequence[Rows], power_of: Callable[[Rows], Array]) -> tuple[Array, Array]:
    """Return the power (m,) of the residuals that span one of the ends (m,) of stretches, and their number.

    power_of: the power (m,) of one residual of each place.
    """
    rows = np.sort(np.concatenate([np.add.outer(end, np.arange(ACROSS)) for end in ends], axis=1), axis=1)
    once = np.diff(rows, axis=1, prepend=-1) > 0  # some span two ends
    power = [own * power_of(row) for own, row in zip(once.T, rows.T, strict=True)]
    return np.sum(power, axis=0), once.sum(axis=1)


def _across(ends: list[int]) -> NDArray[np.int64]:
    """Return which residuals of a part span one of these ends of stretches."""
    return np.unique(np.add.outer(np.array(ends), np.arange(ACROSS)))


def _ends(moved: Array) -> Array:
    """Return the rows before which a stretch may begin or end, in order."""
    power = (residual(moved) ** 2).sum(axis=1)
    clear = np.flatnonzero(power > CLEAR * moved.shape[1])
    clear = clear[np.argsort(-power[clear], kind="stable")[: 10 * MOST_ENDS]]
    around = np.clip(clear[:, None] + np.arange(NEARBY) - NEARBY // 2, 0, power.size - 1)
    usual = np.median(power[around], axis=1)
    best = clear[power[clear] > CLEAR * usual][:MOST_ENDS]
    return np.asarray(np.sort(best) + REACH)
