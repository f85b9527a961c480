"""A real recording's motion, simulated with another phone.

Rests are perfectly still in the attitudes measured; between them, the recorded motion is used. Temperature
and charging are the recorded ones. Time stamps, noise and effects are those of the simulated phone.
"""

from __future__ import annotations

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.streams.resample import interpolate, temperature_at
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.twin import AffinePhone, Conditions
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.clock import BLOCK_S, StreamClock, Ticks
from stillcal.replay.phone.effects.base import Moment
from stillcal.replay.phone.phone import Phone
from stillcal.replay.phone.sensor_chain import SensorChain


def resimulate(
    recording: Recording,
    bins: Bins,
    affine: AffinePhone,
    conditions: Conditions,
    phone: Phone,
    *,
    gravity: float,
    seed: int = 0,
) -> Recording:
    """Return what `phone` would have recorded. affine: the affine phone fitted to the recording."""
    accel = recording.accelerometer
    force = (accel.xyz - affine.baseline.bias) @ affine.baseline.scale.T
    motion = [_still(accel, bins, force, gravity * affine.baseline.up)]
    gyroscope = recording.gyroscope
    if gyroscope is not None:
        rate = gyroscope.xyz - affine.rate_bias
        motion.append(_still(gyroscope, bins, rate, np.zeros((len(bins), 3))))
    streams = [
        _stream(phone, conditions, sensor, (recording, motion), seed)
        for sensor in Sensor
        if sensor is Sensor.ACCELEROMETER or (gyroscope is not None and phone.gyro is not None)
    ]
    claims = recording.claims.without_counts()
    return Recording(streams[0], streams[1] if len(streams) > 1 else None, recording.events, claims, [])


def _still(samples: Samples, bins: Bins, values: Array, at_rest: Array) -> Array:
    """Return values (n, 3) with those inside still bins replaced by the bins' own (N, 3)."""
    first = np.searchsorted(samples.t, bins.t - bins.duration / 2)
    last = np.searchsorted(samples.t, bins.t + bins.duration / 2)
    out = values.copy()
    rows = np.repeat(np.arange(len(bins)), np.maximum(last - first, 0))
    starts = np.repeat(first - np.concatenate([[0], np.cumsum(last - first)[:-1]]), last - first)
    out[np.arange(rows.size) + starts] = at_rest[rows]
    return out


def _ticks(phone: Phone, sensor: Sensor, rate_hz: float, duration: float, seed: int) -> Ticks:
    """Return all moments at which a stream is sampled, in true time from 0."""
    clock = StreamClock(phone.effective_clock(), rate_hz, (), (), seed=seed, stream=sensor)
    blocks = [clock.block(i, duration) for i in range(int(np.ceil(duration / BLOCK_S)))]
    ends = np.cumsum([0, *(b.t.size for b in blocks)])
    return Ticks(
        np.concatenate([b.t for b in blocks]),
        np.concatenate([b.stamp for b in blocks]),
        np.concatenate([b.arrival for b in blocks]),
        np.concatenate([b.rows + start for b, start in zip(blocks, ends, strict=False)]),
    )


def _stream(
    phone: Phone, conditions: Conditions, sensor: Sensor, recorded: tuple[Recording, list[Array]], seed: int
) -> Samples:
    recording, motion = recorded
    settings, clock = phone.sensor(sensor), phone.effective_clock()
    assert settings is not None, "a stream is made only for a sensor that the phone has"
    settings = msgspec.structs.replace(
        settings, rate_hz=phone.accel.rate_hz if clock.shared else settings.rate_hz
    )
    accel = recording.accelerometer
    ticks = _ticks(phone, sensor, settings.rate_hz, float(accel.t[-1] - accel.t[0]), seed)
    delay = clock.gyro_delay_s if sensor is Sensor.GYROSCOPE else 0.0
    moment, temperature = _moment(conditions, recording, motion, ticks.t, delay)
    raw = SensorChain(sensor, settings, phone.effects, conditions.surroundings, seed).read(moment)
    rows = ticks.rows
    warm = None if temperature is None or sensor is Sensor.GYROSCOPE else frozen(temperature[rows])
    arrival = None if accel.t_arrival is None else frozen(ticks.arrival[rows] + conditions.t_start)
    return Samples(sensor, frozen(ticks.stamp[rows] + conditions.t_start), frozen(raw[rows]), warm, arrival)


def _moment(
    conditions: Conditions, recording: Recording, motion: list[Array], t: Array, delay: float
) -> tuple[Moment, Array | None]:
    """Return the true input at true times (n,) s since the start, and the temperature, degC."""
    accel, at = recording.accelerometer, t + conditions.t_start - delay
    force = interpolate(at, accel.t, motion[0])
    gyroscope = recording.gyroscope
    rate = np.zeros_like(force) if gyroscope is None else interpolate(at, gyroscope.t, motion[1])
    temperature = temperature_at(accel, t + conditions.t_start)
    warmth = np.zeros(t.size) if temperature is None else temperature - conditions.reference_c
    dot = np.gradient(rate, t, axis=0)
    return Moment(t, force, rate, dot, warmth, conditions.surroundings.charging.at(t)), temperature
