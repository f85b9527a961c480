"""Removal of electronic noise by a rolling mean (Grammenos et al. 2018, 4.6 and Table 2), on streams.

The mean is over the newest samples. It therefore lags behind a steady change by half of its window. The paper
prefers it to a rolling median: it leaves less variance (Table 1) and sorts nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.resample import median_rate_hz
from stillcal.calib_core.streams.samples import Samples

_WINDOWS = ((20, 3), (80, 5), (120, 10))
"""Table 2: highest rate, Hz, and number of samples. The paper gives whole rates, so others are rounded."""

_FASTEST = 20
"""Samples above the last rate of the table."""

MAX_RATE_HZ = 1e5
"""Far above any phone's sampling rate."""


def window_for(rate_hz: float) -> int:
    """Return the number of samples to average at a sampling rate (Table 2).

    Raises ValueError for a rate that is none.

    >>> [window_for(hz) for hz in (5, 20.2, 50, 80, 100, 120, 200)]
    [3, 3, 5, 5, 10, 10, 20]
    """
    if not 0.0 < rate_hz <= MAX_RATE_HZ:
        raise ValueError(f"a rate of {rate_hz:g} Hz: must be above 0, at most {MAX_RATE_HZ:g}")
    return next((window for limit, window in _WINDOWS if round(rate_hz) <= limit), _FASTEST)


class RollingMean:
    """The rolling mean of one sensor's readings, block by block; how they are cut changes nothing.

    rate_hz: sampling rate. window: number of samples averaged; at first fewer, as many as have come.
    """

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz, self.window = rate_hz, window_for(rate_hz)
        self._tail = np.empty((0, 3))
        self._last: float | None = None

    @property
    def delay_s(self) -> float:
        """How far the mean lags behind a steady change, s."""
        return 0.5 * (self.window - 1) / self.rate_hz

    def smoothed(self, xyz: Array) -> Array:
        """Return the means at the next readings, (n, 3)."""
        before = len(self._tail)
        rows = np.concatenate((self._tail, xyz))
        total, counts = np.zeros_like(rows), np.minimum(np.arange(1, len(rows) + 1), self.window)
        for lag in range(min(self.window, len(rows))):
            total[lag:] += rows[: len(rows) - lag]
        self._tail = rows[max(len(rows) - self.window + 1, 0) :].copy()
        return frozen((total / counts[:, None])[before:])

    def words(self) -> str:
        """Return what the mean does, for a person.

        >>> RollingMean(50.0).words()
        'mean of 5 samples at 50 Hz, 0.04 s late'
        """
        return f"mean of {self.window} samples at {self.rate_hz:.3g} Hz, {self.delay_s:.2g} s late"

    def smoothed_samples(self, samples: Samples) -> Samples:
        """Return the next samples with their readings averaged; stamps and other columns stay.

        After a pause as long as the window the mean begins anew.
        """
        if not len(samples):
            return samples
        before = samples.t[0] if self._last is None else self._last
        pause = np.diff(samples.t, prepend=before) > self.window / self.rate_hz
        self._last = float(samples.t[-1])
        parts = []
        for run in np.split(np.arange(len(samples)), np.flatnonzero(pause)):
            if run.size and pause[run[0]]:
                self._tail = np.empty((0, 3))
            parts.append(self.smoothed(samples.xyz[run]))
        return replace(samples, xyz=frozen(np.concatenate(parts)))


def smoothed(samples: Samples) -> Samples:
    """Return all of a sensor's samples smoothed, by the median rate of them all.

    Raises ValueError where there are too few for a rate.
    """
    return RollingMean(median_rate_hz(samples)).smoothed_samples(samples)
