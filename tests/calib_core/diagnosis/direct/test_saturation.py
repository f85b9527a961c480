"""A limit within the noise of gravity itself: samples on one value, and nothing beyond."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.direct.saturation import saturation
from stillcal.calib_core.diagnosis.direct.stuck import stuck
from stillcal.calib_core.streams.samples import Samples, Sensor

NOISE = np.full(3, 0.01)


def resting(seed: int, step: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    up = np.repeat(np.array([[0.0, 0.0, 9.8], [9.8, 0.0, 0.0], [0.0, -9.8, 0.0]]), 4000, axis=0)
    return np.round((up + NOISE * rng.standard_normal(up.shape)) / step) * step


def samples(force: np.ndarray) -> Samples:
    return Samples.checked(Sensor.ACCELEROMETER, np.arange(len(force)) / 50.0, force)


@pytest.mark.parametrize("seed", range(5))
def test_a_phone_that_clips_at_gravity_is_found(seed: int) -> None:
    found = saturation(samples(np.clip(resting(seed, 1e-3), -9.81, 9.81)), "accel", NOISE, 40.0)
    assert found is not None and found.parameters["limit"].value == pytest.approx(9.81, abs=1e-3)


@pytest.mark.parametrize("step", [1e-5, 1e-3, 5e-3, 0.05, 0.3])
def test_gravity_is_no_limit(step: float) -> None:
    for seed in range(20):
        assert saturation(samples(resting(seed, step)), "accel", NOISE, 40.0) is None


def test_values_of_few_uneven_levels_are_no_limit() -> None:
    """As some phones give them: steps of 0.041 and 0.027 m/s^2 by turns, at a noise of half a step."""
    levels = np.cumsum(np.tile([0.04086, 0.02724], 500)) - 17.0
    rng = np.random.default_rng(3)
    force = np.array([0.0, 9.77, -0.1]) + 0.02 * rng.standard_normal((9000, 3))
    rounded = levels[np.abs(force[:, :, None] - levels[None, None]).argmin(axis=2)]
    assert saturation(samples(rounded), "accel", np.full(3, 0.02), None) is None


def test_a_slow_rate_between_two_steps_is_no_limit() -> None:
    """A gyroscope at rest with steps far above its noise reads one of two values for hours."""
    rng = np.random.default_rng(5)
    slow = 0.3 * np.sin(np.arange(20000) / 1500.0)[:, None] + np.array([4.6, 0.7, 10.4])
    rates = 1e-3 * np.round(slow + 0.03 * rng.standard_normal((20000, 3)))
    at_rest = Samples.checked(Sensor.GYROSCOPE, np.arange(20000) / 2.0, rates)
    assert saturation(at_rest, "gyro", np.full(3, 3e-4), None) is None


@pytest.mark.parametrize("limit", [8.0, 9.0])
def test_a_phone_that_rests_at_its_limit_clips_and_is_not_stuck(limit: float) -> None:
    """Below gravity: five of the ends of its axes stop at one value, where it lies most of the time."""
    rng = np.random.default_rng(1)
    faces = np.concatenate([np.eye(3), -np.eye(3)])[rng.permutation(6)]
    up = 9.8 * np.repeat(faces, 1500, axis=0) * 1.01 + np.array([0.1, -0.2, 0.15])
    force = up + NOISE * rng.standard_normal(up.shape)
    step = 1.2e-3
    whole, clipped = (np.round(f / step) * step for f in (force, np.clip(force, -limit, limit)))
    assert saturation(samples(whole), "accel", NOISE, 40.0) is None
    found = saturation(samples(clipped), "accel", NOISE, 40.0)
    assert found is not None and found.parameters["limit"].value == pytest.approx(limit, abs=2e-3)
    assert found.axes == ["x", "y", "z"]
    assert stuck(samples(clipped), "accel") is None


def spun(limit: float, step: float, seed: int = 0) -> Samples:
    """Return a gyroscope at 50 Hz that is spun three times at up to 3 rad/s, for some 0.4 s above 2 rad/s."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 120.0, 0.02)
    rate = 0.005 * rng.standard_normal((t.size, 3))
    for middle, most in ((20.0, 2.6), (60.0, 2.8), (90.0, 3.0)):
        rate[:, 2] += most * np.exp(-(((t - middle) / 0.35) ** 2))
    rate = np.clip(rate, -limit, limit)
    return Samples.checked(Sensor.GYROSCOPE, t, np.round(rate / step) * step if step else rate)


@pytest.mark.parametrize("step", [0.0, 1.07e-3, 4e-3])
@pytest.mark.parametrize("seed", range(3))
def test_three_fast_visits_to_a_limit_show_it(step: float, seed: int) -> None:
    """Some 60 samples stay on one value, and hardly any lies just below it."""
    noise = np.full(3, 0.005)
    found = saturation(spun(2.0, step, seed), "gyro", noise, None)
    assert found is not None and found.axes == ["z"]
    assert found.parameters["limit"].value == pytest.approx(2.0, abs=3e-3)
    assert saturation(spun(np.inf, step, seed), "gyro", noise, None) is None


@pytest.mark.parametrize("seed", range(3))
def test_two_fast_visits_show_a_limit_and_one_does_not(seed: int) -> None:
    """Of spins to 2.6, 2.8 and 3.0 rad/s two or one pass it; a single stay may be a sample that was held."""
    noise = np.full(3, 0.005)
    found = saturation(spun(2.7, 1.07e-3, seed), "gyro", noise, None)
    assert found is not None and found.parameters["limit"].value == pytest.approx(2.7, abs=3e-3)
    assert saturation(spun(2.9, 1.07e-3, seed), "gyro", noise, None) is None


