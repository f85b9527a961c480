"""A low-pass that one of two sensors on one motion has, told by what of the motion comes through it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.pair.samples_apart.low_pass_in_motion import (
    Followed,
    low_pass_in_motion,
)
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE, COUNT = 100.0, 6000


def motion(seed: int = 1) -> Array:
    """Return rates (n, 3) whose power falls slowly up to 20 Hz, as a hand shakes a phone."""
    white = np.random.default_rng(seed).normal(0.0, 1.0, (COUNT, 3))
    return np.asarray(lfilter(*butter(2, 20.0, fs=RATE), white, axis=0))


def behind(xyz: Array, cutoff: float, order: int = 2) -> Array:
    return np.asarray(lfilter(*butter(order, cutoff, fs=RATE), xyz, axis=0))


def read(xyz: Array, seed: int, t: Array | None = None) -> Samples:
    noise = np.random.default_rng(seed).normal(0.0, 0.01, xyz.shape)
    return Samples(Sensor.GYROSCOPE, np.arange(COUNT) / RATE if t is None else t, xyz + noise)


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("cutoff", [6.0, 12.0, 25.0])
@pytest.mark.parametrize("of_first", [True, False])
def test_the_cutoff_is_told_though_the_noise_is_behind_the_filter(
    cutoff: float, order: int, *, of_first: bool
) -> None:
    """It was a delay between the sensors of 19 ms, or nothing where the filter is centred."""
    filtered, plain = read(behind(motion(), cutoff, order), 2), read(motion(), 3)
    found = low_pass_in_motion(*((filtered, plain) if of_first else (plain, filtered)))
    assert found is not None and found.of_first == of_first
    assert found.cutoff.value == pytest.approx(cutoff, rel=0.06)
    assert abs(found.cutoff.value - cutoff) < 3.0 * found.cutoff.error
    assert found.order == order or cutoff == 25.0


def test_a_mean_of_five_samples_has_its_cutoff() -> None:
    kernel = np.ones(5) / 5.0
    mean = np.stack([np.convolve(axis, kernel, "same") for axis in motion().T], axis=1)
    found = low_pass_in_motion(read(mean, 2), read(motion(), 3))
    assert found is not None and found.cutoff.value == pytest.approx(0.443 / 5.0 * RATE, rel=0.06)


def told(first: Array, second: Array) -> Followed | None:
    return low_pass_in_motion(read(first, 2), read(second, 3))


def test_what_one_of_the_two_reads_besides_is_no_low_pass_of_the_other() -> None:
    t = np.arange(COUNT)[:, None] / RATE
    hum = 0.5 * np.sin(2.0 * np.pi * 31.0 * t)
    slow = behind(np.random.default_rng(5).normal(0.0, 1.0, (COUNT, 3)), 8.0)
    for more in (hum, 0.3 * np.random.default_rng(4).normal(0.0, 1.0, (COUNT, 3)), slow):
        assert told(motion() + more, motion()) is None
        assert told(motion(), motion() + more) is None


def test_sensors_that_differ_by_other_things_have_none() -> None:
    turned = motion() @ np.array([[1.02, 0.03, 0.0], [-0.03, 0.98, 0.01], [0.0, 0.0, 1.05]]) + 0.1
    late = np.roll(motion(), 1, axis=0)
    for other in (motion(), turned, late, np.clip(motion(), -0.6, 0.6), np.round(motion() / 0.05) * 0.05):
        assert told(other, motion()) is None
        assert told(motion(), other) is None


def test_too_little_motion_tells_nothing() -> None:
    assert told(behind(motion(), 3.0), behind(motion(), 2.0)) is None
    assert told(behind(0.02 * motion(), 6.0), 0.02 * motion()) is None
    assert told(np.zeros((COUNT, 3)), np.zeros((COUNT, 3))) is None


def test_stretches_with_a_gap_are_left_out() -> None:
    t = np.arange(COUNT) / RATE
    broken = t + np.floor(t)  # a second is missing after each second
    filtered = behind(motion(), 12.0)
    assert low_pass_in_motion(read(filtered, 2, broken), read(motion(), 3, broken)) is None
    once = t + 5.0 * (t > 30.0)
    found = low_pass_in_motion(read(filtered, 2, once), read(motion(), 3, once))
    assert found is not None and found.cutoff.value == pytest.approx(12.0, rel=0.06)


@pytest.mark.parametrize("rate", [40.0, 400.0])
def test_the_sample_rate_does_not_matter(rate: float) -> None:
    """At 400 Hz a stretch of 256 samples has too few frequencies below those of a hand."""
    count = int(60.0 * rate)
    white = np.random.default_rng(6).normal(0.0, 1.0, (count, 3))
    true = lfilter(*butter(2, 12.0, fs=rate), white, axis=0)
    filtered = lfilter(*butter(2, 8.0, fs=rate), true, axis=0)
    t = np.arange(count) / rate
    found = low_pass_in_motion(read(filtered, 2, t), read(true, 3, t))
    assert found is not None and found.cutoff.value == pytest.approx(8.0, rel=0.06)


def test_a_low_pass_as_wide_as_parts_come_with_is_none() -> None:
    wide = behind(10.0 * np.random.default_rng(1).normal(0.0, 1.0, (COUNT, 3)), 30.0)
    found = told(behind(wide, 34.0), wide)
    assert found is not None and found.cutoff.value == pytest.approx(34.0, rel=0.1)
    assert told(behind(wide, 44.0), wide) is None
