"""Where up is, in the axes of a phone that is turned: for phones that are played from their rates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stillcal.calib_core.streams.samples import Samples, Sensor

Array = NDArray[np.float64]


def ups(first: Rotation, rate: Array, rate_hz: float) -> Array:
    """Return up (n, 3) in body axes, from an attitude on; rate: (n, 3) rad/s in body axes, as sampled.

    Between two samples the phone turns by the mean of both rates. The third row of an attitude, body to
    world, is up as the body sees it, and is carried on by the turns as the attitude is.
    """
    turns = Rotation.from_rotvec((rate[1:] + rate[:-1]) / (2.0 * rate_hz)).as_matrix()
    up = np.empty_like(rate)
    up[0] = first.as_matrix()[2]
    for i, turn in enumerate(turns):
        np.matmul(up[i], turn, out=up[i + 1])
    return up


@dataclass(frozen=True)
class Shaken:
    """A turn (3,) rad of `duration` s by a hand that shakes about all axes at once, from an attitude on.

    size: (14, 3) rad, frequency: (14,) Hz, phase: (14, 3) of the waves when the recording starts, `begun` s
    before the turn.
    """

    start: Rotation
    turn: Array
    duration: float
    size: Array
    frequency: Array
    phase: Array
    begun: float

    def at(self, t: Array) -> Rotation:
        """Return the attitudes at t (n,), s from the turn's start."""
        part = np.clip(t / self.duration, 0.0, 1.0)[:, None]
        fade = np.clip(np.minimum(part, 1.0 - part) * self.duration / 0.4, 0.0, 1.0)
        waves = np.sin(2.0 * np.pi * self.frequency[:, None] * (self.begun + t[:, None, None]) + self.phase)
        shaken = fade**2 * (3.0 - 2.0 * fade) * np.einsum("ka,nka->na", self.size, waves)
        moved = self.turn * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        return self.start * Rotation.from_rotvec(moved) * Rotation.from_rotvec(shaken)


def lively(seed: int) -> tuple[Samples, Samples]:
    """Return 26 turns of a hand that shakes, sampled at 25 Hz with no filter before."""
    rng = np.random.default_rng(seed)
    size, frequency = rng.normal(0.0, 0.06, (14, 3)), rng.uniform(0.5, 4.0, 14)
    now, phase = Rotation.from_rotvec(rng.normal(0.0, 1.5, 3)), rng.uniform(0.0, 6.28, (14, 3))
    rates, ups = [], []
    for _ in range(26):
        axis = rng.normal(0.0, 1.0, 3)
        turn = rng.uniform(0.7, 2.8) * axis / np.linalg.norm(axis)
        still = rng.uniform(12.0, 30.0)
        begun = sum(map(len, rates)) * 0.04 + still
        hand = Shaken(now, turn, rng.uniform(1.5, 4.0), size, frequency, phase, begun)
        t = np.arange(-still, hand.duration, 0.04)
        rates.append((hand.at(t - 1e-3).inv() * hand.at(t + 1e-3)).as_rotvec() / 2e-3)
        ups.append(hand.at(t).as_matrix()[:, 2])
        now = now * Rotation.from_rotvec(turn)
    rates.append(np.zeros((500, 3)))
    ups.append(np.tile(now.as_matrix()[2], (500, 1)))
    rate, up = np.concatenate(rates), np.concatenate(ups)
    t = np.arange(len(rate)) * 0.04
    return (
        Samples.checked(Sensor.ACCELEROMETER, t, 9.80665 * up + rng.normal(0.0, 0.01, up.shape)),
        Samples.checked(Sensor.GYROSCOPE, t, rate + 0.005 + rng.normal(0.0, 5e-4, up.shape)),
    )
