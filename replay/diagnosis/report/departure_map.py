"""The map of where a recording differs from the simulation: time by channel, in units of noise.

Slow channels are residuals of the affine phone with the effects still in them; their noise is the scatter
from bin to bin without the effects. Fast channels are the spread of single samples relative to the datasheet
value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.records import Claims
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.diagnosis.segments.windows import windows
from stillcal.calib_core.streams.resample import median_rate_hz
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.report.curves import residuals, unexplained_residual
from stillcal.replay.diagnosis.twin import AffinePhone
from stillcal.replay.formats.trace import Recording

CELLS = 96
"""Columns of the map: a quarter of an hour each, for a day."""

LEAST_NOISE = 0.05
"""Least noise of the logarithm of a spread: 5 %."""


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """One row of the map. value: (CELLS,) in `unit`; departure: (CELLS,) over `noise`; nan: not seen."""

    name: str
    unit: str
    noise: float
    value: Array
    departure: Array


@dataclass(frozen=True, slots=True, eq=False)
class DepartureMap:
    """The map. edges: (CELLS + 1,) s, boundaries of the columns in the recording's stamps."""

    edges: Array
    channels: tuple[Channel, ...]

    def plain(self) -> dict[str, Any]:
        """Return the map as plain values; None where nothing was seen."""
        rows = [
            {
                "channel": c.name,
                "unit": c.unit,
                "noise": c.noise,
                "value": _rounded(c.value),
                "departure": _rounded(c.departure),
            }
            for c in self.channels
        ]
        return {"t": [round(float(t), 3) for t in self.edges], "channels": rows}


def _rounded(values: Array) -> list[float | None]:
    return [float(f"{v:.4g}") if np.isfinite(v) else None for v in values]


def map_of(
    recording: Recording, bins: Bins, affine_phones: tuple[AffinePhone, AffinePhone], claims: Claims
) -> DepartureMap:
    """Return the map. affine_phones: fitted without and with the effects found."""
    accel = recording.accelerometer
    edges = np.linspace(float(accel.t[0]), float(accel.t[-1]), CELLS + 1)
    rows = _slow("accel", bins, affine_phones, claims.gravity, edges) if len(bins) > 5 else []
    if bins.rate is not None and len(bins) > 5:
        rows += _slow("gyro", bins, affine_phones, claims.gravity, edges)
    rows += _spreads("accel", accel, bins, claims, edges)
    if recording.gyroscope is not None:
        rows += _spreads("gyro", recording.gyroscope, bins, claims, edges)
    return DepartureMap(edges, (*rows, _stamps(accel, edges)))


def _cells(t: Array, values: Array, edges: Array) -> Array:
    """Return the mean of values (n,) in every cell, (CELLS,), NaN where there are none."""
    cell = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, CELLS - 1)
    count = np.bincount(cell, minlength=CELLS)
    total = np.bincount(cell, weights=values, minlength=CELLS)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _slow(
    sensor: str, bins: Bins, affine_phones: tuple[AffinePhone, AffinePhone], gravity: float, edges: Array
) -> list[Channel]:
    plain, better = affine_phones
    names = ["accel norm"] if sensor == "accel" else [f"gyro {a} at rest" for a in "xyz"]
    known, explained = ((b.accel if sensor == "accel" else b.gyro) for b in affine_phones)
    parts = zip(
        names, residuals(sensor, bins, plain, gravity), residuals(sensor, bins, better, gravity), strict=True
    )
    variance = bins.force_variance if sensor == "accel" or bins.rate_variance is None else bins.rate_variance
    rows = []
    for name, before, after in parts:
        departure, remaining = unexplained_residual(before, known), unexplained_residual(after, explained)
        # Few bins beside many parameters leave hardly anything: less than the white noise it cannot be.
        white = np.sqrt(np.median(np.sum(before.project**2 * variance, axis=1)))
        noise = max(_bin_to_bin(remaining, bins), float(white))
        value = _cells(bins.t, departure, edges)
        rows.append(Channel(name, UNIT[sensor], noise, value, value / noise))
    return rows


def _bin_to_bin(remaining: Array, bins: Bins) -> float:
    """Return a bin's noise, from differences of neighbours in one rest, or of all if rests are short."""
    step = np.diff(remaining)
    inside = step[np.diff(bins.rest) == 0]
    used = inside if inside.size >= 10 else step
    middle = float(np.median(np.abs(used)))
    return max(1.4826 / 1.4142 * middle, 1e-12)


def _spreads(sensor: str, samples: Samples, bins: Bins, claims: Claims, edges: Array) -> list[Channel]:
    """Return the spread of single samples in static bins relative to the declared one, or to their median."""
    short_windows = windows(samples, *bins.span)
    inside = np.zeros(short_windows.t.size, dtype=bool)
    for t, d in zip(bins.t, bins.duration, strict=True):
        inside[np.searchsorted(short_windows.t, t - d / 2) : np.searchsorted(short_windows.t, t + d / 2)] = (
            True
        )
    inside &= short_windows.count > 3
    if inside.sum() < 5:
        return []
    rate = median_rate_hz(samples)
    declared = _declared(sensor, claims, rate)
    floor = ((claims.accel_lsb if sensor == "accel" else claims.gyro_lsb) or 0.0) / np.sqrt(12.0)
    rows = []
    for a, axis in enumerate("xyz"):
        spread = np.sqrt(np.maximum(short_windows.variance[inside, a], 1e-24))
        middle = float(np.median(spread)) if declared is None else declared
        # A step coarser than the noise hides it: less spread than the step's own tells nothing.
        log = np.log(np.maximum(spread, floor) / middle)
        noise = max(1.4826 * float(np.median(np.abs(log - np.median(log)))), LEAST_NOISE)
        value, mean = (
            _cells(short_windows.t[inside], spread, edges),
            _cells(short_windows.t[inside], log, edges),
        )
        rows.append(Channel(f"{sensor} {axis} noise", UNIT[sensor], noise * middle, value, mean / noise))
    return rows


def _declared(sensor: str, claims: Claims, rate: float) -> float | None:
    density = claims.accel_noise_density if sensor == "accel" else claims.gyro_noise_density
    lsb = (claims.accel_lsb if sensor == "accel" else claims.gyro_lsb) or 0.0
    return None if density is None else float(np.hypot(density * np.sqrt(rate / 2.0), lsb / np.sqrt(12.0)))


def _stamps(samples: Samples, edges: Array) -> Channel:
    """Return the deviation of sample intervals, in units of the jitter that Android allows."""
    steps = np.diff(samples.t)
    period = float(np.median(steps))
    off = np.minimum(np.abs(steps - period), 10.0 * period)
    value, noise = _cells(samples.t[1:], off, edges), thresholds.JITTER_TOLERANCE * period
    return Channel("stamps", "s", noise, value, value / noise)
