"""A real recording's motion, simulated with another phone.

Rests are perfectly still in the attitudes measured; between them, the recorded motion is used. Temperature
and charging are the recorded ones. Time stamps, noise and effects are those of the simulated phone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.windows import WINDOW
from stillcal.calib_core.diagnosis.sequence.findings import still_rows
from stillcal.calib_core.maths.sines import without_vibrations
from stillcal.calib_core.streams.resample import interpolate, median_rate_hz, temperature_at
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.condense import Condenser, LongRecording, overview_of
from stillcal.replay.diagnosis.phone.twin import (
    AffinePhone,
    Conditions,
    effects_output,
    observable,
    skew_of,
)
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone.clock import BLOCK_S, StreamClock, Ticks
from stillcal.replay.phone.effects.base import Effect, Moment
from stillcal.replay.phone.effects.on_input import VibrationTone
from stillcal.replay.phone.phone import Phone
from stillcal.replay.phone.sensor_chain import SensorChain

Flags = NDArray[np.bool_]

AT_LIMIT, BEYOND = 0.99, 1.1
"""Part of a sensor's limit from which a value stands for a larger one, and how many times larger it is taken:
enough for the simulated sensor to stop at the limit as well. How large it was nothing tells."""

ROUNDS, SETTLED = 12, 1e-4
"""Times at most that effects are taken at the motion without them, and by which part of its largest what they
add changes at last. One that grows by a tenth of what it acts on has settled after four."""

LEAST_STEP = 0.25
"""Part of a step that is taken at least, where what is added goes to and fro: it grows by up to three times
of what it acts on, as the cube of a rate that reads twice as large."""

SLOWEST = 0.05
"""Rates below this, rad/s, are noise at rest, which acts through no lever arm and no nonlinearity."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What a phone truly did. force_t: (n,) s with force (n, 3) m/s^2; rate_t: (m,) s with rate (m, 3) rad/s.

    Times are true ones from the first stamp on, which a clock that is fast shows later.

    rate_t and rate are None without a gyroscope. steady: of a long recording, whose motion is not
    known everywhere, the [first, last) windows of `WINDOW` s in which the phone is still.
    """

    force_t: Array
    force: Array
    rate_t: Array | None = None
    rate: Array | None = None
    steady: tuple[tuple[int, int], ...] = ()


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
    gyroscope and a clock's error are taken back, what stopped at a limit goes on beyond it, a vibration is
    taken off as the bins show it, and what the others add, as far as it follows from the recording.
    """
    recording = _without_tones(recording, bins, effects, conditions)
    accel, gyroscope = recording.accelerometer, recording.gyroscope
    moved = _without(recording, affine, effects, added_to(recording, affine, effects, conditions))
    at_rest, still = gravity * affine.baseline.up, np.zeros((len(bins), 3))
    force, rate_t, rate = _still(accel, bins, moved.force, at_rest), moved.rate_t, moved.rate
    if gyroscope is not None and rate is not None:
        rate = _still(gyroscope, bins, rate, still)

    def true(t: Array) -> Array:
        return conditions.t_start + (t - conditions.t_start) / (1.0 + skew_of(effects))

    if not isinstance(recording, LongRecording):
        return Motion(true(accel.t), force, None if rate_t is None else true(rate_t), rate)
    force_t, force = _with_bins(accel.t, force, bins, at_rest)
    if rate_t is not None and rate is not None:
        rate_t, rate = _with_bins(rate_t, rate, bins, still)
    middle, half = (bins.t - bins.span[0]) / WINDOW, bins.duration / 2.0 / WINDOW
    edges = np.rint(np.stack([middle - half, middle + half], axis=1)).astype(int).tolist()
    steady = tuple((a, b) for a, b in edges)
    return Motion(true(force_t), force, None if rate_t is None else true(rate_t), rate, steady)


