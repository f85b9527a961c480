"""A real recording's motion, simulated with another phone.

Rests are perfectly still in the attitudes measured; between them, the recorded motion is used. Temperature
and charging are the recorded ones. Time stamps, noise and effects are those of the simulated phone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.streams.resample import interpolate, median_rate_hz, temperature_at
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.twin import AffinePhone, Conditions, effects_output, observable
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.clock import BLOCK_S, StreamClock, Ticks
from stillcal.replay.phone.effects.base import Effect, Moment
from stillcal.replay.phone.phone import Phone
from stillcal.replay.phone.sensor_chain import SensorChain

SLOWEST = 0.05
"""Rates below this, rad/s, are noise at rest, which acts through no lever arm and no nonlinearity."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What a phone truly did. force_t: (n,) s with force (n, 3) m/s^2; rate_t: (m,) s with rate (m, 3) rad/s.

    rate_t and rate are None without a gyroscope.
    """

    force_t: Array
    force: Array
    rate_t: Array | None = None
    rate: Array | None = None


def motion_of(
    recording: Recording,
    bins: Bins,
    affine: AffinePhone,
    effects: Sequence[Effect],
    conditions: Conditions,
    *,
    gravity: float,
) -> Motion:
    """Return the motion behind a recording: free of its constant errors and of the effects found in it.

    In static bins the phone is perfectly still in the attitude measured there. effects: a delay of the
    gyroscope is taken back, and what the others add, as far as it follows from the recording, taken off.
    """
    accel, gyroscope = recording.accelerometer, recording.gyroscope
    delay = sum(float(getattr(e, "delay", 0.0)) for e in effects if e.name == "accel_gyro_time_offset")
    force = affine.true_force(accel.xyz)
    rate_t = None if gyroscope is None else gyroscope.t - delay
    rate = None if gyroscope is None else affine.true_rate(gyroscope.xyz)
    raw = Motion(accel.t, force, rate_t, rate)
    known = [e for e in effects if observable(e)]
    if known:
        added = _added(
            known, Sensor.ACCELEROMETER, moment_of(recording, raw, conditions, accel.t), recording, conditions
        )
        force = affine.true_force(accel.xyz - added)
        if gyroscope is not None and rate_t is not None:
            added = _added(
                known, Sensor.GYROSCOPE, moment_of(recording, raw, conditions, rate_t), recording, conditions
            )
            rate = affine.true_rate(gyroscope.xyz - added)
    force = _still(accel, bins, force, gravity * affine.baseline.up)
    if gyroscope is not None and rate is not None:
        rate = _still(gyroscope, bins, rate, np.zeros((len(bins), 3)))
    return Motion(accel.t, force, rate_t, rate)


def _added(
    effects: Sequence[Effect], sensor: Sensor, raw: Moment, recording: Recording, conditions: Conditions
) -> Array:
    """Return what effects added to a sensor's samples (n, 3)."""
    moment = raw
    turning = np.linalg.norm(moment.rate, axis=1, keepdims=True) > SLOWEST
    moment = replace(moment, rate=moment.rate * turning, rate_dot=moment.rate_dot * turning)
    rate_hz = median_rate_hz(recording.accelerometer)
    return effects_output(effects, sensor, moment, conditions, rate_hz)


def moment_of(recording: Recording, motion: Motion, conditions: Conditions, at: Array) -> Moment:
    """Return the true input at the recording's times (n,) s, which need not rise everywhere."""
    force = interpolate(at, motion.force_t, motion.force)
    rate = np.zeros_like(force)
    if motion.rate_t is not None and motion.rate is not None:
        rate = interpolate(at, motion.rate_t, motion.rate)
    temperature = temperature_at(recording.accelerometer, at)
    warmth = np.zeros(at.size) if temperature is None else temperature - conditions.reference_c
    # Stamps may repeat; a derivative by time must not divide by nothing.
    rising = np.maximum.accumulate(at) + 1e-9 * np.arange(at.size)
    since = at - conditions.t_start
    charging = conditions.surroundings.charging.at(since)
    return Moment(since, force, rate, np.gradient(rate, rising, axis=0), warmth, charging)


def resimulate(
    recording: Recording, motion: Motion, conditions: Conditions, phone: Phone, *, seed: int = 0
) -> Recording:
    """Return what `phone` would have recorded of a motion in the conditions of a recording."""
    sensors = [Sensor.ACCELEROMETER]
    if recording.gyroscope is not None and phone.gyro is not None:
        sensors.append(Sensor.GYROSCOPE)
    streams = [_stream(phone, conditions, sensor, (recording, motion), seed) for sensor in sensors]
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
    phone: Phone, conditions: Conditions, sensor: Sensor, recorded: tuple[Recording, Motion], seed: int
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
    true = ticks.t + conditions.t_start
    late = moment_of(recording, motion, conditions, true - delay)
    temperature = temperature_at(accel, true)
    warmth = late.warmth if temperature is None else temperature - conditions.reference_c
    moment = replace(late, t=ticks.t, warmth=warmth, charging=conditions.surroundings.charging.at(ticks.t))
    raw = SensorChain(sensor, settings, phone.effects, conditions.surroundings, seed).read(moment)
    rows = ticks.rows
    warm = None if temperature is None or sensor is Sensor.GYROSCOPE else frozen(temperature[rows])
    arrival = None if accel.t_arrival is None else frozen(ticks.arrival[rows] + conditions.t_start)
    return Samples(sensor, frozen(ticks.stamp[rows] + conditions.t_start), frozen(raw[rows]), warm, arrival)
