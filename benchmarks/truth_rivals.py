"""What item 7 compares stillcal with.

A table of gyroscope offsets by temperature, vqf's gyroscope bias at rest, and scikit-digital-health's fit of
every day's accelerometer.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from peers import peer

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.samples import Samples

DAY_S = 86400.0


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


class DailyFit:
    """scikit-digital-health (MIT): its fit of a whole day (van Hees et al. 2014), in use until the next one.

    Offset, scale by axis, and a slope with temperature. With the tolerance it is shipped with, the fit ends
    too early: it is tightened here.
    """

    def __init__(self) -> None:
        self._module: Any = peer("skdh.preprocessing")
        self._day: list[Samples] = []
        self._fitted: tuple[Array, Array, Array, float] | None = None

    def take(self, accelerometer: Samples) -> None:
        """Take a run of samples with temperatures; fit when they make a day."""
        if self._module is None:
            return
        self._day.append(accelerometer)
        if accelerometer.t[-1] - self._day[0].t[0] >= DAY_S:
            self._fit(Samples.joined(self._day))
            self._day = []

    def model(self, celsius: float) -> tuple[Array, Array] | None:
        """Return scale (3, 3) and bias (3,), m/s^2, of the newest day that it could fit; None before."""
        if self._fitted is None:
            return None
        scale, offset, slope, mean = self._fitted
        return np.diag(scale), -(offset + slope * (celsius - mean) / scale) * STANDARD

    def _fit(self, day: Samples) -> None:
        in_g = day.xyz / STANDARD
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = self._module.CalibrateAccelerometer(min_hours=23, tol=1e-14, max_iter=5000).predict(
                time=day.t,
                accel=in_g,
                fs=(len(day) - 1) / (day.t[-1] - day.t[0]),
                temperature=day.temperature,
            )
        scale, offset = (np.asarray(found[name]) for name in ("scale", "offset"))
        slope = np.ravel(found["temperature scale"])
        if offset.any():
            # It does not tell the temperature that its slope counts from: read it off a corrected sample.
            most = np.abs(slope).argmax()
            by_slope = (found["accel"][0] - (in_g[0] + offset) * scale)[most]
            assert day.temperature is not None
            self._fitted = scale, offset, slope, float(day.temperature[0] - by_slope / slope[most])
