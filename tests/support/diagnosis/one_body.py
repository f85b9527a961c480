"""Sensors on one moving body: turned, late, with a clock of their own, with or without a drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording

RATE, LENGTH = 25.0, 480.0
"""Hz, and s of a recording."""

REST, MOVE = 16.0, 8.0
"""s at rest, and s in motion after each."""

STEP = 1e-3
"""s, of the differences that give the rate of turn."""

UPRIGHT = Rotation.identity()


@dataclass(frozen=True, slots=True)
class Body:
    """A body that moves for a while, rests, and moves on. While it moves each coordinate is a sum of sines.

    seed: of its motion.
    """

    seed: int = 0

    def sensed(self, t: Array) -> tuple[Array, Array]:
        """Return specific force and rate of turn (n, 3) in the body's axes at true times (n,), s."""
        before, now, after = (self._attitude(t + shift) for shift in (-STEP, 0.0, STEP))
        rate = (before.inv() * after).as_rotvec() / (2.0 * STEP)
        part = np.clip((t % (REST + MOVE) - REST) / MOVE, 0.0, 1.0)
        push = self._course(t, 7, 1.5) * np.sin(np.pi * part)[:, None] ** 2
        return now.inv().apply(push + np.array([0.0, 0.0, 9.80665])), np.asarray(rate)

    def _attitude(self, t: Array) -> Rotation:
        part = np.clip((t % (REST + MOVE) - REST) / MOVE, 0.0, 1.0)
        gone = np.floor(t / (REST + MOVE)) + part - np.sin(2.0 * np.pi * part) / (2.0 * np.pi)
        return Rotation.from_euler("ZYX", self._course(MOVE * gone, 3, 0.4))

    def _course(self, t: Array, which: int, fastest: float) -> Array:
        """Return three courses (n, 3) of unit size, of frequencies up to `fastest`, Hz."""
        rng = np.random.default_rng([self.seed, which])
        frequency, phase = rng.uniform(0.02, fastest, (3, 12)), rng.uniform(0.0, 2.0 * np.pi, (3, 12))
        size = 0.4 / np.sqrt(1.0 + (frequency / 0.3) ** 2)
        return np.asarray((size * np.sin(2.0 * np.pi * t[:, None, None] * frequency + phase)).sum(axis=2))


def sensor(
    seed: int,
    name: str = "real.csv",
    *,
    body: Body = Body(),
    turned: Rotation = UPRIGHT,
    late: float = 0.0,
    ppm: float = 0.0,
    drift: Array | None = None,
    arm: Array | None = None,
    rate: float = RATE,
    length: float = LENGTH,
) -> Recording:
    """Return what a sensor on a body recorded.

    seed: of its noise and its constant biases. turned: takes its axes to the body's. Its stamps are `late` s
    behind and its clock is fast by `ppm`. drift: (3,) rad/s, by which its gyroscope's bias rises and falls in
    its own axes, as a body that warms and cools one and a half times. arm: (3,) m, of the body, where it is.
    """
    rng = np.random.default_rng([seed, 99])
    t = np.arange(0.0, length, 1.0 / rate)
    true = (t - late) / (1.0 + 1e-6 * ppm)
    force, turn = body.sensed(true)
    if arm is not None:
        grows = (body.sensed(true + STEP)[1] - body.sensed(true - STEP)[1]) / (2.0 * STEP)
        force = force + np.cross(turn, np.cross(turn, arm)) + np.cross(grows, arm)
    force, turn = turned.inv().apply(force), turned.inv().apply(turn)
    turn = turn + rng.normal(0.0, 3e-3, 3) + rng.normal(0.0, 1e-3, turn.shape)
    force = force + rng.normal(0.0, 0.05, 3) + rng.normal(0.0, 0.01, force.shape)
    if drift is not None:
        turn = turn + np.outer(course(t / length), drift)
    return Recording(
        Samples(Sensor.ACCELEROMETER, frozen(t), frozen(force)),
        Samples(Sensor.GYROSCOPE, frozen(t), frozen(turn)),
        [], Claims(), [], name=name,
    )  # fmt: skip


def spun(axis: Array, seed: int, turned: Rotation = UPRIGHT) -> Recording:
    """Return what a sensor recorded on a body that turns about one axis (3,) only.

    seed: of its noise; turned: takes its axes to the body's.
    """
    t, rng = np.arange(0.0, LENGTH, 1.0 / RATE), np.random.default_rng(seed)
    angle = np.sin(0.3 * t) + 0.5 * np.sin(0.77 * t + 1.0) + 0.3 * np.sin(2.1 * t)
    force = Rotation.from_rotvec(np.outer(angle, axis)).inv().apply([0.0, 0.0, 9.80665])
    force, rate = (turned.inv().apply(x) for x in (force, np.outer(np.gradient(angle, t), axis)))
    return Recording(
        Samples(Sensor.ACCELEROMETER, frozen(t), frozen(force + rng.normal(0.0, 0.01, force.shape))),
        Samples(Sensor.GYROSCOPE, frozen(t), frozen(rate + rng.normal(0.0, 1e-3, rate.shape))),
        [], Claims(), [], name=f"{seed}.csv",
    )  # fmt: skip


def course(part: Array) -> Array:
    """Return how a drift goes, -1 to 1, over the part (n,) of the recording that has passed."""
    return np.asarray(np.sin(3.0 * np.pi * part))
