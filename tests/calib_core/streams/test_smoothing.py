"""The rolling mean of Grammenos et al. 2018, 4.6: its window by rate, its delay, and blocks of any size."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.calib_core.streams.smoothing import RollingMean, window_for


def stream(n: int, rate_hz: float, seed: int = 0) -> Samples:
    rng = np.random.default_rng(seed)
    return Samples(Sensor.ACCELEROMETER, frozen(np.arange(n) / rate_hz), frozen(rng.normal(0, 1, (n, 3))))


@pytest.mark.parametrize(
    ("rate_hz", "window"),
    [(1, 3), (20.4, 3), (20.6, 5), (80.4, 5), (80.6, 10), (120.4, 10), (120.6, 20), (400, 20)],
)
def test_the_window_is_that_of_table_2(rate_hz: float, window: int) -> None:
    assert window_for(rate_hz) == window


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, np.nan, np.inf])
def test_a_rate_that_is_none_is_refused(rate_hz: float) -> None:
    with pytest.raises(ValueError, match="Hz"):
        window_for(rate_hz)


def test_each_mean_is_that_of_the_newest_samples() -> None:
    raw = stream(50, 50.0)
    smooth = RollingMean(50.0).smoothed_samples(raw)
    for i in range(50):
        assert smooth.xyz[i] == pytest.approx(raw.xyz[max(i - 4, 0) : i + 1].mean(axis=0), abs=1e-12)
    assert smooth.t is raw.t


def test_no_rounding_builds_up_after_a_huge_value() -> None:
    """A running sum loses 1e16's worth of digits for good; a window forgets it."""
    raw = np.full((1000, 3), 0.1)
    raw[10] = 1e16
    assert RollingMean(50.0).smoothed(raw)[-1] == pytest.approx(0.1, abs=1e-16)


def test_the_variance_of_noise_falls_and_a_ramp_lags_by_the_delay() -> None:
    noise = RollingMean(100.0)
    assert noise.smoothed(stream(20_000, 100.0).xyz).var() == pytest.approx(0.1, rel=0.1)
    ramp = RollingMean(100.0)
    t = np.arange(100) / 100.0
    lagging = ramp.smoothed(np.tile(t[:, None], 3))
    assert t[50] - lagging[50] == pytest.approx([ramp.delay_s] * 3)
    assert ramp.delay_s == pytest.approx(0.045)


@given(st.lists(st.integers(0, 200), max_size=6))
def test_blocks_of_any_size_give_the_same_to_the_last_bit(cuts: list[int]) -> None:
    raw = stream(200, 100.0)
    t = raw.t + np.where(np.arange(200) >= 120, 0.5, 0.0)  # a pause after which the mean begins anew
    raw = replace(raw, t=frozen(t))
    whole = RollingMean(100.0).smoothed_samples(raw)
    mean = RollingMean(100.0)
    edges = [0, *sorted(cuts), 200]
    parts = [mean.smoothed_samples(raw[a:b]) for a, b in itertools.pairwise(edges)]
    assert np.concatenate([p.xyz for p in parts]).tobytes() == whole.xyz.tobytes()
    assert whole.xyz[120].tolist() == raw.xyz[120].tolist()
    assert whole.xyz[119].tolist() != raw.xyz[119].tolist()
