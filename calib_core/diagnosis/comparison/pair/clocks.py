"""Another sensor's clock against a recording's, roughly: from how much both change at what moment.

The size of what changes is alike in any axes. It is correlated block by block at every lag, and the straight
line of lags that the blocks together speak for most is the clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Samples

MOST_LATE = 30.0
"""s by which the stamps may be off: of two loggers that were started by hand one after the other."""

FASTEST = 0.02
"""Part by which a clock may run fast or slow: of stamps counted by a MEMS sensor's own oscillator."""

SLOW = 8.0
"""s of the moving mean that is taken off: what is slower is bias and gravity as much as motion."""

STEP = 0.1
"""s from one lag to the next."""

BLOCK = 30.0
"""s of a block: a clock that runs off by `FASTEST` does so by 0.6 s in it, by 200 ppm by 6 ms."""

BLOCKS = 64
"""Blocks that are enough: of longer recordings the liveliest of every part is taken."""

PERFECT = 0.999
"""Correlation from where on more is no more evidence."""


@dataclass(frozen=True, slots=True)
class Clock:
    """What another clock says: at the recording's t it is t + delay + rate (t - middle), s.

    half: s, half of the time in which it was compared.
    """

    middle: float
    half: float
    delay: float = 0.0
    rate: float = 0.0

    def at(self, t: Array) -> Array:
        """Return what it says at the recording's t (n,), s."""
        return t + self.delay + self.rate * (t - self.middle)

    def back(self, t: Array) -> Array:
        """Return the recording's time (n,), s, where it says t (n,), s."""
        return self.middle + (t - self.middle - self.delay) / (1.0 + self.rate)

    def moved(self, delay: float, drift: float) -> Clock:
        """Return a clock that is later by `delay` in the middle and by `drift` more at the end, s."""
        return replace(self, delay=self.delay + delay, rate=self.rate + drift / max(self.half, 1e-9))


def liveliness(means: Samples) -> tuple[Array, Array]:
    """Return moments (n,), s, `STEP` apart, and how much readings at even stamps change then, (n,)."""
    t, period = means.t, float(means.t[1] - means.t[0])
    width = min(max(round(SLOW / period), 1), len(means))
    total = np.concatenate([np.zeros((1, 3)), means.xyz.cumsum(axis=0)])
    i = np.arange(len(means))
    low, high = np.maximum(i - width // 2, 0), np.minimum(i + width // 2 + 1, len(means))
    slow = (total[high] - total[low]) / (high - low)[:, None]
    size = np.linalg.norm(means.xyz - slow, axis=1)
    at = np.arange(np.ceil(t[0] / STEP), np.floor(t[-1] / STEP) + 1.0) * STEP
    return at, np.interp(at, t, size)


def roughly(sides: Sequence[tuple[Samples, Samples]]) -> Clock:
    """Return the other sensor's clock to about `STEP`.

    sides: of each kind of sensor the recording's readings and the other's, at even stamps.
    """
    t = sides[0][0].t
    most = round(MOST_LATE / STEP)
    starts, evidence = _evidence(sides, most)
    middle, size = 0.5 * float(t[0] + t[-1]), BLOCK if len(starts) > 1 else 0.0
    about = starts + 0.5 * size - middle if len(starts) > 1 else np.zeros(len(starts))
    half = 0.5 * float(t[-1] - t[0])
    if not len(starts):
        return Clock(middle, half)
    reach = float(np.abs(about).max())
    drifts = min(round(FASTEST * reach / STEP), most)
    rates = np.arange(-drifts, drifts + 1) * STEP / max(reach, STEP)
    lags = np.arange(-most, most + 1)
    best, found = -np.inf, (0.0, 0.0)
    for rate in rates[np.argsort(np.abs(rates))]:
        at = np.rint(rate * about / STEP).astype(np.int64)[:, None] + lags
        inside = np.abs(at) <= most
        total = np.where(inside, np.take_along_axis(evidence, np.clip(at + most, 0, 2 * most), 1), 0.0).sum(0)
        if total.max() > best:
            best, found = float(total.max()), (float(lags[total.argmax()]) * STEP, float(rate))
    return Clock(middle, half, *found)


def _evidence(sides: Sequence[tuple[Samples, Samples]], most: int) -> tuple[Array, Array]:
    """Return when blocks start (b,), s, and what speaks for every lag in each, (b, 2 most + 1)."""
    starts: Array = np.empty(0)
    total: Array = np.empty((0, 2 * most + 1))
    for own, other in sides:
        t, size = liveliness(own)
        known, course = liveliness(other)
        n = min(round(BLOCK / STEP), size.size)
        if not starts.size:
            first = _liveliest(size, n)
            starts, total = t[first], np.zeros((first.size, 2 * most + 1))
        for k, start in enumerate(starts):
            i = round((start - t[0]) / STEP)
            wanted = start + STEP * np.arange(-most, n + most)
            there = np.interp(wanted, known, course, left=0.0, right=0.0)
            total[k] += _for_lags(size[max(i, 0) : max(i, 0) + n], there, most)
    return starts, total


def _liveliest(size: Array, n: int) -> Array:
    """Return where the liveliest block of n of every part begins, `BLOCKS` at most."""
    first = np.arange(0, size.size - n + 1, n)
    power = np.array([float(np.var(size[i : i + n])) for i in first])
    parts = np.array_split(np.arange(first.size), min(BLOCKS, first.size))
    return np.array([first[p[power[p].argmax()]] for p in parts], dtype=np.int64)


def _for_lags(own: Array, other: Array, most: int) -> Array:
    """Return what speaks for each lag, (2 most + 1,): of a correlation r it is -log(1 - r^2)."""
    n = own.size
    if n < 2 or other.size != n + 2 * most:
        return np.zeros(2 * most + 1)
    away = own - own.mean()
    total, power = (np.concatenate([[0.0], np.cumsum(x)]) for x in (other, other**2))
    varied = power[n:] - power[:-n] - (total[n:] - total[:-n]) ** 2 / n
    alike = sliding_window_view(other, n) @ away
    scale = np.sqrt(np.maximum(varied, 0.0) * float(away @ away))
    r = np.divide(
        alike, scale, out=np.zeros_like(alike), where=scale > 1e-9 * max(float(scale.max()), 1e-300)
    )
    return np.asarray(-np.log1p(-(np.clip(r, 0.0, PERFECT) ** 2)))