def turned_about_each_axis(limit: float) -> Samples:
    """Return a gyroscope that is turned once about each axis and once back, at 1.5 to 1.7 rad/s."""
    rng, t = np.random.default_rng(5), np.arange(0.0, 120.0, 0.02)
    rate = 5e-4 * rng.standard_normal((t.size, 3))
    for k, (middle, most) in enumerate(
        ((15, 1.55), (30, -1.6), (50, 1.65), (70, -1.7), (90, 1.6), (105, -1.5))
    ):
        rate[:, k // 2] += most * np.exp(-(((t - middle) / 0.6) ** 2))
    step = 3.3e-5
    return Samples.checked(Sensor.GYROSCOPE, t, np.round(np.clip(rate, -limit, limit) / step) * step)


def test_each_end_of_the_axes_that_stops_at_one_value_counts_though_each_was_there_once() -> None:
    """One visit is no evidence on its axis, though its top looks flat; six ends do not agree by chance."""
    noise = np.full(3, 5e-4)
    found = saturation(turned_about_each_axis(1.4), "gyro", noise, None)
    assert found is not None and found.axes == ["x", "y", "z"]
    assert found.parameters["limit"].value == pytest.approx(1.4, abs=1e-4)
    assert saturation(turned_about_each_axis(np.inf), "gyro", noise, None) is None


def turned(rates: list[float], limit: float, seed: int = 1) -> Samples:
    """Return a motor that turns one axis to and fro at each of the rates, clipped at a limit."""
    rng, u = np.random.default_rng(seed), np.linspace(0.0, 1.0, 150)
    up = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    once = np.concatenate([np.zeros(1500), up, np.ones(700), up[::-1]])
    rate = np.clip(np.concatenate([sign * r * once for r in rates for sign in (1.0, -1.0)]), -limit, limit)
    still = np.zeros_like(rate)
    read = np.stack([rate, still, still], axis=1) + 1e-3 * rng.standard_normal((rate.size, 3))
    return Samples.checked(Sensor.GYROSCOPE, np.arange(rate.size) / 100.0, np.round(read / 2e-4) * 2e-4)


@pytest.mark.parametrize(("limit", "said"), [(10.0, False), (1.5, True)])
def test_the_highest_speed_of_a_motor_is_no_limit(limit: float, said: bool) -> None:
    """It stands still at its lower speeds too; what is clipped stands still at the limit alone."""
    rates = [0.3, 1.0, 2.0, 3.5] * 4 if not said else [1.9, 2.4, 3.0, 3.5] * 4
    found = saturation(turned(rates, limit), "gyro", np.full(3, 1e-3), None)
    assert (found is not None) is said


def swung(rate: float, limit: float) -> Samples:
    """Return many swings by hand about one axis, of all sizes, whose rates are clipped before their noise."""
    rng = np.random.default_rng(5)
    t = np.arange(round(600.0 * rate)) / rate
    turned = np.zeros_like(t)
    for k, begin in enumerate(np.arange(5.0, 590.0, 6.0)):
        u = np.clip((t - begin) / rng.uniform(0.6, 1.4), 0.0, 1.0)
        turned += rng.uniform(1.0, 5.5) * (-1.0) ** k * 16.0 * u**2 * (1.0 - u) ** 2
    read = np.stack([np.clip(turned, -limit, limit), 0.0 * t, 0.0 * t], axis=1)
    return Samples.checked(Sensor.GYROSCOPE, t, read + 2e-3 * rng.standard_normal(read.shape))


@pytest.mark.parametrize("rate", [25.0, 50.0, 100.0])
def test_swings_that_turn_back_below_a_limit_are_no_speeds_of_a_motor(rate: float) -> None:
    """They are still for a moment, many more of them than reach the limit."""
    found = saturation(swung(rate, 5.2), "gyro", np.full(3, 2e-3), None)
    assert found is not None and found.parameters["limit"].value == pytest.approx(5.2, abs=5e-3)
    assert saturation(swung(rate, np.inf), "gyro", np.full(3, 2e-3), None) is None


def knocked(limit: float, step: float, seed: int) -> Samples:
    """Return an accelerometer at 100 Hz, put down in turn on each axis with knocks of one sample."""
    rng, n = np.random.default_rng(seed), 12000
    force = 0.05 * rng.standard_normal((n, 3))
    for k in range(24):
        force[k * 500 : (k + 1) * 500, k % 3] += 9.8 * (-1) ** k
    for row in rng.choice(n, 120, replace=False):
        force[row] += rng.standard_normal(3) * 15.0
    force = np.clip(force, -limit, limit)
    return Samples.checked(
        Sensor.ACCELEROMETER, np.arange(n) / 100.0, np.round(force / step) * step if step else force
    )


@pytest.mark.parametrize("step", [0.0, 2.4e-3, 0.02])
@pytest.mark.parametrize("seed", range(3))
def test_knocks_of_one_sample_that_end_on_one_value_show_a_limit(step: float, seed: int) -> None:
    """Most reach far beyond it, so that hardly any value lies just below."""
    noise = np.full(3, 0.05)
    found = saturation(knocked(10.7, step, seed), "accel", noise, None)
    assert found is not None and found.parameters["limit"].value == pytest.approx(10.7, abs=0.02)
    assert saturation(knocked(np.inf, step, seed), "accel", noise, None) is None
