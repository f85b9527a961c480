"""Noise by its spectrum and Allan deviation, both computed here and not by the project."""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest
from scipy.signal import welch

from stillcal.replay.phone import Phone, draw_rests
from stillcal.replay.phone.noise import GaussMarkov, Wander, White, flicker_bank, seeded
from stillcal.replay.phone.rest_means import mean_sd, rounded_mean
from stillcal.replay.phone.settings import Noise, SensorSettings, Wandering

ONE = np.ones(3)


def allan_deviation(values: np.ndarray, m: int) -> np.ndarray:
    """Overlapping Allan deviation over m samples, by axis."""
    sums = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), values]), axis=0)
    means = (sums[m:] - sums[:-m]) / m
    return np.sqrt(0.5 * np.mean((means[m:] - means[:-m]) ** 2, axis=0))


def test_white_noise_has_its_density() -> None:
    rate, density = 100.0, 1.5e-3
    values = White(density * math.sqrt(rate / 2.0) * ONE, 0.0, 1.0, seeded(1, "w")).draw(200_000)
    _, power = welch(values, fs=rate, nperseg=2048, axis=0)
    # about 190 averaged segments and 1000 bins: the mean is good to 0.3 %
    assert np.sqrt(power[5:-5].mean()) == pytest.approx(density, rel=0.01)


def test_heavy_tails_have_their_kurtosis() -> None:
    fraction, ratio = 0.02, 6.0
    values = White(ONE, fraction, ratio, seeded(2, "w")).draw(400_000)
    second = 1 - fraction + fraction * ratio**2
    expected = 3.0 * (1 - fraction + fraction * ratio**4) / second**2
    kurtosis = np.mean(values**4) / np.mean(values**2) ** 2
    assert np.mean(values**2) == pytest.approx(second, rel=0.03)
    assert kurtosis == pytest.approx(expected, rel=0.1)


def test_flicker_has_a_flat_allan_deviation_at_0_664_of_its_level() -> None:
    level, step = 3e-4, 0.5
    wander = Wander(flicker_bank(level * ONE), np.zeros(3), 7, "x")
    values = wander.at(np.arange(0.0, 60_000.0, step))
    floor = level * math.sqrt(2.0 * math.log(2.0) / math.pi)
    for tau in (8.0, 32.0, 128.0, 512.0):
        mean = math.sqrt(np.mean(allan_deviation(values, round(tau / step)) ** 2))
        # relative error of the deviation is about sqrt(tau / (2 span * 3 axes)), 4 % at 512 s
        assert mean == pytest.approx(floor, rel=0.10), tau


def test_flicker_spectrum_falls_as_one_over_f() -> None:
    level, step = 1.0, 0.25
    values = Wander(flicker_bank(level * ONE), np.zeros(3), 8, "x").at(np.arange(0.0, 80_000.0, step))
    f, power = welch(values, fs=1.0 / step, nperseg=16384, axis=0)
    for band in ((1e-3, 3e-3), (1e-2, 3e-2), (0.1, 0.3)):
        inside = (f >= band[0]) & (f < band[1])
        product = (power[inside].mean(axis=1) * f[inside]).mean()
        assert product == pytest.approx(level**2 / math.pi, rel=0.12), band


def test_gauss_markov_has_its_variance_and_correlation_time() -> None:
    sigma, tau = np.array([1.0, 2.0, 0.5]), 20.0
    values = Wander([GaussMarkov(sigma, tau)], np.zeros(3), 3, "x").at(np.arange(0.0, 200_000.0, 1.0))
    # 5000 correlation times in all: the variance is good to 2 %, so 8 % is four of it
    assert values.std(axis=0) == pytest.approx(sigma, rel=0.04)
    lag = 20
    correlation = np.mean(values[lag:] * values[:-lag], axis=0) / np.mean(values**2, axis=0)
    assert correlation == pytest.approx(math.exp(-1.0), abs=0.05)


def test_random_walk_grows_with_the_square_root_of_time() -> None:
    density = 0.01
    ends = np.array([Wander([], density * ONE, seed, "x").at(np.array([25.0, 100.0])) for seed in range(400)])
    spread = np.sqrt(np.mean(ends**2, axis=(0, 2)))
    # 1200 draws: 2 % each
    assert spread == pytest.approx(density * np.sqrt([25.0, 100.0]), rel=0.08)


