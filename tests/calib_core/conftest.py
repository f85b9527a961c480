"""Streams of a phone at rest and in motion, with known truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from stillcal.calib_core.streams.samples import Samples, Sensor

G = 9.80665


@dataclass
class Bench:
    """Accelerometer and gyroscope of one simulated phone. Rates Hz, noise SI per sample, durations s."""

    rng: np.random.Generator
    accel_rate: float = 50.0
    gyro_rate: float = 50.0
    accel_noise: float = 0.02
    gyro_noise: float = 0.002
    gyro_bias: tuple[float, float, float] = (0.01, -0.02, 0.005)
    t: float = 0.0
    force: list = field(default_factory=list)
    rate: list = field(default_factory=list)

    def add(self, duration: float, force: Callable, rate: Callable, noise: float = 1.0) -> Bench:
        """Append `duration` of force(t) and rate(t), (n, 3) of time since the part began, with noise."""
        parts = (
            (self.force, self.accel_rate, self.accel_noise, force),
            (
                self.rate,
                self.gyro_rate,
                self.gyro_noise,
                rate,
            ),
        )
        for store, hz, sd, function in parts:
            t = np.arange(round(duration * hz)) / hz
            store.append((self.t + t, function(t) + self.rng.normal(0, sd * noise, (t.size, 3))))
        self.t += duration
        return self

    def still(self, duration: float, up=(0.0, 0.0, 1.0), noise: float = 1.0) -> Bench:
        """Append a rest with the axis `up` upwards."""
        force = G * np.asarray(up) / np.linalg.norm(up)
        return self.add(duration, lambda t: np.tile(force, (t.size, 1)), self._bias, noise)

    def shaking(self, duration: float, force: float = 2.0, rate: float = 1.0, hz: float = 2.0) -> Bench:
        """Append motion: a swing of `hz` with the given amplitudes, as in walking."""
        phase = self.rng.uniform(0, 2 * np.pi, 3)

        def swing(t):
            return np.sin(2 * np.pi * hz * t[:, None] + phase)

        return self.add(
            duration,
            lambda t: np.array([0, 0, G]) + force * swing(t),
            lambda t: self._bias(t) + rate * swing(t),
        )

    def pause(self, duration: float) -> Bench:
        """Append nothing."""
        self.t += duration
        return self

    def _bias(self, t):
        return np.tile(np.asarray(self.gyro_bias), (t.size, 1))

    @property
    def accel(self) -> Samples:
        """The accelerometer's stream."""
        t, xyz = (np.concatenate(column) for column in zip(*self.force, strict=True))
        return Samples.checked(Sensor.ACCELEROMETER, t, xyz)

    @property
    def gyro(self) -> Samples:
        """The gyroscope's stream."""
        t, xyz = (np.concatenate(column) for column in zip(*self.rate, strict=True))
        return Samples.checked(Sensor.GYROSCOPE, t, xyz)


@pytest.fixture
def bench() -> Callable[..., Bench]:
    """A maker of benches: bench(seed, **fields)."""
    return lambda seed=0, **fields: Bench(np.random.default_rng(seed), **fields)
