"""Coloured noise against published Allan deviations and known truth."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.noise import covariance as noise


def nist_series() -> np.ndarray:
    """NIST SP1065, 12.4: the 1000-point test suite from a prime modulus generator."""
    n, values = 1234567890, []
    for _ in range(1000):
        values.append(n / 2147483647)
        n = 16807 * n % 2147483647
    return np.array(values)


@pytest.mark.parametrize(("m", "published"), [(1, 2.922319e-01), (10, 9.159953e-02), (100, 3.241343e-02)])
def test_overlapping_allan_deviation_as_published(m: int, published: float) -> None:
    assert noise.allan_deviation(nist_series(), m) == pytest.approx(published, rel=2e-6)


def test_allan_deviation_refuses_too_few() -> None:
    with pytest.raises(ValueError, match="at least 21 values"):
        noise.allan_deviation(np.zeros(20), 10)


BINS = np.arange(90) * 20.0 + 10.0 + np.repeat([0.0, 300.0, 420.0], 30)
LENGTHS = np.full(90, 20.0)


def test_covariances_match_simulated_averages() -> None:
    """Averages of a finely simulated walk and Gauss-Markov process have the stated covariance."""
    rng = np.random.default_rng(1)
    t, length = np.array([5.0, 40.0, 70.0]), np.array([10.0, 20.0, 8.0])
    fine = np.arange(0.0, 100.0, 0.25)
    walk = np.cumsum(rng.normal(0, 0.5, (20000, fine.size)), axis=1)
    rows = [(fine >= a - b / 2) & (fine < a + b / 2) for a, b in zip(t, length, strict=True)]
    means = np.array([walk[:, r].mean(axis=1) for r in rows])
    np.testing.assert_allclose(np.cov(means), noise.random_walk_covariance(t, length), rtol=0.06, atol=0.2)


def test_gauss_markov_of_long_bins_is_white() -> None:
    covariance = noise.gauss_markov_covariance(BINS, np.full(90, 20.0), 0.01)
    np.testing.assert_allclose(covariance.diagonal(), 2 * 0.01 / 20.0, rtol=1e-3)


def test_flicker_allan_floor_is_one() -> None:
    t, length = np.arange(200) * 10.0 + 5.0, np.full(200, 10.0)
    covariance = noise.flicker_covariance(t, length)
    variance = np.mean([covariance[i, i] - covariance[i, i + 1] for i in range(50, 150)])
    assert np.sqrt(variance) == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize(
    "truth",
    [
        noise.NoiseModel(1e-3),
        noise.NoiseModel(1e-3, walk=2e-5),
        noise.NoiseModel(1e-3, gauss_markov=1e-3, tau=240.0),
        noise.NoiseModel(5e-4, flicker=5e-4),
    ],
)
def test_fit_recovers_the_spectrum(truth: noise.NoiseModel) -> None:
    """The fitted structure function agrees with the truth's at short and long lags, averaged over draws."""
    rng = np.random.default_rng(7)
    factor = np.linalg.cholesky(truth.covariance(BINS, LENGTHS))

    def structure(model: noise.NoiseModel) -> np.ndarray:
        c = model.covariance(BINS, LENGTHS)
        return np.array([c[0, 0] + c[k, k] - 2 * c[0, k] for k in (1, 8, 40)])

    fits = [structure(noise.fit_noise(BINS, LENGTHS, factor @ rng.normal(size=90))) for _ in range(5)]
    np.testing.assert_allclose(np.mean(fits, axis=0) / structure(truth), 1.0, atol=0.45)


def test_what_was_fitted_before_takes_no_slow_noise_with_it() -> None:
    """Of fourteen rests ten columns took 70 % of flicker noise: what they left has a floor of 0.3 of it."""
    rng, size = np.random.default_rng(2), 40
    truth = noise.NoiseModel(5e-4, flicker=5e-4)
    t, length = np.arange(size) * 50.0, np.full(size, 50.0)
    factor = np.linalg.cholesky(truth.covariance(t, length))
    free = rng.normal(size=(14, 9))[np.arange(size) * 14 // size]
    apart = []
    for _ in range(6):
        y = factor @ rng.normal(size=size)
        left = y - free @ np.linalg.lstsq(free, y, rcond=None)[0]
        fits = [noise.fit_noise(t, length, left, (240.0,), columns) for columns in (None, free)]
        apart.append([np.hypot(f.flicker, 0.6 * f.gauss_markov) / truth.flicker for f in fits])
    without, with_free = np.mean(apart, axis=0)
    assert without < 0.6 and with_free == pytest.approx(1.0, abs=0.3)


def test_fit_refuses_too_few_bins() -> None:
    with pytest.raises(ValueError, match="at least 8 bins"):
        noise.fit_noise(BINS[:5], LENGTHS[:5], BINS[:5])
