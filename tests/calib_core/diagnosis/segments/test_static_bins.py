"""Rests as the diagnosis cuts them: a knock ends one, coarse steps do not."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.segments.static_bins import Bins, cut
from stillcal.calib_core.streams.samples import Samples, Sensor

N = 15_000


def resting(noise: float = 0.005) -> np.ndarray:
    return np.random.default_rng(1).normal(0, noise, (N, 3)) + np.array([0.0, 0.0, 9.81])


def bins(force: np.ndarray) -> Bins:
    return cut(Samples.checked(Sensor.ACCELEROMETER, np.arange(N) / 50.0, force), None)


def test_a_knock_ends_a_rest_and_is_in_no_bin() -> None:
    knocked = resting()
    knocked[7000:7040, 0] += 0.06 * np.sin(np.arange(40))
    whole, cut_up = bins(resting()), bins(knocked)
    assert np.unique(whole.rest).size == 1 and np.unique(cut_up.rest).size == 2
    assert cut_up.vibration.max() < 1.5 * np.median(cut_up.vibration)


def test_bins_that_are_shaken_are_as_uncertain_as_they_are_and_the_others_no_more() -> None:
    """An eighth is shaken four times as much: the mean of all would make its means too sure by half."""
    shaken = resting()
    shaken[12_000:14_000] += np.random.default_rng(2).normal(0.0, 0.005 * np.sqrt(15.0), (2000, 3))
    seen = bins(shaken)
    louder = seen.vibration / np.median(seen.vibration)
    assert (louder > 12.0).sum() >= 3
    for which, noise in ((louder > 12.0, 0.02), (louder < 2.0, 0.005)):
        expected = noise**2 / 50.0 / seen.duration[which, None]
        assert (seen.force_variance[which] / expected).mean() == pytest.approx(1.0, rel=0.25)


def test_a_spike_of_one_sensor_is_in_no_mean_and_ends_no_rest() -> None:
    rng, force, t = np.random.default_rng(2), resting(), np.arange(N) / 50.0
    quiet = rng.normal(0, 1e-3, (N, 3))
    spiked = quiet.copy()
    spiked[700::700, 1] += 0.04

    def both(rate: np.ndarray) -> Bins:
        accel, gyro = Sensor.ACCELEROMETER, Sensor.GYROSCOPE
        return cut(Samples.checked(accel, t, force), Samples.checked(gyro, t, rate))

    whole, spiky = both(quiet), both(spiked)
    assert np.unique(spiky.rest).size == 1 and whole.rate is not None and spiky.rate is not None
    np.testing.assert_allclose(spiky.rate, whole.rate, atol=1e-5)


def test_values_that_toggle_between_two_steps_are_still() -> None:
    coarse = np.round(resting(0.02) / 0.1) * 0.1
    assert np.unique(bins(coarse).rest).size == 1


def test_a_phone_that_is_carried_all_day_rests_only_where_it_is_put_down() -> None:
    """Steps of a walk, even ones, but for the last twentieth."""
    walked = np.arange(N) < 0.95 * N
    t = np.arange(N) / 50.0
    steps = np.stack([np.sin(2 * np.pi * f * t) for f in (1.0, 2.0, 4.0)], axis=1)
    seen = bins(resting() + 2.5 * steps * walked[:, None])
    assert len(seen) and seen.t.min() > 0.95 * t[-1]


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
def test_a_slow_log_rests_where_it_is_not_turned(rate: float) -> None:
    """An hour in two attitudes, turned over in a quarter of an hour between; stamps jitter."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 3600.0, 1.0 / rate)
    t = np.sort(t + rng.normal(0.0, 0.05 / rate, t.size))
    moving = (t > 1500.0) & (t < 2100.0)
    angle = np.clip((t - 1500.0) / 600.0, 0.0, 1.0) * np.pi
    force = 9.81 * np.stack([np.zeros(t.size), np.sin(angle), np.cos(angle)], axis=1)
    force += rng.normal(0.0, 0.01, force.shape) + moving[:, None] * rng.normal(0.0, 1.0, force.shape)
    spin = moving * np.pi / 600.0 + moving * rng.normal(0.0, 0.5, t.size)
    turning = np.outer(spin, [1.0, 0.0, 0.0]) + rng.normal(0.0, 1e-3, force.shape)
    found = cut(
        Samples.checked(Sensor.ACCELEROMETER, t, force), Samples.checked(Sensor.GYROSCOPE, t, turning)
    )
    inside = (found.t > 1500.0) & (found.t < 2100.0)
    assert not inside.any() and np.unique(found.rest).size == 2
    assert found.duration.sum() > 0.9 * 3000.0
    np.testing.assert_allclose(np.abs(found.force[:, 2]), 9.81, atol=0.02)
