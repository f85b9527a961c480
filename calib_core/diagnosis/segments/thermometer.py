"""What a thermometer measured: a smooth temperature, again, from the staircase that it showed.

A coarse thermometer is known best when its readings change: the temperature is then half-way between two
levels. One that is read seldom, its last reading repeated in each sample, is known best when it was read. The
error of the staircase times a slope would be structure without a name.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths.robust import MAD_TO_SD
from stillcal.calib_core.temperature.thermometer import JUMP_K, jumps

Flags = NDArray[np.bool_]
Index = NDArray[np.int64]

COARSE = 0.15
"""Smallest step, K, that is undone; half of a finer one is nothing beside the span that temperature needs."""

COARSEST = 1.5
"""Largest step, K: thermometers are read to a whole K at least. What jumps by more was set, in a chamber."""

ALIKE = 0.1
"""Part of a step by which steps may differ: values are printed with few digits."""

ONE_STEP = 0.9
"""Least part of the changes that is of one step; a thermometer that is seldom read makes larger ones."""

FLICKER = 0.1
"""Part of a step; a level that was left before more of it could be entered was noise at the boundary."""

QUICKEST = 3.0
"""A level passed in less, s, is noise: no phone warms by `COARSE` so quickly."""

NOISY = 0.05
"""Part of the levels passed that may be noise, or of the time at the wrong side of a boundary.

