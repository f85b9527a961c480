"""Whether noise at rest is white: few rests scatter each frequency's power, and are no reason to deny it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.noise.low_pass import Quiet, judged
from stillcal.calib_core.diagnosis.noise.noise_level import Levels, levels

RATE, DENSITY = 25.0, 1.5e-3
SD = DENSITY * np.sqrt(RATE / 2.0)


def measured(count: int, seed: int, coefficient: float = 0.0, rate: float = RATE) -> Levels:
    """Return the levels of `count` rests of 200 samples, of noise that remembers by `coefficient`."""
    white = SD * np.random.default_rng(seed).normal(size=(count, 200, 3))
    pieces: Array = lfilter([1.0], [1.0, -coefficient], white, axis=1)
    pieces = pieces - pieces.mean(axis=1, keepdims=True)
    seen = judged(Quiet(tuple(pieces), tuple(200.0 / rate * np.arange(count)), rate))
    assert seen is not None
    return levels(seen)


@pytest.mark.parametrize("count", [3, 5, 8, 12, 19, 40])
def test_white_noise_of_few_rests_is_white_and_as_loud_as_it_is(count: int) -> None:
    made = [measured(count, seed) for seed in range(20)]
    assert all(one.white for one in made)
    ratios = np.array([one.values() for one in made]) / DENSITY
    assert abs(ratios.mean() - 1.0) < 0.02


@pytest.mark.parametrize("count", [8, 12, 19, 40])
def test_noise_that_falls_over_the_whole_band_is_not_white(count: int) -> None:
    assert not any(measured(count, seed, 0.9).white for seed in range(20))


def test_hardly_any_rests_make_no_white_noise_of_what_falls() -> None:
    """Three rests at 10 Hz would need all 75 frequencies together, over which any noise is level."""
    assert sum(measured(3, seed, 0.8, 10.0).white for seed in range(40)) <= 10