def added_to(
    recording: Recording, affine: AffinePhone, effects: Sequence[Effect], conditions: Conditions
) -> tuple[Array, Array | None]:
    """Return what the effects added to the accelerometer's samples (n, 3) and to the gyroscope's (m, 3).

    They go with the true input, which is what is left without them: each round takes them at what the one
    before left.
    """
    known = [e for e in effects if observable(e)]
    accel = _Settling(np.zeros_like(recording.accelerometer.xyz))
    gyro = None if recording.gyroscope is None else _Settling(np.zeros_like(recording.gyroscope.xyz))
    for _ in range(ROUNDS if known else 0):
        motion = _without(recording, affine, effects, (accel.value, None if gyro is None else gyro.value))
        moment = moment_of(recording, motion, conditions, motion.force_t)
        settled = accel.approach(_added(known, Sensor.ACCELEROMETER, moment, recording, conditions))
        if gyro is not None and motion.rate_t is not None:
            moment = moment_of(recording, motion, conditions, motion.rate_t)
            settled &= gyro.approach(_added(known, Sensor.GYROSCOPE, moment, recording, conditions))
        if settled:
            break
    return accel.value, None if gyro is None else gyro.value


class _Settling:
    """What effects add, which depends on itself: the solution of value = f(value), number by number.

    Where f falls steeply, value goes to and fro and away. A secant's step, shorter than that to f, goes on
    from the last two rounds.
    """

    def __init__(self, value: Array) -> None:
        self.value = value
        self._moved = self._away = np.zeros_like(value)

    def approach(self, then: Array) -> bool:
        """Go towards f(value), `then`; return whether the value has settled."""
        away = then - self.value
        fallen = self._away - away
        known = (self._moved != 0.0) & (fallen != 0.0)
        slope = np.divide(self._moved, fallen, out=np.ones_like(away), where=known)
        self._moved, self._away = np.clip(slope, LEAST_STEP, 1.0) * away, away
        self.value = self.value + self._moved
        return bool(np.abs(away).max(initial=0.0) <= SETTLED * np.abs(then).max(initial=0.0))


def _without(
    recording: Recording, affine: AffinePhone, effects: Sequence[Effect], added: tuple[Array, Array | None]
) -> Motion:
    """Return the motion behind the samples without what was added to them, by the device's clock."""
    accel, gyroscope = _unlimited(recording.accelerometer, effects), recording.gyroscope
    force = affine.true_force(accel.xyz - added[0])
    if gyroscope is None or added[1] is None:
        return Motion(accel.t, force)
    delay = sum(float(getattr(e, "delay", 0.0)) for e in effects if e.name == "accel_gyro_time_offset")
    rate = affine.true_rate(_unlimited(gyroscope, effects).xyz - added[1])
    return Motion(accel.t, force, gyroscope.t - delay, rate)


def _without_tones(
    recording: Recording, bins: Bins, effects: Sequence[Effect], conditions: Conditions
) -> Recording:
    """Return a recording without the vibrations found, which a phone that has them adds anew.

    Else they would be there twice where the phone moves, in another phase than a rest's end has.
    """
    tones = [e for e in effects if isinstance(e, VibrationTone)]

    def bare(samples: Samples) -> Samples:
        xyz, since = samples.xyz, samples.t - conditions.t_start
        for tone in tones:
            there = (since >= tone.start_s) & (since < tone.start_s + tone.duration_s)
            if tone.concerns(samples.sensor) and there.any():
                still = still_rows(samples.t, bins)[there]
                xyz = xyz.copy()
                xyz[there] = without_vibrations(xyz[there], samples.t[there], [tone.frequency], still)
        return replace(samples, xyz=frozen(xyz))

    gyroscope = recording.gyroscope
    return replace(
        recording,
        accelerometer=bare(recording.accelerometer),
        gyroscope=None if gyroscope is None else bare(gyroscope),
    )


def _unlimited(samples: Samples, effects: Sequence[Effect]) -> Samples:
    """Return samples whose values at a limit that was found lie beyond it, as the true ones did."""
    own = [e for e in effects if e.name.endswith("_saturation") and e.concerns(samples.sensor)]
    if not own:
        return samples
    limit = AT_LIMIT * min(float(getattr(e, "limit", np.inf)) for e in own)
    xyz = samples.xyz
    return replace(samples, xyz=frozen(np.where(np.abs(xyz) >= limit, BEYOND * xyz, xyz)))