Beyond, noise of an eighth of a step and more dithers the steps, and means of readings need no help.
"""

SLIP_S = 30.0
"""Longest time, s, that a slip of a thermometer takes; readings that jump and jump back later were set, in a
chamber."""

BRIEF = 0.1
"""Part of the recording that readings before a first jump, or behind a last one, may take to be slips."""

OFTEN = 10
"""Readings at equal times, at least, that show a thermometer that is read seldom."""


@dataclass(frozen=True, slots=True)
class _Crossings:
    """Moments `t` (m,) s when the temperature was `value` (m,) degC, half-way between two levels.

    came, went: (m,) 1 upwards, -1 downwards; they differ where a boundary was only touched. level: (m,) degC,
    the reading that followed.
    """

    t: Array
    value: Array
    came: Array
    went: Array
    level: Array

    def held(self) -> Array:
        """Return the time (m - 1,) s from each to the next."""
        return np.asarray(np.diff(self.t))

    def turned(self) -> Flags:
        """Return whether the level between two (m - 1,) was left the way it was entered."""
        return np.asarray(self.went[:-1] != self.came[1:])


def reconstructed(t: Array, readings: Array) -> Array:
    """Return the temperature (n,) degC behind coarse `readings` (n,) degC at `t` (n,) s, all finite.

    At a change it is half-way between the two levels, and linear in time between changes. At a level that
    was left the way it was entered it goes on as quickly as in the last level that was passed, and comes back
    as quickly as in the next one, but no farther than the middle of the level: all of the level is possible,
    and the middle is never off by more than half of it. So it does before the first and after the last
    change. Readings that are repeated until the next one belong to the moment of the first of them; between
    those it is linear in time. So it is across slips, readings that jump, faster than anything warms, and
    jump back. Other readings, and those that noise dithers, are returned as they are.
    """
    slipped = _slipped(t, readings)
    if slipped.any():
        kept = ~slipped
        return np.interp(t, t[kept], reconstructed(t[kept], readings[kept]))
    step = _step(readings)
    if step is None:
        return _between_held(t, readings)
    changes, span = _changes(t, readings), float(t[-1] - t[0])
    if _dithered(changes):
        return readings
    times, values = _course(_without_flicker(changes, span), step, t, readings)
    found = np.interp(t, times, values)
    wrong = np.abs(found - readings) > (0.5 + ALIKE) * step
    return readings if float(wrong.mean()) > NOISY else np.asarray(found)


def _slipped(t: Array, readings: Array) -> Flags:
    """Return which readings (n,) come between a jump and one back, within SLIP_S.

    Nothing comes back where the recording begins or ends with what is as brief: a chip tells the value it has
    after power-on (85 degC), and maybe another one, until it has measured. What jumps elsewhere as well was
    set, in a chamber.
    """
    out = _returned(t, readings)
    kept = np.flatnonzero(~out)
    jumped = _jumped(t[kept], readings[kept])
    longest = min(SLIP_S, BRIEF * float(t[-1] - t[0]))
    early, late = t[kept[jumped + 1]] - t[0] <= longest, t[-1] - t[kept[jumped]] <= longest
    if (early | late).all():
        out[: kept[jumped[early] + 1].max(initial=0)] = True
        out[kept[jumped[late]].min(initial=t.size) + 1 :] = True
    return out


def _jumped(t: Array, readings: Array) -> Index:
    """Return after which of the readings (n,) the next one jumps."""
    rises = np.diff(readings)
    return np.flatnonzero(jumps(np.diff(t), rises, MAD_TO_SD * float(np.median(np.abs(rises)))))


def _returned(t: Array, readings: Array) -> Flags:
    """Return which readings (n,) come between a jump and one back, within SLIP_S."""
    out = np.zeros(t.size, dtype=np.bool_)
    before = _jumped(t, readings)
    for k, first in enumerate(before):
        if out[first]:
            continue
        for last in before[k + 1 :]:
            if t[last + 1] - t[first] > SLIP_S:
                break
            if abs(readings[last + 1] - readings[first]) <= JUMP_K:
                out[first + 1 : last + 1] = True
                break
    return out


def _between_held(t: Array, readings: Array) -> Array:
    """Return the temperature (n,) between readings that are repeated for equal times; else the readings.

    What jumps by more than `COARSEST` each time was set, in a chamber.
    """
    first = np.flatnonzero(np.diff(readings, prepend=np.nan) != 0.0)
    if first.size < OFTEN:
        return readings
    held = np.diff(t[first])
    usual = float(np.median(held))
    large = float(np.median(np.abs(np.diff(readings[first])))) > COARSEST
    if usual < QUICKEST or large:
        return readings
    even = np.abs(held / usual - np.rint(held / usual)) < ALIKE
    if float(even.mean()) < ONE_STEP:
        return readings
    # Readings that were alike were read, too: the last of them one usual time before another one.
    last = np.maximum(t[first[1:]] - usual, t[first[:-1]])
    times = np.stack([t[first], np.append(last, t[-1])], axis=1)
    return np.interp(t, times.ravel(), np.repeat(readings[first], 2))


def _step(readings: Array) -> float | None:
    """Return the step, K, of the grid of coarse `readings`; None for none, a fine one, or jumps."""
    jumps = np.abs(np.diff(readings))
    jumps = jumps[jumps > 0.0]
    if jumps.size == 0:
        return None
    usual = float(np.median(jumps))
    if not COARSE <= usual <= COARSEST or float(np.mean(np.abs(jumps - usual) < ALIKE * usual)) < ONE_STEP:
        return None
    above = readings - readings.min()
    step = float(above.max() / max(1.0, np.rint(above.max() / usual)))
    off = np.abs(above / step - np.rint(above / step))
    return step if float(off.max()) < ALIKE else None


def _changes(t: Array, readings: Array) -> _Crossings:
    at = np.flatnonzero(np.diff(readings))
    old, new = readings[at], readings[at + 1]
    way = np.sign(new - old)
    return _Crossings((t[at] + t[at + 1]) / 2.0, (old + new) / 2.0, way, way, new)


def _dithered(changes: _Crossings) -> bool:
    """Return whether levels are passed more quickly than a phone warms, or none is and there is flicker."""
    brief, through = changes.held() < QUICKEST, ~changes.turned()
    if not through.any():
        return bool(brief.any())
    return bool((brief & through).sum() > NOISY * through.sum())


def _paces(crossings: _Crossings, span: float) -> tuple[Array, Array]:
    """Return how long, s, the nearest level that was passed took before and after each crossing (m,), (m,).

    Where there is none on one side the other counts; where none was passed, the longest level or else `span`.
    """
    held = crossings.held()
    known = np.flatnonzero(~crossings.turned() & (held >= QUICKEST))
    if known.size == 0:
        longest = np.full(crossings.t.size, held.max(initial=0.0) or span)
        return longest, longest
    following = np.searchsorted(known, np.arange(crossings.t.size))
    before = held[known[np.maximum(following - 1, 0)]]
    return before, held[known[np.minimum(following, known.size - 1)]]


def _without_flicker(changes: _Crossings, span: float) -> _Crossings:
    """Return the changes; those between which nothing could happen are one, at their mean time."""
    before, after = _paces(changes, span)
    flicker = changes.turned() & (changes.held() < FLICKER * (before[:-1] + after[1:]))
    first = np.flatnonzero(np.concatenate([[True], ~flicker]))
    last = np.append(first[1:], changes.t.size) - 1
    count = last - first + 1
    return _Crossings(
        np.add.reduceat(changes.t, first) / count,
        np.add.reduceat(changes.value, first) / count,
        changes.came[first],
        changes.went[last],
        changes.level[last],
    )


def _course(c: _Crossings, step: float, t: Array, readings: Array) -> tuple[Array, Array]:
    """Return times (k,) s, ascending, and the temperature (k,) degC at them, linear between."""
    before, after = _paces(c, float(t[-1] - t[0]))
    turned = np.flatnonzero(c.turned())
    pace_in, pace_out = before[turned], after[turned + 1]
    part = np.minimum(0.5, c.held()[turned] / (pace_in + pace_out))
    peak = c.level[turned] + c.went[turned] * (part - 0.5) * step
    first = min(0.5, float((c.t[0] - t[0]) / after[0]))
    last = min(0.5, float((t[-1] - c.t[-1]) / before[-1]))
    ends_t = [c.t[0] - first * after[0], c.t[-1] + last * before[-1]]
    ends = [
        readings[0] + c.came[0] * (0.5 - first) * step,
        c.level[-1] + c.went[-1] * (last - 0.5) * step,
    ]
    times = np.concatenate([c.t, c.t[turned] + part * pace_in, c.t[turned + 1] - part * pace_out, ends_t])
    values = np.concatenate([c.value, peak, peak, ends])
    order = np.argsort(times, kind="stable")
    return times[order], values[order]
