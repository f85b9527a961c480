"""A scenario with a phone: streams of samples and events, and the truth behind them.

Work is done in blocks of a fixed length of simulated time, so memory stays flat however long the
recording and the same seed gives the same bits however the stream is cut.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.phone.clock import BLOCK_S, StreamClock, Ticks
from stillcal.replay.phone.effects.base import Moment
from stillcal.replay.phone.heat import Heat
from stillcal.replay.phone.noise import seeded
from stillcal.replay.phone.phone import Phone
from stillcal.replay.phone.plan import Event, Plan, play
from stillcal.replay.phone.scenario import Scenario
from stillcal.replay.phone.sensor_chain import SensorChain
from stillcal.replay.phone.settings import SensorSettings


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """What the phone delivered up to a stamp of t_end s; gyroscope is None where the phone has none."""

    t_end: float
    accelerometer: Samples
    gyroscope: Samples | None
    events: tuple[Event, ...]


@dataclass(frozen=True, slots=True, eq=False)
class TrueModel:
    """A sensor's true affine model, raw = forward @ true + bias; scale @ (raw - bias) undoes it."""

    forward: Array
    scale: Array
    bias: Array


@dataclass(frozen=True, slots=True, eq=False)
class TrueInterval:
    """What was really going on, by the phone's own stamps, s.

    attitude: (3, 3) body to world at t_start; up: (3,) the world's up in body axes; gravity: m/s^2.
    """

    t_start: float
    t_end: float
    activity: str
    still: bool
    attitude: Array
    up: Array
    gravity: float


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """All that a recording does not say. gyroscope: None for a phone without one."""

    accelerometer: TrueModel
    gyroscope: TrueModel | None
    intervals: tuple[TrueInterval, ...]

    @property
    def rests(self) -> list[TrueInterval]:
        """The intervals in which the phone lay still."""
        return [i for i in self.intervals if i.still]


class Simulation:
    """One phone living through one scenario. Each call of `chunks` starts it over."""

    def __init__(self, scenario: Scenario, phone: Phone, seed: int) -> None:
        self.phone, self.seed = phone, seed
        self.plan: Plan = play(scenario, seed, phone.creep())
        self._clock = phone.effective_clock()
        self._heat = Heat(phone.heat, self.plan.surroundings)

    @property
    def duration(self) -> float:
        """Length by the phone's own clock, s."""
        return self.stamp(self.plan.duration)

    def stamp(self, t: float) -> float:
        """Return the phone's clock at a true time, both s."""
        return t * (1.0 + self._clock.skew)

    def temperature_at(self, t: Array) -> Array:
        """Return the true temperature in degC at true times (n,) s."""
        return self._heat.at(t)

    @cached_property
    def truth(self) -> Truth:
        """What the recording does not say."""
        gyro = self.phone.gyro
        return Truth(
            _true_model(self.phone.accel),
            None if gyro is None else _true_model(gyro),
            tuple(
                TrueInterval(
                    self.stamp(p.t_start),
                    self.stamp(min(p.t_end, self.plan.duration)),
                    p.activity,
                    p.still,
                    p.attitude,
                    p.attitude[2],
                    p.gravity,
                )
                for p in self.plan.pieces
            ),
        )

    def events(self) -> tuple[Event, ...]:
        """Return all events, by the phone's own clock."""
        return tuple(msgspec.structs.replace(e, t=self.stamp(e.t)) for e in self.plan.events)

    def chunks(self, seconds: float = BLOCK_S) -> Iterator[Chunk]:
        """Yield the recording in time order, cut every `seconds` of the phone's clock."""
        accel, gyro = Samples.empty(Sensor.ACCELEROMETER), Samples.empty(Sensor.GYROSCOPE)
        has_gyro, events = self.phone.gyro is not None, list(self.events())
        begin, t_end = -np.inf, 0.0
        for sure, more_accel, more_gyro in self._blocks():
            accel, gyro = _end_to_end([accel, more_accel]), _end_to_end([gyro, more_gyro])
            while t_end + seconds <= sure or (sure >= self.duration and t_end < self.duration):
                t_end += seconds
                now = tuple(e for e in events if e.t < t_end)
                del events[: len(now)]
                cut = (begin, t_end if t_end < self.duration else np.inf)
                begin = t_end
                yield Chunk(t_end, accel.between(*cut), gyro.between(*cut) if has_gyro else None, now)
            accel, gyro = accel.between(begin, np.inf), gyro.between(begin, np.inf)

    def whole(self) -> Chunk:
        """Return the whole recording at once."""
        parts = list(self.chunks())
        gyros = [c.gyroscope for c in parts if c.gyroscope is not None]
        return Chunk(
            self.duration,
            _end_to_end([c.accelerometer for c in parts]),
            _end_to_end(gyros) if gyros else None,
            self.events(),
        )

    def _blocks(self) -> Iterator[tuple[float, Samples, Samples]]:
        """Yield blocks of both streams with the stamp up to which nothing more can come."""
        accel = _Stream(self, Sensor.ACCELEROMETER, self.phone.accel.rate_hz)
        gyro = None if self.phone.gyro is None else _Stream(self, Sensor.GYROSCOPE, self._gyro_rate())
        shared, end = self._clock.shared, self.plan.duration
        for index in range(int(np.ceil(end / BLOCK_S))):
            ticks = accel.clock.block(index, end)
            moment = accel.moment(ticks)
            block, other = accel.read(ticks, moment), Samples.empty(Sensor.GYROSCOPE)
            if gyro is not None and shared:
                other = gyro.read(ticks, moment if self._clock.gyro_delay_s == 0.0 else gyro.moment(ticks))
            elif gyro is not None:
                ticks = gyro.clock.block(index, end)
                other = gyro.read(ticks, gyro.moment(ticks))
            done = (index + 1) * BLOCK_S
            sure = self.duration if done >= end else self.stamp(done) - 1.0 / self.phone.accel.rate_hz
            yield sure, block, other

    def _gyro_rate(self) -> float:
        gyro = self.phone.gyro
        return self.phone.accel.rate_hz if gyro is None or self._clock.shared else gyro.rate_hz


