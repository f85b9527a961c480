"""Rests as the diagnosis cuts them: a knock ends one, coarse steps do not."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.misfit.bins import Bins, cut
from stillcal.calib_core.samples import Samples, Sensor

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


def test_values_that_toggle_between_two_steps_are_still() -> None:
    coarse = np.round(resting(0.02) / 0.1) * 0.1
    assert np.unique(bins(coarse).rest).size == 1
