"""Values that are held, or stuck, are told from values at the limit of a range, where motion takes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.direct.repeated_values import (
    TWICE,
    Repeats,
    doubled,
    held,
    held_rows,
    without_held,
)
from stillcal.calib_core.diagnosis.direct.stuck import dead, stuck
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


@pytest.mark.parametrize("part", [0.05, 0.2, 0.5])
@pytest.mark.parametrize("step", [2e-4, 7e-4])
def test_the_part_that_is_held_is_told_beside_what_steps_repeat(part: float, step: float) -> None:
    """Held samples repeat on each axis as well: that was taken for chance, and half came out as a quarter."""
    rng = np.random.default_rng(6)
    rate = turned(1, [0], 2.0)
    kept = np.where(rng.random(len(rate)) < part, 0, np.arange(len(rate)))
    coarse = np.rint(rate / step) * step
    xyz = coarse[np.maximum.accumulate(kept)]
    samples = Samples(Sensor.GYROSCOPE, frozen(np.arange(len(rate)) / RATE), frozen(xyz))
    found, share = held(samples, "gyro", NONE_HELD)
    assert found is not None and share == pytest.approx(part, abs=0.02)
    low, high = found.parameters["fraction"].ci95
    assert low < part < high


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


@pytest.mark.parametrize(("others", "stated"), [([0, 1], True), ([0], False)])
def test_an_axis_that_never_changes_is_dead_where_both_others_go_on(
    others: list[int], *, stated: bool
) -> None:
    """Turned about one axis, or never turned, a coarse gyroscope may show none of the others."""
    samples = recorded(turned(0, others, 2.0))
    values = np.zeros_like(samples.xyz)
    values[:, others] = samples.xyz[:, others]
    found = dead(Samples(samples.sensor, samples.t, frozen(values)), "gyro")
    assert (found is not None and found.axes == ["z"]) == stated and dead(samples, "gyro") is None


@pytest.mark.parametrize(("twice", "stated"), [(7, False), (50, True), (100, True)])
def test_samples_that_came_twice_are_stated_above_one_in_a_thousand(twice: int, *, stated: bool) -> None:
    """The watch of HHAR has 7 of 10,000."""
    lying = recorded(np.random.default_rng(0).normal(0.0, 1e-3, (10_000, 3)))
    found = doubled(lying, twice, 10_000.0)
    assert (found is not None) == stated
    assert found is None or found.parameters["fraction"].value == pytest.approx(twice / 10_000, rel=0.02)
    if stated:
        assert doubled(lying, twice, 1e6) is None, "of a recording that is longer than what is held of it"


@pytest.mark.parametrize("removed", [True, False])
def test_it_is_the_same_whether_the_reader_left_them_out_or_not(*, removed: bool) -> None:
    force = recorded(np.random.default_rng(0).normal([0.0, 0.0, 1.0], 0.01, (10_000, 3)))
    force = Samples(Sensor.ACCELEROMETER, force.t, force.xyz)
    again = np.repeat(np.arange(10_000), 1 + (np.arange(10_000) % 100 == 50))
    twice = Samples(force.sensor, frozen(force.t[again]), frozen(force.xyz[again]))
    exam = examine(force, None, delivered_twice=100) if removed else examine(twice, None)
    found = [s.finding for s in exam.statements if s.finding.where.driver == TWICE]
    assert [f.parameters["fraction"].value for f in found] == pytest.approx([100 / 10_100])
    assert len(exam.accelerometer) == 10_000


@pytest.mark.parametrize(("step", "left_out"), [(1e-6, True), (0.1, False)])
def test_samples_are_held_where_values_go_on_from_there(step: float, left_out: bool) -> None:
    """What coarse steps repeat is no less true: without it they would have another mean."""
    t = np.arange(400) * 0.02
    rate = np.column_stack([np.sin(t), np.cos(t), np.zeros(t.size)])
    rate[50::10] = rate[49:-1:10]
    rate = step * np.rint(rate / step)
    kept = without_held(Samples.checked(Sensor.GYROSCOPE, t, rate))
    assert len(kept) == t.size - 35 * left_out


def test_what_a_sensor_without_noise_reads_at_rest_is_not_held() -> None:
    """All rests of an ideal simulation were left out of a pair, and in what was left the noise had steps."""
    t = np.arange(0.0, 60.0, 0.01)
    turning = np.clip(t % 6.0 - 5.0, 0.0, 1.0) + np.floor(t / 6.0)
    still = Samples(Sensor.GYROSCOPE, frozen(t), frozen(np.outer(turning, [0.3, -0.2, 0.1])))
    assert not held_rows(still).any()
    rows = np.arange(t.size)
    stuck = (rows >= 540) & (rows < 560)  # in a turn, which shows it when it goes on
    xyz = still.xyz[np.where(stuck, 539, rows)]
    np.testing.assert_array_equal(held_rows(replace(still, xyz=frozen(xyz))), stuck)


@pytest.mark.parametrize("seed", range(3))
def test_steps_coarser_than_the_noise_leave_open_how_many_samples_are_held(seed: int) -> None:
    """The share of the coarse copy is within its error of what the fine values show: neither is none."""
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((6000, 3))
    late = np.flatnonzero(rng.random(5999) < 0.03) + 1
    values[late] = values[late - 1]
    shares = []
    for xyz in (values, 1.5 * np.round(values / 1.5)):
        seen = Repeats.of(Samples.checked(Sensor.ACCELEROMETER, np.arange(6000) / 100.0, xyz))
        assert seen is not None
        shares.append(seen.share())
    fine, coarse = shares
    assert abs(fine.value - 0.03) < 4.0 * fine.error
    assert coarse.value == 0.0 and fine.value < 2.0 * coarse.error