def test_wander_does_not_depend_on_how_it_is_asked_for() -> None:
    parts = [*flicker_bank(ONE), GaussMarkov(ONE, 5.0)]
    t = np.sort(np.random.default_rng(0).uniform(0.0, 500.0, 5000))
    whole = Wander(parts, 0.1 * ONE, 4, "x").at(t)
    pieces = Wander(parts, 0.1 * ONE, 4, "x")
    cut = np.concatenate([pieces.at(part) for part in np.split(t, [1, 17, 1000, 1001, 4000])])
    assert np.array_equal(whole, cut)


def test_hours_of_few_samples_need_little_memory() -> None:
    tracemalloc.start()
    Wander([GaussMarkov(ONE, 600.0), GaussMarkov(ONE, 60.0)], ONE, 4, "x").at(np.arange(0.0, 36_000.0, 60.0))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 20e6


@pytest.mark.parametrize("rate_hz", [1.0 / 1.02, 0.999995, 8000.3])
def test_every_rate_of_a_recording_can_be_simulated(rate_hz: float) -> None:
    """Loggers that step by 1 s of a slow clock, and chips whose buffers are logged at their full rate."""
    assert SensorSettings(rate_hz=rate_hz).rate_hz == rate_hz


def quiet_phone(**noise: object) -> Phone:
    return Phone(accel=SensorSettings(noise=Noise(**noise)), gyro=None)


def test_drawn_rests_scatter_as_the_means_of_samples_do() -> None:
    """Rest-level draws against means over the sample-level wander, same noise, independent draws."""
    span, gap, sigma, tau = 30.0, 10.0, 0.01, 40.0
    process = [GaussMarkov(sigma * ONE, tau)]
    samples = Wander(process, np.zeros(3), 11, "x").at(np.arange(0.0, 80_000.0, 0.25))
    starts = np.arange(0, samples.shape[0] - 160, 160)
    sampled = np.array([samples[i : i + 120].mean(axis=0) for i in starts])
    phone = quiet_phone(gauss_markov=(Wandering(sigma=sigma, tau_s=tau),))
    rests = draw_rests(phone, 2000, seed=3, duration_s=span, gap_s=gap)
    drawn = rests.forces - rests.true_forces
    expected = mean_sd(process[0], np.array([span]))[0]
    assert drawn.std(axis=0) == pytest.approx(expected, rel=0.08)
    assert sampled.std(axis=0) == pytest.approx(expected, rel=0.08)
    neighbours = [np.mean(x[1:] * x[:-1]) / np.mean(x**2) for x in (drawn, sampled)]
    assert neighbours[0] == pytest.approx(neighbours[1], abs=0.06)
    assert rests.uncertainties == pytest.approx(np.tile(expected, (2000, 1)))


def test_drawn_rests_walk_as_far_as_a_random_walk() -> None:
    density, phone = 1e-3, quiet_phone(random_walk=1e-3)
    ends = np.array(
        [draw_rests(phone, 10, seed=s, duration_s=20.0, gap_s=5.0).wander[-1] for s in range(300)]
    )
    # the last mean: 9 rests and 10 gaps behind it, plus a third of its own length
    variance = density**2 * (9 * 20.0 + 10 * 5.0 + 20.0 / 3.0)
    assert np.mean(ends**2) == pytest.approx(variance, rel=0.15)


def test_the_mean_of_a_random_walk_has_a_third_of_its_variance() -> None:
    phone = quiet_phone(random_walk=1e-3)
    means = [draw_rests(phone, 1, seed=s, duration_s=30.0, gap_s=1e-6).wander[0] for s in range(600)]
    # 1800 values: the variance is good to 3.3 %
    assert np.mean(np.square(means)) == pytest.approx(1e-6 * 30.0 / 3.0, rel=0.12)


def test_drawn_rests_of_white_noise_shrink_with_their_length() -> None:
    phone = quiet_phone(white=2e-3)
    rests = draw_rests(phone, 3000, seed=1, duration_s=50.0)
    expected = 2e-3 / math.sqrt(2.0 * 50.0)
    assert (rests.forces - rests.true_forces).std() == pytest.approx(expected, rel=0.03)
    assert rests.uncertainties == pytest.approx(expected)


@pytest.mark.parametrize("dither", [0.25, 0.35, 0.5])
def test_expected_rounding_under_dither(dither: float) -> None:
    lsb, rng = 0.04, np.random.default_rng(5)
    value = np.array([[0.013, -0.02, 1.0071]])
    noisy = value + dither * lsb * rng.standard_normal((400_000, 3))
    direct = (np.rint(noisy / lsb) * lsb).mean(axis=0)
    assert rounded_mean(value, dither * lsb * ONE, lsb)[0] == pytest.approx(direct, abs=lsb * 0.004)