def _with_bins(t: Array, values: Array, bins: Bins, at_rest: Array) -> tuple[Array, Array]:
    """Return a course (n, 3) at t (n,) with the bins' ends in it, between which it is steady."""
    ends = np.concatenate([bins.t - bins.duration / 2.0, bins.t + bins.duration / 2.0])
    times = np.concatenate([t, ends])
    order = np.argsort(times, kind="stable")
    return times[order], np.concatenate([values, at_rest, at_rest])[order]


def _added(
    effects: Sequence[Effect], sensor: Sensor, raw: Moment, recording: Recording, conditions: Conditions
) -> Array:
    """Return what effects added to a sensor's samples (n, 3)."""
    moment = _turning(raw)
    rate_hz = median_rate_hz(recording.accelerometer)
    return effects_output(effects, sensor, moment, conditions, rate_hz)


def _turning(moment: Moment) -> Moment:
    """Return the true input without rates that are noise at rest."""
    turns = np.linalg.norm(moment.rate, axis=1, keepdims=True) > SLOWEST
    return replace(moment, rate=moment.rate * turns, rate_dot=moment.rate_dot * turns)


def moment_of(recording: Recording, motion: Motion, conditions: Conditions, at: Array) -> Moment:
    """Return the true input at the recording's times (n,) s, which need not rise everywhere."""
    force = interpolate(at, motion.force_t, motion.force)
    rate = np.zeros_like(force)
    if motion.rate_t is not None and motion.rate is not None:
        rate = interpolate(at, motion.rate_t, motion.rate)
    temperature = _temperature_at(recording, at)
    warmth = np.zeros(at.size) if temperature is None else temperature - conditions.reference_c
    # Stamps may repeat; a derivative by time must not divide by nothing.
    rising = np.maximum.accumulate(at) + 1e-9 * np.arange(at.size)
    since = at - conditions.t_start
    charging = conditions.surroundings.charging.at(since)
    # A block of a long recording may have one moment in a part whose motion is known.
    rate_dot = np.gradient(rate, rising, axis=0) if at.size > 1 else np.zeros_like(rate)
    return Moment(since, force, rate, rate_dot, warmth, charging)


def resimulate(
    recording: Recording, motion: Motion, conditions: Conditions, phone: Phone, *, seed: int = 0
) -> Recording:
    """Return what `phone` would have recorded of a motion in the conditions of a recording."""
    sensors = [Sensor.ACCELEROMETER]
    if recording.gyroscope is not None and phone.gyro is not None:
        sensors.append(Sensor.GYROSCOPE)
    played = [_Played(phone, conditions, sensor, (recording, motion), seed) for sensor in sensors]
    about = Recording(
        Samples.empty(Sensor.ACCELEROMETER),
        Samples.empty(Sensor.GYROSCOPE) if len(played) > 1 else None,
        recording.events,
        recording.claims.without_counts(),
        [],
    )
    if isinstance(recording, LongRecording) and recording.kept is not None:
        return _in_blocks(played, recording, motion, recording.kept, about)
    streams = [one.read(one.ticks()) for one in played]
    return replace(about, accelerometer=streams[0], gyroscope=streams[1] if len(streams) > 1 else None)


def _in_blocks(
    played: Sequence[_Played], recording: LongRecording, motion: Motion, kept: Flags, about: Recording
) -> Recording:
    """Return the same of a long recording, block by block and as far as its motion is known.

    kept: (n,) its windows whose samples are held. The same windows' samples are held of what is played.
    """
    known = kept.copy()
    for first, last in motion.steady:
        known[first:last] = True
    condenser = Condenser(keep=kept)
    for index in range(played[0].blocks()):
        streams = [one.read(_within(one.ticks(index), known)) for one in played]
        streams += [Samples.empty(Sensor.GYROSCOPE)] * (2 - len(streams))
        condenser.add(*streams)
    return condenser.recording(about)


def _within(ticks: Ticks, known: Flags) -> Ticks:
    """Return the ticks that lie in windows (n,) where `known`."""
    window = np.clip((ticks.stamp / WINDOW).astype(np.int64), 0, known.size - 1)
    there = known[window]
    rows = (np.cumsum(there) - 1)[ticks.rows[there[ticks.rows]]]
    return Ticks(ticks.t[there], ticks.stamp[there], ticks.arrival[there], rows)


