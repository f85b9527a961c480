"""Stretches of a recording with another sample rate each: an app or a driver has set it anew."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import Measured, direct_finding, of_measured
from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import Usual

DRIVER = "a sample rate that changes"
WINDOW = 50
"""Intervals whose median is looked at together."""

EVEN, MOSTLY = 0.25, 0.8
"""A window has a rate where this share of its intervals is within this part of their median.

Where samples are lost at random, or stamps scatter much, no window has one.
"""

CHANGE = 0.1
"""Natural logarithm of two rates' ratio from which they are two."""

UNSURE = 0.01
"""Standard error of the logarithm of two rates' ratio, at least: sensors' oscillators change by so much."""

LEAST_S = 20.0
"""s that a rate must be kept; drivers take a few seconds to settle on one."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Intervals `first` to `last` (not included) that are of one period, s."""

    first: int
    last: int
    period: float


def stretches(t: Array) -> list[Stretch]:
    """Return the stretches of stamps t (n,) s with one rate each, in order; none where it never changes.

    They share their borders, so that every interval is in one.
    """
    steps = np.diff(t)
    rows = steps[: steps.size // WINDOW * WINDOW].reshape(-1, WINDOW)
    middle = np.median(rows, axis=1)
    even = (np.abs(rows - middle[:, None]) < EVEN * middle[:, None]).mean(axis=1) >= MOSTLY
    windows = np.flatnonzero(even & (middle > 0.0))
    level = np.log(middle[windows])
    runs = np.split(np.arange(windows.size), np.flatnonzero(np.abs(np.diff(level)) > CHANGE) + 1)
    kept: list[list[int]] = []
    for run in runs:
        if run.size and t[(windows[run[-1]] + 1) * WINDOW] - t[windows[run[0]] * WINDOW] >= LEAST_S:
            if kept and abs(np.median(level[kept[-1]]) - np.median(level[run])) <= CHANGE:
                kept[-1] += run.tolist()
            else:
                kept.append(run.tolist())
    if len(kept) < 2:
        return []
    periods = [float(np.exp(np.median(level[run]))) for run in kept]
    borders = [0]
    for i, (one, other) in enumerate(pairwise(kept)):
        low, high = int(windows[one[-1]]) * WINDOW, (int(windows[other[0]]) + 1) * WINDOW
        borders.append(low + _border(steps[low:high], periods[i], periods[i + 1]))
    borders.append(steps.size)
    return [Stretch(a, b, p) for (a, b), p in zip(pairwise(borders), periods, strict=True)]


def _border(steps: Array, before: float, after: float) -> int:
    """Return how many of some intervals are of the period before rather than the one after."""
    apart = np.log(np.maximum(steps, 1e-9))
    off = np.abs(apart - np.log(before)) - np.abs(apart - np.log(after))
    return int(np.argmin(np.concatenate([[0.0], np.cumsum(off)])))


def rate_change(t: Array, found: list[Stretch], usual: Usual, band: float) -> Finding | None:
    """Find a sample rate that was set anew. usual: of ln(highest rate / lowest); band: Hz, of the finding."""
    if not found:
        return None
    rates = [_rate(t[one.first : one.last + 1], one.period) for one in found]
    high, low = max(rates, key=lambda r: r.value), min(rates, key=lambda r: r.value)
    error = max(float(np.hypot(high.error / high.value, low.error / low.value)), UNSURE)
    seen = of_measured(Measured(float(np.log(high.value / low.value)), error), usual)
    at = float(t[found[1].first])
    parameters = {"highest_rate": high.parameter("Hz"), "lowest_rate": low.parameter("Hz")}
    say = (
        f"The sample rate changes at {at - t[0]:.0f} s, from {rates[0].value:.4g} to {rates[1].value:.4g} Hz."
    )
    where = Where(at, float(t[-1]), (0.0, band), DRIVER)
    return direct_finding("unknown", "timing", [], where, parameters, statement=say, seen=seen)


def _rate(t: Array, period: float) -> Measured:
    """Return the sample rate of one stretch, the samples that are missing in it counted."""
    count = float(np.rint(np.diff(t) / period).sum())
    rate = count / float(t[-1] - t[0])
    return Measured(rate, rate / count)
