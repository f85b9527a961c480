"""Tails without a fourth moment are found as surely as tails with one; normal noise and knocks have none."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.noise.heavy_tails import AT_ONCE, tails, unlike_noise
from stillcal.calib_core.diagnosis.noise.low_pass import Quiet

WHERE = Where(0.0, 4000.0, (0.0, 12.5), "noise at rest")


def said(values: np.ndarray) -> Finding | None:
    pieces = tuple(values.reshape(100, 500, 3))
    return tails(
        Quiet(pieces, tuple(np.arange(100) * 20.0), 25.0),
        "accel",
        sound_phones()["excess_kurtosis"],
        WHERE,
        0.0,
    )


@pytest.mark.parametrize("freedom", [2.5, 3.5, 4.5])
@pytest.mark.parametrize("seed", range(3))
def test_students_noise_has_heavy_tails_on_all_axes(freedom: float, seed: int) -> None:
    found = said(np.random.default_rng(seed).standard_t(freedom, (50000, 3)))
    assert found is not None and found.effect == "noise_heavy_tailed"
    assert found.axes == ["x", "y", "z"]


@pytest.mark.parametrize("seed", range(3))
def test_normal_noise_and_what_is_near_it_are_silent(seed: int) -> None:
    """Thirty degrees of freedom: an excess kurtosis of 6 / 26, below the tolerance."""
    rng = np.random.default_rng(seed)
    assert said(rng.normal(size=(50000, 3))) is None
    assert said(rng.standard_t(30.0, (50000, 3))) is None


def test_few_far_samples_are_spikes_and_no_heavy_tails() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=(50000, 3))
    values[rng.random(50000) < 1e-3, 2] += 40.0
    found = said(values)
    assert found is not None and found.effect == "unknown" and found.axes == ["z"]


@pytest.mark.parametrize("seed", range(3))
def test_spikes_whose_moments_are_unsure_are_found_by_their_count(seed: int) -> None:
    """Some values have lost their sign: in 20 rests of 10 s there are 24, of some thousand spreads."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(20000, 3))
    values[rng.choice(20000, 24, replace=False), 1] += 1500.0 * rng.uniform(-1.0, 1.0, 24)
    pieces = tuple(values.reshape(20, 1000, 3))
    still = Quiet(pieces, tuple(np.arange(20) * 10.0), 100.0)
    found = tails(still, "accel", sound_phones()["excess_kurtosis"], WHERE, 0.0)
    assert found is not None and found.effect == "unknown" and found.axes == ["y"]


