"""What shakes a phone that lies on a machine is told from what shakes it in a vehicle."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.clear_bins import still_bins
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE = 50.0
T = np.arange(0.0, 300.0, 1.0 / RATE)
SHAKEN = 0.5


def on_a_machine(frequency: float) -> Array:
    return np.asarray(SHAKEN * np.sin(2.0 * np.pi * frequency * T))


def at_many_speeds() -> Array:
    speed = np.random.default_rng(1).uniform(8.0, 20.0, 31)[(T / 10.0).astype(int)]
    return np.asarray(SHAKEN * np.sin(2.0 * np.pi * np.cumsum(speed) / RATE))


def own_noise() -> Array:
    """Return as much as noisy sensors have: 0.018 m/s^2 per sqrt(Hz)."""
    return np.random.default_rng(3).normal(0.0, 0.09, (T.size, 3))


def louder_noise() -> Array:
    """Return noise that is as white and three times as loud."""
    return np.random.default_rng(7).normal(0.0, 0.25, (T.size, 3))


def in_a_band() -> Array:
    """Return shaking from 3 to 20 Hz, two thirds of the frequencies: what is beyond is the sensor's."""
    shaking = lfilter(*butter(4, [3.0, 20.0], "band", fs=RATE), np.random.default_rng(5).normal(size=T.size))
    return np.asarray(0.3 * SHAKEN * shaking / shaking.std())


def on_a_road() -> Array:
    return np.asarray(np.random.default_rng(2).normal(0.0, 0.7 * SHAKEN, T.size))


@pytest.mark.parametrize(
    ("shaking", "judged"),
    [
        (own_noise(), True),
        (on_a_machine(11.3), True),
        (on_a_machine(17.9), True),
        (on_a_machine(2.1), False),  # no machine is that slow, and a car sways so
        (at_many_speeds(), False),
        (on_a_road(), False),
        (louder_noise(), False),  # no sensor has as much
        (in_a_band(), False),
    ],
)
def test_only_a_machine_leaves_rates_to_be_judged(shaking: Array, *, judged: bool) -> None:
    rng = np.random.default_rng(0)
    force = rng.normal([0.0, 0.0, 9.81], 0.002, (T.size, 3))
    force += shaking if shaking.ndim == 2 else np.outer(shaking, [0.0, 0.0, 1.0])
    rate = rng.normal(0.0, 0.001, (T.size, 3))
    bins = still_bins(
        Samples.checked(Sensor.ACCELEROMETER, T, force), Samples.checked(Sensor.GYROSCOPE, T, rate)
    )
    assert len(bins) >= 25
    assert (bins.rate is not None) == judged
