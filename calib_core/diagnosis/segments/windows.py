"""Windows of a second or less, in which a recording is cut: mean and spread, the farthest sample left out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Samples

WINDOW, BRIEF_WINDOWS = 1.0, (0.5, 0.25)
"""s. Brief windows find rests of two or three seconds: a calibration by hand is made of such."""

FEWEST_SAMPLES = 5
KNOCK = 3.0
"""Spread of a window over what is usual, above which something touched the phone."""


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Windows of one sensor. t: (n,) s, middles; count: (n,); mean, variance: (n, 3).

    calm_mean, calm_variance: (n, 3), the same without each axis' farthest sample.
    """

    t: Array
    count: Array
    mean: Array
    variance: Array
    calm_mean: Array
    calm_variance: Array


def windows(samples: Samples, t_start: float, t_end: float, width: float = WINDOW) -> Windows:
    """Return statistics of `samples` in windows of `width` s; windows without samples have count 0."""
    n = max(1, int((t_end - t_start) / width))
    index = ((samples.t - t_start) / width).astype(np.int64)
    keep = (index >= 0) & (index < n)
    index, xyz = index[keep], samples.xyz[keep]
    count = np.bincount(index, minlength=n).astype(np.float64)
    safe = np.maximum(count, 1.0)[:, None]
    center = np.median(xyz, axis=0) if len(xyz) else np.zeros(3)
    mean: Array = _sums(index, xyz - center, n) / safe
    away = xyz - center - mean[index]
    square, far = _sums(index, away**2, n), _farthest(index, away, n)
    # Without a sample f off the mean moves by -f / (n - 1), and the squares fall by f^2 n / (n - 1).
    others = np.maximum(safe - 1.0, 1.0)
    calm = np.maximum(square - far**2 * safe / others, 0.0) / np.maximum(safe - 2.0, 1.0)
    middles = np.asarray(t_start + (np.arange(n) + 0.5) * width, dtype=np.float64)
    return Windows(middles, count, mean + center, square / others, mean + center - far / others, calm)


def merged(parts: Windows, size: int) -> Windows:
    """Return windows of `size` neighbours each, what is left over at the end in none."""
    n = parts.t.size // size

    def grouped(values: Array) -> Array:
        return np.asarray(values[: n * size].reshape(n, size, *values.shape[1:]))

    each, means = grouped(parts.count), grouped(parts.mean)
    count = each.sum(axis=1)
    weight = each[:, :, None] / np.maximum(count, 1.0)[:, None, None]
    mean = (weight * means).sum(axis=1)
    inside = (grouped(parts.variance) * np.maximum(each - 1.0, 0.0)[:, :, None]).sum(axis=1)
    between = (each[:, :, None] * (means - mean[:, None]) ** 2).sum(axis=1)
    variance = (inside + between) / np.maximum(count - 1.0, 1.0)[:, None]
    return Windows(grouped(parts.t).mean(axis=1), count, mean, variance, mean, variance)


def without_gaps(parts: Windows) -> Windows:
    """Return windows whose means, where no sample fell into one, are those between their neighbours."""
    full = parts.count > 0.0
    if full.all() or not full.any():
        return parts
    mean = np.stack([np.interp(parts.t, parts.t[full], x[full]) for x in parts.mean.T], axis=1)
    return replace(parts, mean=mean)


def _sums(index: NDArray[np.int64], xyz: Array, n: int) -> Array:
    return np.stack([np.bincount(index, weights=xyz[:, a], minlength=n) for a in range(3)], axis=1)


def _farthest(index: NDArray[np.int64], away: Array, n: int) -> Array:
    """Return the value (n, 3) of largest size on each axis of every window; index: ascending."""
    out = np.zeros((n, 3))
    if index.size:
        first = np.flatnonzero(np.diff(index, prepend=-1))
        high, low = np.maximum.reduceat(away, first), np.minimum.reduceat(away, first)
        out[index[first]] = np.where(high > -low, high, low)
    return out


def without_spikes(own: Windows, other: Windows) -> Windows:
    """Leave a single far sample out of a window where the other sensor feels nothing: it is no knock."""
    power, felt = own.variance.sum(axis=1), other.variance.sum(axis=1)
    usual = float(np.quantile(power, 0.25))
    loud = (power > KNOCK**2 * np.maximum(own.calm_variance.sum(axis=1), usual)) & (
        own.count >= FEWEST_SAMPLES
    )
    spiked = (loud & (felt < KNOCK**2 * float(np.median(felt))) & (usual > 0.0))[:, None]
    return replace(
        own,
        mean=np.where(spiked, own.calm_mean, own.mean),
        variance=np.where(spiked, own.calm_variance, own.variance),
    )