def with_outliers(count: int, seed: int, axes: int = 1, samples: int = 1) -> np.ndarray:
    """Return normal noise with some jumps of 35 spreads, on so many axes for so many samples."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(50000, 3))
    for start in rng.choice(49900, count, replace=False):
        values[start : start + samples, rng.permutation(3)[:axes]] += 35.0 * rng.choice([-1.0, 1.0])
    return np.asarray(values)


@pytest.mark.parametrize("seed", range(3))
def test_a_few_outliers_are_found_by_their_count(seed: int) -> None:
    """Their fourth moment is no surer than they are many."""
    found = said(with_outliers(8, seed))
    assert found is not None and found.effect == "unknown"
    assert found.parameters["count"].value == 8.0
    assert said(with_outliers(3, seed)) is None


@pytest.mark.parametrize(("axes", "samples"), [(2, 1), (1, 2)])
def test_knocks_are_no_outliers(axes: int, samples: int) -> None:
    """What moves the phone shows on several axes, or in several samples."""
    assert said(with_outliers(8, 1, axes, samples)) is None


def shaken(values: np.ndarray, rng: np.random.Generator, share: float) -> np.ndarray:
    """Return samples (50000, 3) of which a share of the rests is shaken now and then."""
    moving = np.convolve(rng.normal(size=50000), np.ones(4) / 2.0, mode="same")
    moving *= np.clip(np.convolve(rng.normal(size=50000), np.ones(200) / 8.0, mode="same"), 0.0, None)
    loud = np.repeat(rng.random(100) < share, 500)
    return np.asarray(values + (4.0 * moving * loud)[:, None] * np.array([0.6, 1.0, 0.8]))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("share", [0.15, 0.4])
def test_quiet_rests_tell_tails_where_others_are_shaken(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    found = said(shaken(rng.standard_t(3.0, (50000, 3)), rng, share))
    assert found is not None and found.effect == "noise_heavy_tailed"
    assert found.axes == ["x", "y", "z"]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("share", [0.15, 0.4, 0.85, 1.0])
def test_rests_that_are_shaken_give_normal_noise_no_tails(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    assert said(shaken(rng.normal(size=(50000, 3)), rng, share)) is None


@pytest.mark.parametrize("seed", range(3))
def test_knocks_in_quiet_rests_are_no_tails_where_others_are_shaken(seed: int) -> None:
    """A knock once in 5 s, some samples long, on two axes."""
    rng = np.random.default_rng(seed)
    values = shaken(rng.normal(size=(50000, 3)), rng, 0.3)
    ring = 8.0 * np.exp(-np.arange(12) / 4.0) * np.cos(2.0 * np.arange(12))
    for start in rng.choice(49900, 400, replace=False):
        values[start : start + 12] += ring[:, None] * np.array([0.2, 0.7, 1.0])
    assert said(values) is None


def test_outliers_of_one_side_or_one_size_are_no_noise() -> None:
    rng = np.random.default_rng(5)
    normal = rng.normal(size=(60000, 3))
    far = rng.random(normal.shape) < 0.003
    assert unlike_noise(normal) == unlike_noise(np.where(far, 6.0, 1.0) * normal) == ""
    assert unlike_noise(rng.standard_t(4, size=normal.shape)) == ""
    assert "one side" in unlike_noise(normal + 8.0 * far * np.abs(rng.normal(size=normal.shape)))
    assert "times the noise" in unlike_noise(normal + 9.2 * far * rng.choice([-1.0, 1.0], normal.shape))


@pytest.mark.parametrize("lasting", [1, 6])
def test_far_samples_of_all_axes_at_once_have_no_name_and_knocks_are_none(lasting: int) -> None:
    """One sample in a hundred is five times as large on all axes, or six in a row are, as often."""
    rng = np.random.default_rng(4)
    values = rng.normal(size=(50000, 3))
    struck = np.zeros(50000, dtype=np.bool_)
    for first in rng.choice(49990, 500 // lasting, replace=False):
        struck[first : first + lasting] = True
    found = said(np.where(struck[:, None], 5.0, 1.0) * values)
    assert (found is not None) == (lasting == 1)
    if found is not None:
        assert (found.effect, found.axes) == ("unknown", ["x", "y", "z"])
        assert found.where.driver == "outliers of several axes at once"


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sided", [False, True])
def test_taps_in_some_of_the_rests_are_no_noise(seed: int, sided: bool) -> None:
    """Somebody types beside the phone for a quarter of the time; one axis feels it, for a sample at 25 Hz."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(50000, 3))
    typed = np.flatnonzero(rng.random(12500) < 0.02) + 15000
    sign = 1.0 if sided else rng.choice([-1.0, 1.0], typed.size)
    values[typed, 2] += sign * rng.lognormal(1.5, 0.5, typed.size)
    assert said(values) is None


@pytest.mark.parametrize("seed", range(3))
def test_tails_in_all_rests_are_noise_though_their_levels_differ(seed: int) -> None:
    rng = np.random.default_rng(seed)
    level = np.repeat(rng.uniform(1.0, 1.2, 100), 500)[:, None]
    found = said(level * rng.standard_t(3.5, (50000, 3)))
    assert found is not None and found.effect == "noise_heavy_tailed"


@pytest.mark.parametrize("ring", [0.0, 0.1])
def test_knocks_that_ring_below_what_is_far_are_no_outliers(ring: float) -> None:
    """Somebody types beside the phone: at 50 Hz a tenth of a blow is left one sample later."""
    rng = np.random.default_rng(4)
    values = rng.normal(0.0, 0.01, (50000, 3))
    struck = np.flatnonzero(rng.random(49990) < 0.002)
    blows = rng.choice([-1.0, 1.0], (struck.size, 3)) * rng.uniform(0.06, 0.15, (struck.size, 3))
    values[struck] += blows
    values[struck + 1] += ring * blows
    found = said(values)
    assert (found is None) == (ring > 0.0)
    assert found is None or found.where.driver == AT_ONCE


@pytest.mark.parametrize("seed", range(6))
def test_chance_beside_outliers_is_no_ring_of_a_knock(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(0.0, 0.01, (50000, 3))
    struck = np.flatnonzero(rng.random(50000) < 0.002)
    blows = rng.choice([-1.0, 1.0], (struck.size, 3)) * rng.uniform(0.06, 0.15, (struck.size, 3))
    values[struck] += blows
    found = said(values)
    assert found is not None and found.where.driver == AT_ONCE
