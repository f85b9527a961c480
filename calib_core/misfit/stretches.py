"""Steady stretches of a recording, and their spectra above those of their neighbourhood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.misfit.quick import Index
from stillcal.calib_core.samples import Array, Samples

STEADY = {"accel": 0.1, "gyro": 0.03}
NEIGHBOURS = 34
INDEPENDENT = NEIGHBOURS / 1.944
"""Of the neighbours: powers under a Hann window are correlated by 4/9 and 1/36 one and two lines apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretches:
    """Steady stretches, overlapping by half.

    t: (S, n) s; values: (S, n, 3), no means; first: (S,) rows; share: (S,), what of each the next
    does not hold; f: (F,) Hz; power, ratio to its neighbours': (S, F, 3).
    """

    t: Array
    values: Array
    first: Index
    share: Array
    f: Array
    power: Array
    ratio: Array


def stretches(samples: Samples, sensor: str, seconds: float) -> Stretches | None:
    """Return the steady stretches of `seconds` of one sensor, or None where there are fewer than three."""
    rate = 1.0 / float(np.median(np.diff(samples.t)))
    length = int(seconds * rate)
    if length < 100 or len(samples) < 3 * length:
        return None
    first = _steady(samples.xyz, max(round(rate), 1), length, STEADY[sensor])
    first = first[samples.t[first + length - 1] - samples.t[first] < 1.2 * seconds]
    if first.size < 3:
        return None
    rows = first[:, None] + np.arange(length)
    values = samples.xyz[rows] - samples.xyz[rows].mean(axis=1, keepdims=True)
    power, ratio = _ratios(values)
    f = np.asarray(np.fft.rfftfreq(length, 1.0 / rate), dtype=np.float64)
    share = np.minimum(np.append(np.diff(first), length) / length, 1.0)
    return Stretches(samples.t[rows], values, first, share, f, power, ratio)


def _steady(xyz: Array, second: int, length: int, most: float) -> Index:
    """Return first rows of stretches whose means over a second stay where they are.

    They are rests, shaken or not; each begins half way through the one before, where a Hann window has given
    half of its weight, or as the phone comes to rest.
    """
    count = len(xyz) // second
    means = xyz[: count * second].reshape(count, second, 3).mean(axis=1)
    span = max(length // second, 1)
    around = np.lib.stride_tricks.sliding_window_view(means, span, axis=0)
    still = np.ptp(around, axis=2).max(axis=1) < most
    still = still[: max((len(xyz) - length) // second + 1, 0)]
    starts, free = [], 0
    for k in np.flatnonzero(still):
        if k * second >= free:
            starts.append(int(k) * second)
            free = starts[-1] + length // 2
    return np.array(starts, dtype=np.int64)


def _ratios(values: Array) -> tuple[Array, Array]:
    """Return powers (S, F, 3) and their ratio to the mean of `NEIGHBOURS`, a line's own bins apart."""
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - the daemon stays light

    spectrum = np.fft.rfft(values * np.hanning(values.shape[1])[None, :, None], axis=1)
    power = np.asarray(np.abs(spectrum) ** 2)
    around, own = 41 * uniform_filter1d(power, 41, axis=1), 7 * uniform_filter1d(power, 7, axis=1)
    background = np.maximum((around - own) / NEIGHBOURS, 1e-6 * power.mean(axis=1, keepdims=True))
    return power, np.asarray(power / np.maximum(background, 1e-300))
