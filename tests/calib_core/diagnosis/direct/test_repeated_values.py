"""Values that are held, or stuck, are told from values at the limit of a range, where motion takes them."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.direct.repeated_values import held
from stillcal.calib_core.diagnosis.direct.stuck import stuck
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE, SECONDS = 50.0, 900
LIMIT, STEP = 2.18, 1.3e-4


NONE_HELD = sound_phones()["held_samples_declared"]


def turned(seed: int, axes: list[int], seconds: float, turns: int = 30) -> np.ndarray:
    """Return rates (n, 3) at rest, turned too fast about some axes every 30 s for so many seconds."""
    t = np.arange(int(RATE * SECONDS)) / RATE
    since, turn = np.mod(t, 30.0), (t / 30.0).astype(int)
    way = np.where((since < seconds) & (turn < turns), np.sin(np.pi * since / seconds), 0.0) * (-1.0) ** turn
    rate = np.random.default_rng(seed).normal(0.0, 1e-3, (t.size, 3))
    rate[:, axes] += 8.0 * way[:, None]
    return np.asarray(rate)


def recorded(rate: np.ndarray) -> Samples:
    clipped = np.rint(np.clip(rate, -LIMIT, LIMIT) / STEP) * STEP
    return Samples(Sensor.GYROSCOPE, frozen(np.arange(len(rate)) / RATE), frozen(clipped))


def with_holds(samples: Samples) -> Samples:
    """Give every hundredth sample, and its neighbour, the values of the one before."""
    rows = np.arange(len(samples))
    late = (rows % 100 < 3) & (rows >= 100)
    return Samples(samples.sensor, samples.t, frozen(samples.xyz[np.where(late, rows // 100 * 100, rows)]))


@pytest.mark.parametrize("seed", range(3))
def test_all_axes_at_their_limits_are_not_held(seed: int) -> None:
    samples = recorded(turned(seed, [0, 1, 2], 2.0))
    at_limit = np.abs(samples.xyz) > LIMIT - STEP
    assert at_limit.all(axis=1).mean() > 0.02
    found, share = held(samples, "gyro", NONE_HELD)
    assert found is None and share < 1e-3


@pytest.mark.parametrize("seed", range(3))
def test_values_held_elsewhere_are_found_beside_a_limit(seed: int) -> None:
    found, share = held(with_holds(recorded(turned(seed, [0, 1, 2], 2.0))), "gyro", NONE_HELD)
    assert found is not None and found.effect == "held_samples"
    assert share == pytest.approx(0.02, abs=0.003)


def test_values_held_are_found_where_no_limit_is_met() -> None:
    found, share = held(with_holds(recorded(turned(0, [], 2.0))), "gyro", NONE_HELD)
    assert found is not None and share == pytest.approx(0.02, abs=0.001)


def test_an_axis_turned_at_its_limit_for_seconds_is_not_stuck() -> None:
    assert stuck(recorded(turned(0, [2], 10.0, turns=8)), "gyro") is None


@pytest.mark.parametrize("value", [0.0123, 4.0])
def test_an_axis_that_is_stuck_is_found_beside_a_limit(value: float) -> None:
    """At a value in its range, and at one beyond all others."""
    samples = recorded(turned(0, [2], 10.0, turns=8))
    values = samples.xyz.copy()
    values[20000:22000, 1] = value
    found = stuck(Samples(samples.sensor, samples.t, frozen(values)), "gyro")
    assert found is not None and found.axes == ["y"]
    assert found.where.t_start == pytest.approx(400.0, abs=0.1)
