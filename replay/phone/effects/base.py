"""What an effect is: a named departure of a phone from an affine error and noise, switched on in its file.

Each effect is a small record whose name and parameters are those of a diagnosis, written in a phone file as
`[[effect]]` with `name = "..."`. It acts in one of three places: it changes a setting (range, lsb,
bandwidth, noise, clock), it disturbs the true input (lever arm, tones), or it adds a term to the output
before bandwidth, range and lsb are applied. Terms of different effects add up. The effects themselves
are in `effects_on_bias`, `effects_on_input` and `effects_on_settings`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.phone.heat import Surroundings
from stillcal.replay.phone.recursion import decaying
from stillcal.replay.phone.settings import (
    ClockSettings,
    SensorSettings,
    Settings,
    Vector,
)

Which = Literal["accel", "gyro", "both"]
SENSORS: dict[Which, tuple[Sensor, ...]] = {
    "accel": (Sensor.ACCELEROMETER,),
    "gyro": (Sensor.GYROSCOPE,),
    "both": (Sensor.ACCELEROMETER, Sensor.GYROSCOPE),
}


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """The true input of a sensor at n moments, body axes.

    t: (n,) s, true time. force m/s^2, rate rad/s, rate_dot rad/s^2: (n, 3), true. warmth: (n,) K over the
    reference temperature. charging: (n,) 0 or 1.
    """

    t: Array
    force: Array
    rate: Array
    rate_dot: Array
    warmth: Array
    charging: Array

    def felt_by(self, sensor: Sensor) -> Array:
        """Return the quantity that a sensor measures, (n, 3)."""
        return self.force if sensor is Sensor.ACCELEROMETER else self.rate


@dataclass(frozen=True, slots=True, eq=False)
class Circumstances:
    """The inputs of a term: the sensor's rate in Hz, the surroundings, and its own random generator."""

    rate_hz: float
    surroundings: Surroundings
    rng: np.random.Generator


Term = Callable[[Moment], Array]
"""Adds (n, 3), or something that broadcasts to it, in the sensor's unit; called on blocks in time order."""


class Effect(Settings, frozen=True, kw_only=True, tag_field="name"):
    """Base of all effects; it changes nothing itself."""

    sensors: ClassVar[tuple[Sensor, ...]] = ()
    of_whole_phone: ClassVar[bool] = False
    """Whether the input disturbed is the whole phone's: the other sensor's cross-sensitivities feel it."""
    needs_samples: ClassVar[bool] = False
    """Whether the effect lives on consecutive samples, so that a rest's mean alone cannot show it."""

    @property
    def name(self) -> str:
        """The effect's name in phone files and diagnoses."""
        return str(self.__struct_config__.tag)

    def concerns(self, sensor: Sensor) -> bool:
        """Whether the effect acts on a sensor's samples."""
        return sensor in self.sensors

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Return the sensor's settings with the effect in them."""
        return settings

    def on_clock(self, clock: ClockSettings) -> ClockSettings:
        """Return the clock's settings with the effect in them."""
        return clock

    def input_term(self, circumstances: Circumstances) -> Term | None:
        """Return what the effect adds to the true input, None for nothing."""
        return None

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term | None:
        """Return what the effect adds to the output, None for nothing."""
        return None


class OnAccel(Effect, frozen=True, kw_only=True):
    """Base of the effects on the accelerometer."""

    sensors: ClassVar[tuple[Sensor, ...]] = SENSORS["accel"]


class OnGyro(Effect, frozen=True, kw_only=True):
    """Base of the effects on the gyroscope."""

    sensors: ClassVar[tuple[Sensor, ...]] = SENSORS["gyro"]


class OnEither(Effect, frozen=True, kw_only=True):
    """Base of the effects on the sensor that the parameter `sensor` names."""

    sensor: Which = "both"

    def concerns(self, sensor: Sensor) -> bool:
        """Whether the effect acts on a sensor's samples."""
        return sensor in SENSORS[self.sensor]


def stretch(curve: Array, amplitude: Vector) -> Array:
    """Return a curve (n,) times a vector (3,), shape (n, 3)."""
    return np.outer(curve, amplitude)


class Smoother:
    """First-order low-pass of samples at a steady rate, carried from block to block."""

    def __init__(self, tau: float, rate_hz: float) -> None:
        self._keep = math.exp(-1.0 / (tau * rate_hz))
        self._last: Array | None = None

    def __call__(self, values: Array, initial: Array) -> Array:
        """Smooth the next (n, k) values; before the first of all, the output was `initial` (k,)."""
        last = initial if self._last is None else self._last
        smooth = decaying((1.0 - self._keep) * values, self._keep, last)
        self._last = smooth[-1]
        return smooth
