"""A bias by temperature and time, learnt from made rests: value and stated uncertainty."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.temperature.breaks import learn
from stillcal.calib_core.temperature.forecast import Forecast, thermometer_step
from stillcal.calib_core.temperature.regression import (
    ACCELEROMETER,
    DEG,
    GYROSCOPE,
    MG,
    Fit,
    Model,
    Observations,
    Regression,
    curve_basis,
)
from stillcal.calib_core.temperature.wander import Spans

HOUR = 3600.0
SLOPE = 0.02 * DEG
"""rad/s/K"""


def celsius_of(t: Array) -> Array:
    """Return a day's temperatures, degC: 20 to 34."""
    return 27.0 + 7.0 * np.sin(2 * np.pi * t / (9 * HOUR))


def made(rng: np.random.Generator, n: int = 70) -> tuple[Observations, Array]:
    """Return rests of two days and the true bias (n, 3); the last is a moment to be predicted, no rest.

    Curve, a random walk of 5e-3 deg/s a day, and a Gauss-Markov process of 1e-3 deg/s with 20 minutes.
    """
    t = np.sort(rng.uniform(0.0, 48 * HOUR, n))
    t[-1] = t[-2] + HOUR
    gaps = np.diff(t, prepend=0.0)
    walk = np.cumsum(np.sqrt(gaps / 86400.0)[:, None] * 5e-3 * DEG * rng.standard_normal((n, 3)), axis=0)
    slow = np.zeros((n, 3))
    for i in range(1, n):
        keep = np.exp(-gaps[i] / 1200.0)
        slow[i] = keep * slow[i - 1] + np.sqrt(1 - keep**2) * 1e-3 * DEG * rng.standard_normal(3)
    u = (celsius_of(t) - 25.0)[:, None]
    bias = SLOPE * np.array([1.0, -0.5, 0.2]) * u + 2e-4 * DEG * u**2 + walk + slow
    value = bias + 3e-4 * DEG * rng.standard_normal((n, 3))
    return observed(t, celsius_of(t), value), bias


def observed(t: Array, celsius: Array, value: Array) -> Observations:
    n = len(t)
    return Observations(t, celsius, value, np.full(n, 3e-4 * DEG), np.ones((n, 1)), np.array([0.05]))


def earlier(seen: Observations) -> Observations:
    return observed(seen.t[:-1], seen.celsius[:-1], seen.value[:-1])


def forecast(fit: Fit, at: float) -> Forecast:
    wander = fit.wander
    return Forecast(
        at=at,
        reference=25.0,
        curve=fit.curve,
        error=np.zeros((4, 3)),
        covariance=fit.bias_covariance,
        white=wander.white,
        flicker=wander.flicker,
        walk=wander.walk,
        temperature_min=20.0,
        temperature_max=34.0,
    )


def test_a_bias_is_predicted_and_its_interval_holds() -> None:
    """30 sensors an hour after their last rest: their intervals hold; without a curve it is far off."""
    apart, stated, plain = [], [], []
    for seed in range(30):
        seen, bias = made(np.random.default_rng(seed))
        now, past = float(seen.t[-2]), earlier(seen)
        fit = learn(past, Model(GYROSCOPE, 25.0, with_curve=True), now)
        without = learn(past, Model(GYROSCOPE, 25.0, with_curve=False), now)
        told = fit.bias + curve_basis(seen.celsius[-1:], 25.0)[0] @ fit.curve
        apart.append(bias[-1] - told)
        plain.append(bias[-1] - without.bias)
        stated.append(forecast(fit, now).bias_uncertainty(float(seen.t[-1]), float(seen.celsius[-1])))
    held = np.mean(np.abs(apart) < 1.96 * np.array(stated))
    assert 0.88 < held <= 1.0
    assert np.std(apart) < 3e-3 * DEG
    assert np.std(plain) > 5 * np.std(apart)