def _still(samples: Samples, bins: Bins, values: Array, at_rest: Array) -> Array:
    """Return values (n, 3) with those inside still bins replaced by the bins' own (N, 3)."""
    first = np.searchsorted(samples.t, bins.t - bins.duration / 2)
    last = np.searchsorted(samples.t, bins.t + bins.duration / 2)
    out = values.copy()
    rows = np.repeat(np.arange(len(bins)), np.maximum(last - first, 0))
    starts = np.repeat(first - np.concatenate([[0], np.cumsum(last - first)[:-1]]), last - first)
    out[np.arange(rows.size) + starts] = at_rest[rows]
    return out


class _Played:
    """One sensor of a phone that is played through a motion; blocks are asked for in order."""

    def __init__(
        self,
        phone: Phone,
        conditions: Conditions,
        sensor: Sensor,
        recorded: tuple[Recording, Motion],
        seed: int,
    ) -> None:
        settings, clock = phone.sensor(sensor), phone.effective_clock()
        assert settings is not None, "a stream is made only for a sensor that the phone has"
        settings = msgspec.structs.replace(
            settings, rate_hz=phone.accel.rate_hz if clock.shared else settings.rate_hz
        )
        self._recording, self._motion = recorded
        self._conditions, self._sensor = conditions, sensor
        self._duration = float(self._motion.force_t[-1] - self._motion.force_t[0])
        self._clock = StreamClock(clock, settings.rate_hz, (), (), seed=seed, stream=sensor)
        self._delay = clock.gyro_delay_s if sensor is Sensor.GYROSCOPE else 0.0
        self._chain = SensorChain(sensor, settings, phone.effects, conditions.surroundings, seed)

    def blocks(self) -> int:
        """Return how many blocks of `BLOCK_S` there are."""
        return int(np.ceil(self._duration / BLOCK_S))

    def ticks(self, index: int | None = None) -> Ticks:
        """Return the moments of a block, or all moments, at which the stream is sampled, true time from 0."""
        if index is not None:
            return self._clock.block(index, self._duration)
        blocks = [self._clock.block(i, self._duration) for i in range(self.blocks())]
        ends = np.cumsum([0, *(b.t.size for b in blocks)])
        return Ticks(
            np.concatenate([b.t for b in blocks]),
            np.concatenate([b.stamp for b in blocks]),
            np.concatenate([b.arrival for b in blocks]),
            np.concatenate([b.rows + start for b, start in zip(blocks, ends, strict=False)]),
        )

    def read(self, ticks: Ticks) -> Samples:
        """Return what is delivered of these moments."""
        if not ticks.t.size:
            return Samples.empty(self._sensor)
        recording, conditions, accel = self._recording, self._conditions, self._recording.accelerometer
        true = ticks.t + conditions.t_start
        late = moment_of(recording, self._motion, conditions, true - self._delay)
        temperature = _temperature_at(recording, true)
        warmth = late.warmth if temperature is None else temperature - conditions.reference_c
        charging = conditions.surroundings.charging.at(ticks.t)
        moment = replace(late, t=ticks.t, warmth=warmth, charging=charging)
        # What no lever arm took off the recorded force, none may add to it.
        moment = moment if self._sensor is Sensor.GYROSCOPE else _turning(moment)
        raw, rows = self._chain.read(moment), ticks.rows
        warm = None if temperature is None or self._sensor is Sensor.GYROSCOPE else frozen(temperature[rows])
        arrival = None if accel.t_arrival is None else frozen(ticks.arrival[rows] + conditions.t_start)
        stamps = frozen(ticks.stamp[rows] + conditions.t_start)
        return Samples(self._sensor, stamps, frozen(raw[rows]), warm, arrival)


def _temperature_at(recording: Recording, t: Array) -> Array | None:
    """Return the temperature at t (n,) s; of a long recording by the second."""
    overview = overview_of(recording)
    if overview is None:
        return temperature_at(recording.accelerometer, t)
    return None if overview.thermometer is None else np.interp(t, *overview.thermometer.T)
