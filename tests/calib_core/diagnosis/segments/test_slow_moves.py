"""A rest ends where a slow move begins, and not where a bias relaxes after a quick one."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.diagnosis.segments.static_bins import Bins, cut
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE_HZ = 50.0
BIAS = np.array([3e-3, -2e-3, 1e-3])


def bins(rate: np.ndarray) -> Bins:
    """Return the bins of a level phone: rate (n, 3) rad/s about gravity and less, without noise."""
    rng, t = np.random.default_rng(3), np.arange(len(rate)) / RATE_HZ
    force = np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 5e-3, rate.shape)
    noisy = rate + BIAS + rng.normal(0.0, 1e-3, rate.shape)
    return cut(Samples.checked(Sensor.ACCELEROMETER, t, force), Samples.checked(Sensor.GYROSCOPE, t, noisy))


def test_what_a_motor_turns_at_the_ends_of_its_moves_is_in_no_rest() -> None:
    """Five pans of 30 s, each of two radians, begin and end without haste."""
    t = np.arange(int(600 * RATE_HZ)) / RATE_HZ
    part = np.clip((t % 120.0 - 60.0) / 30.0, 0.0, 1.0)
    rate = np.zeros((t.size, 3))
    rate[:, 2] = 2.0 / 30.0 * 30.0 * part**2 * (1.0 - part) ** 2
    seen = bins(rate)
    assert seen.rate is not None and len(seen) >= 35
    assert np.abs(seen.rate - BIAS).max() < 1e-3


def test_a_bias_that_relaxes_after_a_hand_put_the_phone_down_is_kept() -> None:
    t = np.arange(int(600 * RATE_HZ)) / RATE_HZ
    since = t % 120.0
    rate = np.where(since < 2.0, 1.5 * np.sin(np.pi * since), 5e-3 * np.exp(-(since - 2.0) / 20.0))
    seen = bins(np.stack([rate, 0.0 * rate, 0.0 * rate], axis=1))
    assert seen.rate is not None
    assert np.count_nonzero(seen.rate[:, 0] - BIAS[0] > 3e-3) == 5, "one at the beginning of each rest"


def test_a_bias_that_settles_from_the_beginning_of_the_recording_is_kept() -> None:
    t = np.arange(int(300 * RATE_HZ)) / RATE_HZ
    seen = bins(np.outer(1e-2 * np.exp(-t / 50.0), [1.0, 0.0, 0.0]))
    assert seen.rate is not None and seen.t[0] < 10.0
    assert seen.rate[0, 0] - BIAS[0] > 8e-3
