"""Values that drop to one and the same number for some samples and come back, as where a read failed.

A knock leaves its neighbours too, but each ends elsewhere: whatever its law, what is farther off is rarer, so
that of all steps between the least jump and its own each is as likely at least.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.direct.stuck import LEAST_S
from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    Index,
    direct_finding,
    share_of,
    sized,
)
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Where
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT, comb_step
from stillcal.calib_core.diagnosis.sequence.neighbours import residual, spread
from stillcal.calib_core.streams.samples import Samples

Flags = NDArray[np.bool_]

DROPS = "single values"
"""Driver of what single values do, whatever the motion."""

FAR = 8.0
"""Spreads of residuals by which a value must leave those before and after it, to the same side."""

NEAR = 10.0
"""Steps to either side of a value within which motion ends its jumps about as often: where a shaken axis
turns back, it is near one value time and again."""

ROUNDING = 1e-6
"""Part of the largest value by which two differ that are one, but for rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Dropped:
    """The drops of one axis. rows: (k,) samples; value: theirs; times: drops; nats: for them."""

    rows: Index
    value: float
    times: int
    nats: float

    @classmethod
    def of(cls, samples: Samples, axis: int) -> Dropped | None:
        """Find the value that most jumps there and back end at; None where there are no two."""
        x = samples.xyz[:, axis]
        edges = np.concatenate([[0], np.flatnonzero(np.diff(x) != 0.0) + 1, [x.size]])
        level, first, last = x[edges[:-1]], edges[:-1], edges[1:]
        if level.size < 3:
            return None
        step = _step(x)
        least = FAR * max(_noise(x), step)
        to, back = level[1:-1] - level[:-2], level[1:-1] - level[2:]
        size = np.minimum(np.abs(to), np.abs(back))
        brief = samples.t[last[1:-1] - 1] - samples.t[first[1:-1]] < LEAST_S
        jump = np.flatnonzero((to * back > 0.0) & (size > least) & brief & _inside(level[1:-1], x))
        if jump.size < 2:
            return None
        value, which = np.unique(level[jump + 1], return_inverse=True)
        nats = _nats(np.log1p((size[jump] - least) / step), which.ravel(), value.size)
        nats = np.minimum(nats, _beside_neighbours(value, np.bincount(which.ravel()), NEAR * step))
        best = int(np.argmax(nats))
        runs = jump[which.ravel() == best] + 1
        rows = np.concatenate([np.arange(first[r], last[r]) for r in runs])
        return cls(rows, float(value[best]), int(runs.size), float(nats[best]))


def _step(x: Array) -> float:
    """Return the step of values (n,), or the least difference of two where they come in no even steps."""
    rounding = ROUNDING * float(np.abs(x).max())
    gaps = np.diff(np.unique(x))
    return comb_step(x) or float(gaps[gaps > rounding].min(initial=np.inf))


def _noise(x: Array) -> float:
    """Return the spread of values (n,) about their neighbours; by its mean where most residuals are 0."""
    left = residual(x[:, None])
    return max(float(spread(left)[0]), float(np.sqrt(np.pi / 2.0) * np.abs(left).mean()))


def _inside(level: Array, x: Array) -> Flags:
    """Return which values are no end of the axis' range, where motion takes it; a range ends not at 0."""
    return np.asarray((level == 0.0) | ((level > x.min()) & (level < x.max())))


def _nats(told: Array, which: Index, count: int) -> Array:
    """Return nats (count,) for every value that jumps end at. told: (n,) of each jump; which: (n,) value.

    The first jump to a value says nothing, for it ends somewhere; any so many of the jumps may be drops.
    """
    from scipy.special import gammaln  # noqa: PLC0415 - the daemon stays light

    most = np.zeros(count)
    np.maximum.at(most, which, told)
    n, k = float(told.size), np.bincount(which, minlength=count)
    ways = gammaln(n + 1.0) - gammaln(k + 1.0) - gammaln(n - k + 1.0)
    return np.asarray(np.bincount(which, told, count) - most - ways)


def _beside_neighbours(value: Array, count: Index, near: float) -> Array:
    """Return the nats of counts (v,) of jumps to each value, against the most to another one that is near.

    Any of the values may be the one that most jumps end at.
    """
    first = np.searchsorted(value, value - near, side="left")
    last = np.searchsorted(value, value + near, side="right")
    own = np.arange(len(value))
    others = np.maximum(_highest(count, first, own), _highest(count, own + 1, last))
    usual = np.maximum(others, 1.0 / (2.0 * NEAR))
    nats = count * np.log(np.maximum(count / usual, 1.0)) - np.maximum(count - usual, 0.0)
    return np.asarray(nats - np.log(len(value)))


def _highest(count: Index, first: Index, last: Index) -> Index:
    """Return the largest of counts (v,) from each `first` to before each `last`, 0 where there are none."""
    ends = np.column_stack([first, last]).ravel()
    largest = np.maximum.reduceat(np.append(count, 0), ends)[::2]
    return np.asarray(np.where(first < last, largest, 0))


def dropouts(samples: Samples, sensor: str) -> tuple[Finding | None, Flags]:
    """Find values that drop to one number; also returned is which ones (n, 3) do."""
    found = {a: d for a in range(3) if (d := Dropped.of(samples, a)) is not None and d.nats > 0.0}
    flags = np.zeros(samples.xyz.shape, dtype=np.bool_)
    if not found:
        return None, flags
    worst = max(found.values(), key=lambda d: d.nats)
    rows = np.unique(np.concatenate([d.rows for d in found.values()]))
    n = float(len(samples))
    share = share_of(float(rows.size), n, max(worst.rows.size / worst.times, 1.0))
    named = ", ".join(AXES[a] for a in found)
    say = (
        f"The {NAME[sensor]}'s {named} drops to {worst.value:.4g} {UNIT[sensor]} and comes back,"
        f" {worst.times} times: a value that was not read."
    )
    where = Where(float(samples.t[rows[0]]), float(samples.t[rows[-1]]), (0.0, 0.0), DROPS)
    sizes = {"fraction": share.parameter("1"), **sized({"value": (worst.value, UNIT[sensor])})}
    # Any of the seven sets of axes may drop.
    seen = DirectEvidence(sum(d.nats for d in found.values()) - float(np.log(7.0)))
    finding = direct_finding("unknown", sensor, list(found), where, sizes, statement=say, seen=seen)
    if finding is not None:
        for axis, dropped in found.items():
            flags[dropped.rows, axis] = True
    return finding, flags