def test_rests_that_overstate_their_uncertainty_do_not_hide_the_flicker() -> None:
    """Taken at their word, rests that are five times too uncertain leave no room for what wanders."""
    seen, _ = made(np.random.default_rng(0), 120)
    model, now = Model(GYROSCOPE, 25.0, with_curve=True), float(seen.t[-1])
    honest, modest = (learn(replace(seen, sd=by * seen.sd), model, now).wander for by in (1.0, 5.0))
    assert modest.declared < 0.4 < honest.declared
    assert modest.growth(HOUR) > 0.6 * honest.growth(HOUR)


def test_the_flicker_of_many_rests_takes_the_memory_of_a_few_matrices() -> None:
    spans, n = Spans(np.arange(300.0)), 300
    tracemalloc.start()
    assert spans.flicker.shape == (n, n)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5 * 8 * n**2


def test_a_likelihood_by_itself_is_that_of_the_fit() -> None:
    seen, _ = made(np.random.default_rng(6))
    now = float(seen.t[-1])
    regression = Regression(seen, Model(GYROSCOPE, 25.0, with_curve=True))
    fit = regression.fit(now)
    assert regression.log_likelihood(fit.wander, fit.steps) == fit.log_likelihood


def test_uncertainty_grows_with_age_and_beyond_the_temperatures_met() -> None:
    seen, _ = made(np.random.default_rng(1))
    now = float(seen.t[-2])
    known = forecast(learn(earlier(seen), Model(GYROSCOPE, 25.0, with_curve=True), now), now)
    fresh, old = (known.bias_uncertainty(now + age, 27.0).max() for age in (0.0, 12 * HOUR))
    far, unknown = known.bias_uncertainty(now, 60.0).max(), known.bias_uncertainty(now, None).max()
    assert fresh < old < unknown
    assert far > 3 * fresh


@pytest.mark.parametrize(("step", "found"), [(1.0, 1.0), (0.5, 0.5), (0.0, 0.0)])
def test_the_step_of_a_thermometer_shows_in_the_rests(step: float, found: float) -> None:
    true = np.random.default_rng(0).uniform(15.0, 40.0, 60)
    read = true if step == 0.0 else np.round(true / step) * step
    read[:5] += 0.37  # the thermometer changed its step within these rests
    assert thermometer_step(np.append(read, np.nan)) == found


def moved_along_a_line(seed: int, n: int = 60) -> tuple[Observations, Array]:
    """Return rests of a phone that lies nearly flat, and its biases (n, 3), moved by warmth along a line."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0.0, 30 * HOUR, n))
    up = np.column_stack((0.35 * rng.standard_normal((n, 2)), np.ones(n)))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    line = rng.standard_normal(3)
    shared = np.exp(-np.abs(t[:, None] - t) / (2 * HOUR)) + 1e-9 * np.eye(n)
    warmth = np.linalg.cholesky(shared) @ rng.standard_normal(n)
    bias = 3 * MG * np.outer(warmth, line / np.linalg.norm(line))
    value = -(up * bias).sum(axis=1) + 0.05 * MG * rng.standard_normal(n)
    known = (np.full(n, np.nan), value[:, None], np.full(n, 0.05 * MG), -up, np.full(3, 0.1), -up)
    return Observations(t, *known), bias


def test_a_bias_that_moves_along_one_line_is_followed_where_attitudes_hardly_show_it() -> None:
    """With a wander that is taken to be alike on all axes, the error is 1.3 mg and twice what is stated."""
    model, errors, stated = Model(ACCELEROMETER, 25.0, False), [], []
    for seed in range(24):
        seen, bias = moved_along_a_line(seed)
        even = Regression(seen, model).fit(seen.t[-1])
        for fit in (even, Regression(seen, model).averaged(even, seen.t[-1])):
            errors.append(bias[-1] - fit.bias)
            stated.append(np.sqrt(np.diag(fit.bias_covariance)[:3]))
    error, sd = (np.array(values).reshape(24, 2, 3) for values in (errors, stated))
    alike, averaged = np.sqrt((error**2).mean(axis=(0, 2)))
    assert averaged < 0.8 * alike and sd[:, 1].mean() < 0.8 * sd[:, 0].mean()
    off_alike, off = np.sqrt(((error / sd) ** 2).mean(axis=(0, 2)))
    assert off < 0.8 * off_alike and off < 1.6
