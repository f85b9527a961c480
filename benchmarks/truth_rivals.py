"""What item 7 compares stillcal with: raw readings, a table of offsets by temperature, vqf's bias at rest."""

from __future__ import annotations

from typing import Any

import numpy as np
from peers import peer

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.static.rest import RestState


class OffsetTable:
    """Gyroscope offsets by temperature, our own reading of the idea that Android's stack publishes.

    Every rest leaves its mean rate in the bin of its temperature (2 K wide, newest wins). The offset in use
    is the newest one while the temperature is within a bin of its own, else that of the temperature's bin,
    else the robust line through all bins, else the newest.
    """

    bin_k = 2.0

    def __init__(self) -> None:
        self._bins: dict[int, tuple[float, Array]] = {}
        self._newest: tuple[float, Array] | None = None

    def take(self, rest: RestState) -> None:
        """Take a rest's mean rate."""
        if rest.rate is not None:
            celsius = 25.0 if rest.temperature is None else rest.temperature
            self._newest = (celsius, rest.rate)
            self._bins[round(celsius / self.bin_k)] = self._newest

    def bias(self, celsius: float) -> Array | None:
        """Return the offset in use (3,), rad/s; None before the first rest."""
        if self._newest is None or abs(celsius - self._newest[0]) <= self.bin_k / 2:
            return None if self._newest is None else self._newest[1]
        if (held := self._bins.get(round(celsius / self.bin_k))) is not None:
            return held[1]
        if len(self._bins) < 3:
            return self._newest[1]
        at = np.array([c for c, _ in self._bins.values()])
        offsets = np.array([o for _, o in self._bins.values()])
        slope, level = np.polyfit(at, offsets, 1)
        return level + slope * celsius


class Vqf:
    """vqf (MIT), fed with every sample of both sensors: its bias estimate, gated by its own detector."""

    def __init__(self, rate_hz: float) -> None:
        module: Any = peer("vqf")
        self._filter = None if module is None else module.VQF(1.0 / rate_hz)

    def take(self, gyro: Array, accel: Array) -> None:
        """Take samples (n, 3) of both."""
        if self._filter is not None:
            n = min(len(gyro), len(accel))
            gyro, accel = (np.ascontiguousarray(values[:n]) for values in (gyro, accel))
            self._filter.updateBatch(gyro, accel)

    def bias(self) -> Array | None:
        """Return the bias (3,), rad/s; None where vqf is not installed."""
        return None if self._filter is None else np.asarray(self._filter.getBiasEstimate()[0])
