"""A phone on the deck of a ship at berth: swell rolls and heaves it, which is no fault of either sensor."""

from __future__ import annotations

import numpy as np
import pytest

import stillcal

RATE_HZ, LENGTH = 20.0, 6000


def at_berth(seed: int, heave: float, roll_deg: float, period_s: float = 14.0) -> stillcal.Recording:
    """Five minutes on deck. heave: m/s^2 (rms) by which it goes up and down."""
    rng, t = np.random.default_rng(seed), np.arange(LENGTH) / RATE_HZ
    frequency = (1.0 + 0.1 * rng.normal(size=6)) / period_s
    phase = rng.uniform(0.0, 2.0 * np.pi, 6)

    def swell(shift: float) -> np.ndarray:
        waves = np.sin(2.0 * np.pi * frequency * t[:, None] + phase + shift)
        return np.asarray(waves.sum(axis=1) / np.sqrt(3.0))

    angle, up = np.radians(roll_deg) * swell(0.0), 9.81 + heave * swell(1.0)
    zero = np.zeros(LENGTH)
    force = np.stack([up * np.sin(angle), zero, up * np.cos(angle)], axis=1)
    rate = np.stack([zero, -np.gradient(angle, t), zero], axis=1)
    return stillcal.load(
        t=t,
        accelerometer=force + rng.normal(0.0, 5e-3, force.shape),
        gyroscope=rate + rng.normal(0.0, 1e-3, rate.shape),
    )


@pytest.mark.parametrize(("seed", "heave"), [(1, 0.1), pytest.param(0, 0.05, marks=pytest.mark.slow)])
def test_neither_heave_nor_roll_is_a_fault(seed: int, heave: float) -> None:
    """The accelerometer's bias did wander by it, and the gyroscope's made a step."""
    found = stillcal.diagnose(at_berth(seed, heave, 0.3))
    assert found.verdict == "match" and found.findings == []
    told = {(c["effect"], c["sensor"]): c.get("reason") for c in found.answer["not_compared"]}
    assert told.get(("accel_bias_random_walk", "accel")) is not None, told
