"""Values that come again: a stretch delivered once more, or some axes of a sample read before they are new.

A sample that all axes repeat at once is held (`direct.repeated_values`), and is not counted here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.direct.repeated_values import NEAR, at_limits, repeating
from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    Index,
    direct_finding,
    of_counts,
    share_of,
    sized,
)
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Where
from stillcal.calib_core.diagnosis.segments.value_grid import least_change
from stillcal.calib_core.diagnosis.sequence.neighbours import REACH, WEIGHTS, residual, spread
from stillcal.calib_core.streams.samples import Samples

Flags = NDArray[np.bool_]

AGAIN, STALE = "values delivered before", "axes read before they are new"
SHORTEST = 3
"""Samples in a row, at least, that are delivered once more."""

MOST = 0.3
"""Part of the samples that may be: a motion that repeats itself without noise, in a simulation, is none."""

FORETOLD = 0.5
"""Part of the rows at most that are alike where those before were, as neighbours foretell them: of 1131
stretches of three rows, in noise of four codes that passes a twentieth of the rate, 51 went on."""

LAGS = (2, 3, 5, 8, 13)
"""Samples later at which two at rest are compared to learn how often values are alike by chance."""

CORRELATED = 3.0
"""Times oftener than that that values may be alike where the one before was, at least."""

SURE = 8.0
"""Spreads of residuals by which a sample must have left the value of the one before."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """`length` rows from `first` on that equal those from `origin` on, earlier."""

    origin: int
    first: int
    length: int


def delivered_again(samples: Samples, sensor: str, still: Flags) -> Finding | None:
    """Find stretches of one sensor's samples that are an earlier stretch, value by value.

    still: (n,) whether the phone lay still, which tells how often values are alike by chance.
    """
    xyz = samples.xyz
    alike = by_chance(xyz, still)
    if alike >= 1.0:
        return None
    tries = 0.5 * float(len(xyz)) ** 2
    worth = [(s, -s.length * float(np.log(alike)) - float(np.log(tries))) for s in repeated(xyz)]
    worth = [(s, nats) for s, nats in worth if nats > 0.0]
    t, rows = samples.t, sum(s.length for s, _ in worth)
    if not worth or rows > MOST * len(xyz):
        return None
    where = Where(
        float(t[worth[0][0].first]), float(t[worth[-1][0].first + worth[-1][0].length - 1]), (0.0, 0.0), AGAIN
    )
    longest = max(s.length for s, _ in worth)
    say = (
        f"{len(worth)} stretches of the {NAME[sensor]}'s samples, {rows} in all and up to {longest} in a row,"
        " repeat earlier ones value by value: they were delivered again."
    )
    sizes = sized(
        {
            "stretches": (float(len(worth)), "1"),
            "samples": (float(rows), "1"),
            "longest": (float(longest), "1"),
        }
    )
    seen = DirectEvidence(sum(nats for _, nats in worth))
    return direct_finding("unknown", sensor, [0, 1, 2], where, sizes, statement=say, seen=seen)


def by_chance(xyz: Array, still: Flags) -> float:
    """Return how often a row of rows (n, 3) equals an earlier one where the row before did; 1 at most.

    It is so many times the share of rows that equal one some samples earlier, at rest or in motion, whichever
    is oftener: a range that is switched has coarser steps in motion. Where noise is low-passed, neighbours
    foretell a value, and of those that they leave open so many more are alike.
    """
    least = 1.0 / max(len(xyz), 1)
    code = _hashed(xyz)
    usual = [_usual_share(code, rows) for rows in (still, ~still)]
    share = max([least, *(share for share in usual if share is not None)])
    return min(max(CORRELATED * share, min(_foretold(xyz, still) * share, FORETOLD)), 1.0)


def _foretold(xyz: Array, still: Flags) -> float:
    """Return how much closer neighbours foretell values (n, 3) at rest than a sample further off does.

    It is the ratio of both spreads, that of white noise being 1, of all axes together.
    """
    far = LAGS[-1]
    rest = still[far:] & still[:-far]
    if rest.sum() < SHORTEST:
        return 1.0
    apart = spread((xyz[far:] - xyz[:-far])[rest]) / np.sqrt(2.0)
    within = still[REACH:-REACH] & still[: -2 * REACH] & still[2 * REACH :]
    left = spread(residual(xyz)[within]) / np.linalg.norm(WEIGHTS) if within.any() else apart
    return float(np.prod(np.maximum(apart / left, 1.0)))


def _usual_share(code: NDArray[np.uint64], among: Flags) -> float | None:
    """Return the part of some rows that equals one a few samples earlier, the median of `LAGS`.

    code: (n,), of rows as `_hashed` has them.
    """
    shares = [
        float((code[k:] == code[:-k])[both].mean()) for k in LAGS if (both := among[k:] & among[:-k]).any()
    ]
    return float(np.median(shares)) if shares else None


def repeated(xyz: Array) -> list[Stretch]:
    """Return the stretches of `SHORTEST` rows and more that occurred exactly once before, in order.

    Rows that repeat the one before are held and count for nothing.
    """
    rows = np.flatnonzero(~repeating(xyz))
    if rows.size <= SHORTEST:
        return []
    code = _hashed(xyz[rows])
    n = rows.size - SHORTEST + 1
    mixed = np.zeros(n, dtype=np.uint64)
    for i in range(SHORTEST):
        mixed = mixed * np.uint64(6364136223846793005) + code[i : i + n]
    order = np.argsort(mixed, kind="stable")
    same = mixed[order][1:] == mixed[order][:-1]
    twice = same & ~np.concatenate([[False], same[:-1]]) & ~np.concatenate([same[1:], [False]])
    origin, again = order[:-1][twice], order[1:][twice]
    by_place = np.argsort(again, kind="stable")
    return _runs(rows, origin[by_place], again[by_place])


def _hashed(xyz: Array) -> NDArray[np.uint64]:
    """Return a number (n,) for each row (n, 3): equal rows have equal ones."""
    bits = np.ascontiguousarray(xyz + 0.0).view(np.uint64)
    mixed = bits * np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)
    mixed ^= mixed >> np.uint64(29)
    return np.asarray((mixed * np.uint64(0xBF58476D1CE4E5B9)).sum(axis=1, dtype=np.uint64))


def _runs(rows: Index, origin: Index, again: Index) -> list[Stretch]:
    """Join stretches (m,) of `SHORTEST` fresh rows that follow each other, by where they are and were."""
    if not again.size:
        return []
    joined = (np.diff(again) == 1) & (np.diff(origin) == 1)
    starts = np.flatnonzero(np.concatenate([[True], ~joined]))
    counts = np.diff(np.append(starts, again.size))
    return [
        Stretch(int(rows[origin[k]]), int(rows[again[k]]), int(c) + SHORTEST - 1)
        for k, c in zip(starts, counts, strict=True)
        if again[k] >= origin[k] + SHORTEST
    ]


def stale_axes(samples: Samples, sensor: str, dropped: Flags) -> Finding | None:
    """Find axes that keep their value in single samples of motion that must have changed it.

    How many stay by chance is told by those that change by one or two steps: motion makes as many of each.
    dropped: (n, 3) values that are none of the sensor's and keep to themselves.
    """
    free = ~(at_limits(samples.xyz) | dropped[1:] | dropped[:-1])
    found = {a: stays(samples.xyz, a, free[:, a]) for a in range(3)}
    nats = {a: of_counts(rows.size, of, chance) for a, (rows, of, chance) in found.items() if of > 0.0}
    axes = [a for a in nats if nats[a] > 0.0 and found[a][0].size > found[a][1] * found[a][2]]
    if not axes:
        return None
    worst = max(axes, key=lambda a: found[a][0].size)
    rows, of, _ = found[worst]
    hits = float(rows.size)
    named = ", ".join(AXES[a] for a in axes)
    say = (
        f"In {hits:.0f} of {of:.0f} samples of motion the {NAME[sensor]}'s {named} has the value of the"
        " sample before, while other axes moved on: it was read before it was new."
    )
    where = Where(float(samples.t[rows[0]]), float(samples.t[rows[-1]]), (0.0, 0.0), STALE)
    sizes = {"fraction": share_of(hits, of).parameter("1")}
    # Any of the seven sets of axes may be late.
    seen = DirectEvidence(sum(nats[a] for a in axes) - float(np.log(7.0)))
    return direct_finding("unknown", sensor, axes, where, sizes, statement=say, seen=seen)


def stays(xyz: Array, axis: int, free: Flags) -> tuple[Index, float, float]:
    """Return the rows in which an axis alone keeps its value, of how many that must not, and its chance.

    They must not where the four neighbours of a sample are sure to have it elsewhere than the sample before,
    and the axis moves before and after it: where a motion begins, the last sample of the rest is not late.
    free: (n - 1,) whether the two are not at the end of the axis' range, where motion keeps them.
    """
    left = residual(xyz[:, [axis]])[:, 0]
    changes = np.diff(xyz, axis=0)
    step = least_change(xyz[:, axis])
    unit = max(float(spread(left[:, None])[0]), step)
    moves = np.abs(changes[:, axis]) > SURE * unit
    inner = slice(REACH - 1, -REACH)
    change, amid = changes[inner], moves[:-2] & moves[2:]
    alone = (change != 0.0).any(axis=1) & free[inner] & amid[REACH - 2 : 1 - REACH]
    due = np.flatnonzero(alone & (np.abs(change[:, axis] - left) > SURE * unit))
    moved = np.abs(change[due, axis])
    near = float(((moved > 0.0) & (moved < NEAR * step)).sum())
    return due[moved == 0.0] + REACH, float(moved.size), min((near + 1.0) / 4.0 / max(moved.size, 1), 0.5)
