"""The turns between rests as they were recorded: from where the phone lay to where it lies next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.bursts import measured_evenly
from stillcal.calib_core.diagnosis.segments.sample_period import bunched
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.maths.robust import means
from stillcal.calib_core.streams.samples import Samples

LONGEST_TURN = 60.0

LONGEST_GAP = 0.5
"""s without a sample after which an attitude is lost; a long recording keeps the samples of some motion."""

SHORT_OF = 0.98
"""Part of a limit that a rate, less its bias, may reach."""

LEAST_ANGLE = 0.2

SHARPEST = 0.5
"""rad from sample to sample, beyond which what happens between samples is not known from them."""

MARGIN = 0.5

WINDOWS = (1, 2, 4, 8, 16, 32, 64)


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """A turn as recorded, from bin `first` to the next. t: (n,) s; rate: (n, 3) rad/s, bias off.

    stretch: the part of its time that is unsure, one standard deviation.
    """

    first: int
    t: Array
    rate: Array
    temperature: float
    stretch: float = 0.0


Rates = Callable[[Samples], Array]
"""The rate (n, 3) rad/s of some of the gyroscope's samples, what is known of its errors taken off."""


def as_read(samples: Samples) -> Array:
    """Return the rate as it was read: nothing is known of its errors."""
    return np.asarray(samples.xyz)


def cuts(gyroscope: Samples, bins: Bins, limit: float = np.inf, rates: Rates = as_read) -> list[Cut]:
    """Cut the turns between successive rests, each less the bias that its neighbourhood tells best.

    Turns in which a rate as read comes near `limit` (rad/s), where the sensor stops, are left out. Stamps in
    bursts say when samples were delivered: those of a turn count as measured at equal intervals.
    """
    if bins.rate is None:
        return []
    bias = _local_bias(bins.rate)
    last = np.flatnonzero(np.diff(bins.rest) > 0)
    found = [_cut(gyroscope, bins, bias, int(i), rates) for i in last]
    clear = [c for c in found if c is not None and _fastest(gyroscope, c, bias) < SHORT_OF * limit]
    return [_even(c) for c in clear] if bunched(gyroscope.t) else clear


def _even(cut: Cut) -> Cut:
    """Return a turn, stamped in bursts, as it was measured."""
    t, stretch = measured_evenly(cut.t)
    return replace(cut, t=t, stretch=stretch)


def _fastest(gyroscope: Samples, cut: Cut, bias: Array) -> float:
    """Return the largest rate on any axis during a turn as read, less its bias, rad/s."""
    first = int(np.searchsorted(gyroscope.t, cut.t[0]))
    return float(np.abs(gyroscope.xyz[first : first + cut.t.size] - bias[cut.first]).max())


def _local_bias(rate: Array) -> Array:
    """Return the bias (N - 1, 3) between successive bins of rate (N, 3): a mean over bins on either side.

    The width of the mean, axis by axis, is that which foretells a bin best from its neighbours.
    """
    n = len(rate)
    out = (rate[1:] + rate[:-1]) / 2.0
    least = np.full(3, np.inf)
    at = np.arange(n)
    for width in WINDOWS:
        if width > 1 and width >= n:
            break
        low, high = np.maximum(at - width, 0), np.minimum(at + width + 1, n)
        # A bin's distance from the mean of the others about it.
        away = (rate - means(rate, low, high)) * ((high - low) / np.maximum(high - low - 1, 1))[:, None]
        error = np.median(np.abs(away), axis=0)
        local = means(rate, np.maximum(at[1:] - width, 0), np.minimum(at[1:] + width, n))
        out = np.where(error < least, local, out)
        least = np.minimum(error, least)
    return np.asarray(out)


def _cut(gyroscope: Samples, bins: Bins, bias: Array, i: int, rates: Rates) -> Cut | None:
    """Cut the turn from bin i to bin i + 1, of different rests; None where some of it was not recorded."""
    start = float(bins.t[i] + bins.duration[i] / 2) - MARGIN
    end = float(bins.t[i + 1] - bins.duration[i + 1] / 2) + MARGIN
    part = gyroscope.between(start, end)
    if end - start > LONGEST_TURN or len(part) < 10:
        return None
    if not throughout(part.t, start, end):
        return None
    if not followed(part.t, part.xyz):
        return None
    rate = rates(part) - bias[i]
    if _angle(part.t, rate) < LEAST_ANGLE:
        return None
    warm = 0.0 if bins.temperature is None else float(bins.temperature[i] + bins.temperature[i + 1]) / 2.0
    return Cut(i, part.t, rate, warm)


def followed(t: Array, rate: Array) -> bool:
    """Whether samples of the rate (n, 3) at t (n,) are so close that they tell what happens between them."""
    return bool(np.linalg.norm(rate, axis=1).max() * np.median(np.diff(t)) <= SHARPEST)


def throughout(t: Array, start: float, end: float) -> bool:
    """Whether samples at t (n,) s follow an attitude all the way from `start` to `end`, s."""
    return bool(np.diff(t, prepend=start, append=end).max() <= LONGEST_GAP)


def _angle(t: Array, rate: Array) -> float:
    """Return the angle turned through, rad, of rates (n, 3) at t (n,)."""
    return float(np.linalg.norm(np.gradient(t)[:, None] * rate, axis=1).sum())
