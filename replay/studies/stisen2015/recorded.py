"""Activity as different devices would have recorded it: their errors, their rates, their uneven sampling.

The three heterogeneities of Stisen et al. 2015 (biases, rates, instability), each to be switched on by
itself, from what the still experiment shows of real devices; and interpolation to a common rate (5.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.har.data import RATE_HZ
from stillcal.replay.studies.har.devices import Device
from stillcal.replay.studies.har.features import SECONDS

MARGIN_S = 0.2
"""Left at the start of each recorded window, so that uneven sampling finds motion on either side."""

METHODS = ("nearest", "linear", "cubic", "smoothed")
RATES_HZ = (25.0, 50.0, 100.0, 200.0)
"""Target rates of interpolation (5.2)."""

SMOOTHING = 0.2
"""A smoothed spline may miss its m samples by 0.2 m in all, squared, (m/s^2)^2 (5.2)."""


@dataclass(frozen=True, slots=True)
class Kinds:
    """Which heterogeneities a device brings: errors and noise; its own rate; uneven sampling."""

    errors: bool = True
    rate: bool = True
    uneven: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """Windows as recorded: samples (n, length, 3) m/s^2 and their creation stamps (n, length), s."""

    samples: Array
    stamps: Array


def reference(accel: Array) -> Recorded:
    """Return windows (n, 128, 3) at 50 Hz as recorded by a device without errors at 50 Hz."""
    times = MARGIN_S + np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    return Recorded(at_times(accel, np.tile(times, (len(accel), 1))), np.tile(times, (len(accel), 1)))


def record(accel: Array, device: Device, kinds: Kinds, rng: np.random.Generator) -> Recorded:
    """Return windows (n, 128, 3) at 50 Hz as the device would have recorded them.

    A window has as many samples as the device has in two seconds on the mean; uneven sampling makes it
    last longer or shorter, as it does where windows are counted in samples.
    """
    rate = device.rate_hz if kinds.rate else RATE_HZ
    length = round(SECONDS * rate)
    if kinds.uneven:
        stamps = MARGIN_S + _stamps(device, len(accel), length, rng) * device.rate_hz / rate
    else:
        stamps = np.tile(MARGIN_S + np.arange(length) / rate, (len(accel), 1))
    values = at_times(accel, stamps)
    if kinds.errors:
        values = device.distort(values) + device.noise(len(values), length, rng)
    return Recorded(values, stamps)


def _stamps(device: Device, n: int, length: int, rng: np.random.Generator) -> Array:
    """Return n stretches of real creation stamps, (n, length), each from 0 on, s; from all its recordings."""
    rows = np.empty((n, length))
    chosen = rng.integers(0, len(device.rests), n)
    for k, rest in enumerate(device.rests):
        start = rng.integers(0, len(rest.creation) - length, int(np.sum(chosen == k)))
        stretch = rest.creation[start[:, None] + np.arange(length)]
        rows[chosen == k] = stretch - stretch[:, :1]
    return rows


def at_times(accel: Array, times: Array) -> Array:
    """Return windows (n, 128, 3) at 50 Hz as they were at times (n, length) s, by cubic splines.

    Times beyond a window hold its first or last sample.
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - slow to import

    grid = np.arange(accel.shape[1]) / RATE_HZ
    cubic = CubicSpline(grid, accel, axis=1).c  # (4, pieces, n, 3)
    inside = np.clip(times, grid[0], grid[-1])
    piece = np.minimum((inside * RATE_HZ).astype(int), accel.shape[1] - 2)
    off = (inside - grid[piece])[:, :, None]
    rows = np.arange(len(accel))[:, None]
    a, b, c, d = (cubic[k][piece, rows] for k in range(4))
    return np.asarray(((a * off + b) * off + c) * off + d)


def resample(recorded: Recorded, rate: float, method: str) -> Array:
    """Interpolate windows to a common rate over their first two seconds; (n, round(2 rate), 3)."""
    grid = MARGIN_S + np.arange(round(SECONDS * rate)) / rate
    work = {"nearest": _nearest, "linear": _linear, "cubic": _cubic, "smoothed": _smoothed}[method]
    pairs = zip(recorded.stamps, recorded.samples, strict=True)
    return np.stack([work(t, x, np.minimum(grid, t[-1])) for t, x in pairs])


def _nearest(t: Array, x: Array, grid: Array) -> Array:
    after = np.clip(np.searchsorted(t, grid), 1, len(t) - 1)
    earlier = grid - t[after - 1] < t[after] - grid
    return np.asarray(x[after - earlier])


def _linear(t: Array, x: Array, grid: Array) -> Array:
    return np.stack([np.interp(grid, t, x[:, axis]) for axis in range(3)], axis=1)


def _cubic(t: Array, x: Array, grid: Array) -> Array:
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - slow to import

    kept = np.r_[True, np.diff(t) > 0.0]
    return np.asarray(CubicSpline(t[kept], x[kept])(grid))


def _smoothed(t: Array, x: Array, grid: Array) -> Array:
    from scipy.interpolate import UnivariateSpline  # noqa: PLC0415 - slow to import

    kept = np.r_[True, np.diff(t) > 0.0]
    t, x = t[kept], x[kept]
    splines = [UnivariateSpline(t, x[:, axis], s=SMOOTHING * len(t)) for axis in range(3)]
    return np.stack([spline(grid) for spline in splines], axis=1)


def by_rate(device: NDArray[np.intp], rates: list[float]) -> NDArray[np.intp]:
    """Return the nearest of RATES_HZ, as a ratio, of each row's device (n,). rates: Hz, by device."""
    nearest = np.abs(np.log(np.array(rates)[:, None] / np.array(RATES_HZ))).argmin(axis=1)
    return np.asarray(nearest[device], dtype=np.intp)
