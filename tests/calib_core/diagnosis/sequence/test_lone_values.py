"""Single values that are off in motion have no name; hands, knocks and vibrations are silent."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.static_bins import cut
from stillcal.calib_core.diagnosis.sequence.findings import sequence_findings
from stillcal.calib_core.diagnosis.sequence.lone_values import DRIVER
from stillcal.calib_core.diagnosis.sequence.neighbours import without_outliers
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE, LSB = 50.0, 1e-3


def turned(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return t (n,) s and codes (n, 3) of a gyroscope that rests for 10 s and is turned for 10 s, in turn."""
    t = np.arange(0.0, 300.0, 1.0 / RATE)
    moved = np.clip(np.sin(2.0 * np.pi * t / 20.0), 0.0, None) ** 2
    f, phase = np.linspace(0.2, 2.0, 6), rng.uniform(0.0, 6.0, (6, 3))
    swing = np.sin(2.0 * np.pi * f[:, None] * t[:, None, None] + phase).sum(axis=1)
    rate = moved[:, None] * swing + 1e-3 * rng.normal(size=(t.size, 3))
    return t, np.rint(rate / LSB).astype(np.int64)


def found(t: Array, rate: Array) -> list[str]:
    samples = Samples.checked(Sensor.GYROSCOPE, t, rate)
    moving = np.abs(rate).max(axis=1) > 0.05
    shaken = np.random.default_rng(0).normal(size=(t.size, 3)) * np.where(moving, 1.0, 0.01)[:, None]
    force = np.array([0.0, 0.0, 9.8]) + shaken
    bins = cut(Samples.checked(Sensor.ACCELEROMETER, t, force), samples)
    return [f.where.driver for f in sequence_findings(samples, without_outliers(samples), "gyro", bins)]


def test_a_byte_that_is_torn_in_motion_is_found() -> None:
    rng = np.random.default_rng(1)
    t, code = turned(rng)
    torn = (np.abs(code).max(axis=1) > 50) & (rng.random(t.size) < 0.03)
    code[torn, 1] ^= rng.integers(0, 256, int(torn.sum()))
    assert found(t, LSB * code) == [DRIVER]


@pytest.mark.parametrize("kind", ["turned", "knocked", "struck", "shaken", "twice", "coarse", "held"])
def test_sound_motion_is_silent(kind: str) -> None:
    rng = np.random.default_rng(2)
    t, code = turned(rng)
    rate = LSB * code
    if kind == "knocked":
        for at in rng.uniform(10.0, 290.0, 60):
            since = np.clip(t - at, 0.0, None)
            rate += np.outer(
                (t >= at) * np.exp(-since / 0.04) * np.sin(60.0 * since + 1.0), rng.normal(size=3)
            )
    elif kind == "struck":  # blows of one sample come on more than one axis
        blows = (np.abs(code).max(axis=1) > 50) & (rng.random(t.size) < 0.02)
        rate[blows] += rng.uniform(-1.0, 1.0, (int(blows.sum()), 3))
    elif kind == "shaken":
        rate += np.outer(0.3 * np.sin(2.0 * np.pi * 21.3 * t) * (t % 40.0 < 7.0), [1.0, 0.3, 0.0])
    elif kind == "twice":  # two single values may be anything
        rate[[2700, 6630], 0] += 0.5
    elif kind == "coarse":
        rate = 0.05 * np.rint(rate / 0.05)
    elif kind == "held":  # which has a name; about one axis, as a jig turns
        fresh = np.where(rng.random(t.size) < 0.1, 0, np.arange(t.size))
        rate = (rate * [1.0, 0.01, 0.01] + 1e-3 * rng.normal(size=rate.shape))[np.maximum.accumulate(fresh)]
    assert found(t, rate) == []
