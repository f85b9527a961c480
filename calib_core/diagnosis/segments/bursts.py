"""Stamps in bursts, which say when samples were delivered: when these were measured, and which are lost."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.sample_period import HEELS, intervals, sample_period
from stillcal.calib_core.maths.rms import rms

FEWEST = 10
"""Bursts by which it is known when their samples were measured."""

PAUSE_S = 5.0
"""s that part two bursts at least if a pause lies between them, in which nothing was measured."""

NEAR = 5
"""Bursts of which one at least is delivered without delay."""

FOLLOWING = 0.05
"""Part by which each burst moves what is taken for the usual delay, that of some twenty: clocks drift."""

TOLD = 0.2
"""Bursts by which delays may scatter, rms, for lost bursts to be told. Where they tell nothing it is 0.29."""


class Bursts(NamedTuple):
    """Samples delivered together, each in its place (n,): those of lost ones are empty.

    last: (B,) rows of the last samples of bursts. period: s, from place to place.
    """

    place: NDArray[np.int64]
    last: NDArray[np.int64]
    period: float


def bursts(t: Array) -> Bursts:
    """Place samples that are delivered at t (n,) s, in bursts; few bursts do not tell that any are lost.

    The last samples of bursts are as late as their delivery. Where bursts are late from then on, by as long
    as one or more usual ones last, so many are lost.
    """
    last = np.flatnonzero(np.append(np.diff(t) > HEELS * intervals(t).mean(), True))
    place, sizes, waits = np.arange(t.size), np.diff(last), np.diff(t[last])
    paused = waits > PAUSE_S
    if last.size < FEWEST or paused.all():
        return Bursts(place, last, sample_period(t))
    period, usual = _period(sizes, waits), float(np.median(sizes))
    lost = _lost((t[last] - period * last) / (period * usual), np.flatnonzero(paused) + 1)
    missing = np.zeros(t.size, dtype=np.int64)
    missing[np.concatenate([[0], last[:-1] + 1])] = np.rint(usual * lost)
    if missing.sum() < t.size:  # more are no losses: somebody samples for a while now and then
        place += np.cumsum(missing)
    return Bursts(place, last, float(waits[~paused].sum() / np.diff(place[last])[~paused].sum()))


def _period(sizes: NDArray[np.int64], waits: Array) -> float:
    """Return the time, s, from sample to sample, by bursts of sizes (B,) that take (B,) s and lose none."""
    apart = waits / sizes
    whole = np.abs(apart - np.median(apart)) < 0.5 * np.median(apart)
    return float(waits[whole].sum() / sizes[whole].sum())


def _lost(late: Array, after_pause: NDArray[np.int64]) -> Array:
    """Return how many bursts (B,) are lost before each one.

    late: (B,) how late each is delivered, in bursts. after_pause: which ones are the first after a pause.
    """
    prompt = np.pad(late, (0, NEAR - 1), mode="edge")
    prompt = np.lib.stride_tricks.sliding_window_view(prompt, NEAR).min(axis=1)
    gone, off = np.zeros(late.size), np.zeros(late.size)
    usual, missing, resumed = float(np.median(prompt[:NEAR])), 0.0, set(after_pause.tolist())
    for k, now in enumerate(prompt.tolist()):
        if k in resumed:
            usual = now - missing
        missing = float(round(now - usual))
        gone[k], off[k] = missing, now - usual - missing
        usual += FOLLOWING * off[k]
    if rms(off) > TOLD:
        return np.zeros(late.size)
    # What is made up for later was a delay.
    lasting = np.minimum.accumulate(gone[::-1])[::-1]
    return np.diff(np.maximum(lasting, 0.0), prepend=0.0)


def measured_evenly(t: Array) -> tuple[Array, float]:
    """Return when samples (n,) were measured, at equal intervals, whose stamps t tell when bursts came.

    And by what part their interval is unsure, one standard deviation: all of it where bursts are few.
    """
    place, last, _ = bursts(t)
    if last.size < FEWEST:
        return t, 1.0
    line = np.polyfit(place[last], t[last], 1)
    off = t[last] - np.polyval(line, place[last])
    spread = float(place[last].std() * np.sqrt(last.size - 2.0)) * float(line[0])
    return np.asarray(np.polyval(line, place), dtype=np.float64), rms(off) / spread
