"""Sensors without any noise, as simulators have: they are judged with as much as a real one has.

Every test takes its uncertainty from the noise. Without any, the least inexactness of a model is a
difference beyond doubt: that of a time constant, or of a temperature between two readings.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.segments.noise_range import QUIETEST
from stillcal.calib_core.diagnosis.segments.overview import Overview
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.diagnosis.segments.value_grid import step_at_rest
from stillcal.calib_core.diagnosis.segments.windows import Windows
from stillcal.calib_core.streams.samples import Samples, Sensor

FAINT = 0.01
"""Part of it below which a sensor has none of its own: what is left is rounding, or an effect's change."""

MOVING = {Sensor.ACCELEROMETER: 1.0, Sensor.GYROSCOPE: 0.3}
"""m/s^2 and rad/s by which a sensor's values range at least where the phone moves: an axis that stays the
same meanwhile is dead. At rest it may be well."""

LINE = 0.01
"""Part of second differences that a vibration leaves at most: noise of a narrow band leaves a tenth."""

QUIET = 0.2
"""Part of the seconds that are taken to be at rest at least, where an effect changes least."""

STRETCH, STRETCHES = 20, 30
"""Seconds of a stretch in which a sensor's own noise is looked for, and how many stretches there are."""

SMOOTH = 4.0
"""Growth of the variance of second differences over twice the time: between that of what is smooth (16) and
of white noise (1)."""

FEWEST_TOGETHER = 8
"""Samples that are taken together where a second has fewer."""


def with_noise(samples: Samples, seen: Windows) -> tuple[Samples, Windows] | None:
    """Return samples and the windows of all of them with white noise; None where the sensor has its own.

    A sensor whose values come in larger steps has its noise beneath them, and an axis that never changes
    while the phone moves is dead. The noise is the same for the same recording.
    """
    period = sample_period(samples.t)
    if period <= 0.0:
        return None
    span = np.ptp(samples.xyz, axis=0)
    alive = (span > 0.0) if span.max() > MOVING[samples.sensor] else np.full(3, span.max() > 0.0)
    axes, sd = np.flatnonzero(alive), QUIETEST[samples.sensor] * np.sqrt(0.5 / period) * alive
    if not axes.size or (_own(samples.xyz, period) > FAINT * sd)[axes].any():
        return None
    if any((step_at_rest(samples.xyz[:, axis]) or 0.0) > sd[axis] for axis in axes):
        return None
    rng = np.random.default_rng([len(samples), samples.sensor is Sensor.GYROSCOPE])
    away = sd * rng.normal(size=seen.mean.shape) / np.sqrt(np.maximum(seen.count, 1.0))[:, None]
    louder = {name: getattr(seen, name) + sd**2 for name in ("variance", "calm_variance")}
    made = replace(seen, mean=seen.mean + away, calm_mean=seen.calm_mean + away, **louder)
    return replace(samples, xyz=frozen(samples.xyz + sd * rng.normal(size=samples.xyz.shape))), made


def _own(xyz: Array, period: float) -> Array:
    """Return the standard deviation (3,) of samples (n, 3) at rest about a straight line or a vibration.

    It is infinite for too few. Stretches of a long recording tell it. Noise behind a low-pass hides from
    neighbouring samples: every second one is looked at too, every fourth, ... What is smooth has a variance
    that grows by 16 each time. That of noise stops growing.
    """
    second = max(round(1.0 / period), FEWEST_TOGETHER)
    starts = np.unique(np.linspace(0, max(len(xyz) - STRETCH * second, 0), STRETCHES).astype(np.int64))
    stretches = [xyz[k : k + STRETCH * second] for k in starts.tolist()]
    thinned: list[Array] = []
    for each in (2**k for k in range(second.bit_length())):
        if second // each < FEWEST_TOGETHER:
            break
        found = np.concatenate([_variances(stretch[::each], second // each) for stretch in stretches])
        thinned.append(np.quantile(found, QUIET, axis=0) if len(found) else np.full(3, np.inf))
    own = thinned[0]
    for at, finer in zip(thinned[1:], thinned[:-1], strict=True):
        own = np.maximum(own, np.where(at < SMOOTH * finer, at, 0.0))
    return np.asarray(np.sqrt(own))


def _variances(xyz: Array, size: int) -> Array:
    """Return the variance (k, 3) of the noise of every `size` of the samples (n, 3).

    Second differences of white noise have six times its variance. Of a sine, x[n - 1] + x[n + 1] is
    2 cos(w) x[n], whatever its size and phase: what is left of that is noise beside a vibration.
    """
    count = max(len(xyz) - 2, 0) // size
    bend = np.diff(xyz[: count * size + 2], n=2, axis=0).reshape(count, size, 3)
    middle, both = bend[:, 1:-1], bend[:, :-2] + bend[:, 2:]
    turn = (middle * both).sum(axis=1) / np.maximum((middle**2).sum(axis=1), 1e-300)
    left = both - turn[:, None] * middle
    power, unexplained = (bend**2).mean(axis=1), (left**2).mean(axis=1)
    beside = unexplained / (2.0 + 2.0 * (turn + 2.0) ** 2 + (2.0 * turn + 2.0) ** 2)
    line = unexplained < LINE**2 * power
    return np.asarray(np.where(line, np.minimum(power / 6.0, beside), power / 6.0))


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
