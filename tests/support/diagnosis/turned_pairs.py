"""A recording and a simulation of one motion: a phone that rests and is turned by hand in between."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.signal import butter, lfilter
from scipy.spatial.transform import Rotation

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording

RATE = 25.0
REST, TURN = 18.0, 6.0
"""s at rest, and s of each turn."""

Flaw = Callable[[Array, Array], tuple[Array, Array]]
"""What a flawed device reads of true force and rate (n, 3)."""


def perfect(force: Array, rate: Array) -> tuple[Array, Array]:
    """Return what a device without a flaw reads."""
    return force, rate


def turned(
    seed: int, flaw: Flaw = perfect, *, turns: int = 12, rest: float = REST, motion: int = 0
) -> Recording:
    """Return a recording with `turns` turns, `rest` s apart.

    seed: of its noise; motion: of how the phone is turned.
    """
    t = np.arange(0.0, turns * (rest + TURN) + rest, 1.0 / RATE)
    force, rate = flaw(*_motion(t, turns, rest, motion))
    rng = np.random.default_rng(seed)
    accel = force + rng.normal(0.0, 0.008, force.shape)
    gyro = rate + rng.normal(0.0, 5e-4, rate.shape)
    return Recording(
        Samples(Sensor.ACCELEROMETER, frozen(t), frozen(accel)),
        Samples(Sensor.GYROSCOPE, frozen(t), frozen(gyro)),
        [], Claims(), [], name=f"{seed}.csv",
    )  # fmt: skip


def low_passed(samples: Samples, cutoff: float, order: int = 2) -> Samples:
    """Return what a Butterworth filter, of the second order by default, leaves. cutoff: part of the rate."""
    return replace(samples, xyz=frozen(lfilter(*butter(order, 2.0 * cutoff), samples.xyz, axis=0)))


def _motion(t: Array, turns: int, rest: float, seed: int) -> tuple[Array, Array]:
    """Return specific force and rate (n, 3): each turn ends in another attitude, and shakes on its way."""
    rng = np.random.default_rng(seed)
    angles, push = np.zeros((t.size, 3)), np.zeros((t.size, 3))
    for k in range(turns):
        part = np.clip((t - rest - k * (rest + TURN)) / TURN, 0.0, 1.0)
        angles += np.outer(part**3 * (10.0 - 15.0 * part + 6.0 * part**2), rng.uniform(-2.0, 2.0, 3))
        lively = (16.0 * (part * (1.0 - part)) ** 2)[:, None]
        phase = rng.uniform(0.0, 6.0, (2, 3))
        angles += 0.2 * lively * np.sin(2.0 * np.pi * 0.9 * t[:, None] + phase[0])
        push += lively * np.sin(2.0 * np.pi * 1.7 * t[:, None] + phase[1])
    attitude = Rotation.from_euler("ZYX", angles)
    step = (attitude[:-1].inv() * attitude[1:]).as_rotvec() * RATE
    rate = np.concatenate([step[:1], (step[1:] + step[:-1]) / 2.0, step[-1:]])
    return attitude.inv().apply(push + np.array([0.0, 0.0, 9.80665])), rate