class _Stream:
    """One sensor's samples on their way out."""

    def __init__(self, simulation: Simulation, sensor: Sensor, rate_hz: float) -> None:
        phone, plan = simulation.phone, simulation.plan
        clock = phone.effective_clock()
        settings = phone.sensor(sensor)
        assert settings is not None, "a stream is made only for a sensor that the phone has"
        settings = msgspec.structs.replace(settings, rate_hz=rate_hz)
        self.clock = StreamClock(
            clock, rate_hz, plan.stressed, plan.suspended, seed=simulation.seed, stream=sensor
        )
        self._simulation, self._sensor = simulation, sensor
        self._delay = clock.gyro_delay_s if sensor is Sensor.GYROSCOPE else 0.0
        self._chain = SensorChain(sensor, settings, phone.effects, plan.surroundings, simulation.seed)
        self._thermometer = seeded(simulation.seed, sensor, "thermometer")

    def read(self, ticks: Ticks, moment: Moment) -> Samples:
        """Return what is delivered of one block."""
        if not ticks.t.size:
            return Samples.empty(self._sensor)
        raw, rows = self._chain.read(moment), ticks.rows
        reported = self._reported(moment.warmth + self._simulation.phone.heat.reference_c)
        return Samples(
            self._sensor,
            frozen(ticks.stamp[rows]),
            frozen(raw[rows]),
            None if reported is None else frozen(reported[rows]),
            frozen(ticks.arrival[rows]),
        )

    def moment(self, ticks: Ticks) -> Moment:
        """Return what the sensor can feel at the ticks, its delay allowed for."""
        plan, t = self._simulation.plan, ticks.t
        motion = plan.motion(t - self._delay)
        warmth = self._simulation.temperature_at(t) - self._simulation.phone.heat.reference_c
        return Moment(t, motion.force, motion.rate, motion.rate_dot, warmth, plan.surroundings.charging.at(t))

    def _reported(self, temperature: Array) -> Array | None:
        heat = self._simulation.phone.heat
        if not heat.thermometer or self._sensor is Sensor.GYROSCOPE:
            return None
        noise = heat.thermometer_noise_c
        if noise > 0.0:
            temperature = temperature + noise * self._thermometer.standard_normal(temperature.size)
        lsb = heat.thermometer_lsb_c
        return temperature if lsb == 0.0 else np.rint(temperature / lsb) * lsb


def _end_to_end(blocks: list[Samples]) -> Samples:
    """Join blocks, of which those without samples may lack the others' optional columns."""
    return Samples.joined([b for b in blocks if len(b)] or blocks[-1:])


def _true_model(settings: SensorSettings) -> TrueModel:
    forward = np.asarray(settings.scale)
    return TrueModel(frozen(forward), frozen(np.linalg.inv(forward)), frozen(settings.bias))


def simulate(scenario: Scenario, phone: Phone, seed: int = 0) -> Simulation:
    """Play a scenario out with a phone; nothing is sampled until it is asked for."""
    return Simulation(scenario, phone, seed)
