"""Sensors without any noise, as simulators have: they are judged with as much as a real one has.

Every test takes its uncertainty from the noise. Without any, the least inexactness of a model is a
difference beyond doubt: that of a time constant, or of a temperature between two readings.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.segments.overview import Overview
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.diagnosis.segments.value_grid import comb_step
from stillcal.calib_core.diagnosis.segments.windows import FEWEST_SAMPLES, Windows, windows
from stillcal.calib_core.streams.samples import Samples, Sensor

QUIETEST = {Sensor.ACCELEROMETER: 1e-3, Sensor.GYROSCOPE: float(np.deg2rad(0.0038))}
"""Densities of white noise, one-sided, m/s^2 and rad/s per sqrt(Hz): the quietest of 35 real accelerometers
(still experiment of Stisen et al. 2015), and a quiet phone's gyroscope (data sheet of the LSM6DSO)."""

FAINT = 0.01
"""Part of it below which a sensor has none of its own: what is left is rounding, or an effect's change."""

QUIET = 0.2
"""Part of the seconds that are taken to be at rest at least, where an effect changes least."""

STRETCH, STRETCHES = 20.0, 30
"""s of a stretch in which a sensor's own noise is looked for, and how many there are."""


def with_noise(samples: Samples, seen: Windows) -> tuple[Samples, Windows] | None:
    """Return samples and the windows of all of them with white noise; None where the sensor has its own.

    A sensor whose values come in larger steps has its noise beneath them, and an axis that never changes is
    dead. The noise is the same for the same recording.
    """
    period = sample_period(samples.t)
    if period <= 0.0:
        return None
    moving = np.ptp(samples.xyz, axis=0) > 0.0
    axes, sd = np.flatnonzero(moving), QUIETEST[samples.sensor] * np.sqrt(0.5 / period) * moving
    if not axes.size or (_own(samples, period) > FAINT * sd)[axes].any():
        return None
    if any((comb_step(samples.xyz[:, axis]) or 0.0) > sd[axis] for axis in axes):
        return None
    rng = np.random.default_rng([len(samples), samples.sensor is Sensor.GYROSCOPE])
    away = sd * rng.normal(size=seen.mean.shape) / np.sqrt(np.maximum(seen.count, 1.0))[:, None]
    louder = {name: getattr(seen, name) + sd**2 for name in ("variance", "calm_variance")}
    made = replace(seen, mean=seen.mean + away, calm_mean=seen.calm_mean + away, **louder)
    return replace(samples, xyz=frozen(samples.xyz + sd * rng.normal(size=samples.xyz.shape))), made


def _own(samples: Samples, period: float) -> Array:
    """Return the standard deviation (3,) of samples at rest about a line, infinite where none are.

    Second differences of white noise have six times its variance. Stretches of a long recording tell it.
    """
    size = max(round(STRETCH / period), 3)
    starts = np.unique(np.linspace(0, max(len(samples) - size, 0), STRETCHES).astype(np.int64))
    square = np.concatenate([_bends(samples[int(k) : int(k) + size]) for k in starts])
    return np.sqrt(np.quantile(square, QUIET, axis=0) / 6.0) if len(square) else np.full(3, np.inf)


def _bends(samples: Samples) -> Array:
    """Return the mean square (s, 3) of second differences in each second of a stretch."""
    if len(samples) < 3:
        return np.empty((0, 3))
    bent = replace(samples[1:-1], xyz=np.diff(samples.xyz, n=2, axis=0))
    seen = windows(bent, float(bent.t[0]), float(bent.t[-1]))
    return (seen.variance + seen.mean**2)[seen.count >= FEWEST_SAMPLES]


def audible(
    accelerometer: Samples, gyroscope: Samples | None, seconds: Overview
) -> tuple[Samples, Samples | None, Overview, frozenset[str]]:
    """Return both sensors and every second of them with noise, and which sensors have none of their own.

    One that never changes has none, and gets none: it may be a simulation at rest, or a dead sensor.
    """
    both = (("accel", accelerometer), ("gyro", gyroscope))
    silent = {sensor for sensor, samples in both if samples and not np.ptp(samples.xyz, axis=0).any()}
    if (made := with_noise(accelerometer, seconds.force)) is not None:
        accelerometer, seconds = made[0], replace(seconds, force=made[1])
        silent.add("accel")
    made = None if gyroscope is None or seconds.rate is None else with_noise(gyroscope, seconds.rate)
    if made is not None:
        gyroscope, seconds = made[0], replace(seconds, rate=made[1])
        silent.add("gyro")
    return accelerometer, gyroscope, seconds, frozenset(silent)
