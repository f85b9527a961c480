"""Held-out evidence against the same densities written out in full."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.timed import Step
from stillcal.calib_core.diagnosis.inference.bayes_factor import SIZES
from stillcal.calib_core.diagnosis.inference.cross_validation import FOLDS, HeldOut, held_out
from stillcal.calib_core.diagnosis.model.effect import Linear, on_axes
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, Parameters, SensorResiduals
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.maths.rms import rms
from tests.support.diagnosis import nulls

RAMP = Parameters("accel_bias_drift", "accel", (Linear("rate", "m/s^3", 3, 0.01),))


def hour() -> tuple[SensorResiduals, Hypothesis]:
    """Return an accelerometer's hour that drifts by 10 mm/s^2, and that drift."""
    rng = np.random.default_rng(4)
    day = nulls.schedule(rng)
    drift = np.outer(np.linspace(0.0, 0.01, day.t.size), [1.0, -1.0, 0.5])
    residuals = by_sensor(nulls.bins_of(rng, day, "white", drift), nulls.G)[0]
    return residuals, Hypothesis(
        RAMP, {}, residuals.columns_of(on_axes(residuals.bins.t / residuals.bins.span[1]))
    )


def shapes(residuals: SensorResiduals) -> list[list[Array]]:
    """Return, for each view, white noise and what is absorbed."""
    made = []
    for view in residuals.views:
        shape = np.diag(view.variance)
        if view.absorbed is not None:
            shape = shape + view.absorbed @ view.absorbed.T
        made.append([shape])
    return made


def only_the_norm(*, absorbed: bool = False) -> tuple[SensorResiduals, Hypothesis, NDArray[np.int64]]:
    """Return the hour with nothing but its norm view, without a baseline, its drift, and each bin's fold.

    absorbed: whether the affine parameters are estimated with it.
    """
    residuals, ramp = hour()
    view = residuals.views[0]
    kept = view.absorbed if absorbed else None
    view = replace(view, baseline=np.zeros((1, view.y.size, 0)), absorbed=kept)
    start, end = residuals.bins.span
    at = (view.t - start) / (end - start)
    fold = np.minimum((at * 4 * FOLDS).astype(int), 4 * FOLDS - 1) % FOLDS
    return replace(residuals, views=(view,)), ramp, fold


def test_the_log_score_is_that_of_all_less_that_of_the_others() -> None:
    norm, ramp, fold = only_the_norm()
    columns = ramp.columns[0][0] * ramp.sizes
    view, shape, y = norm.views[0], shapes(norm)[0][0], norm.views[0].y[0]
    expected = 0.0
    for k in range(FOLDS):
        rest = fold != k
        inside = np.ix_(rest, rest)
        left = float(y[rest] @ np.linalg.solve((shape + columns @ columns.T)[inside], y[rest]))
        scale = (view.known + left) / (view.known + rest.sum())
        spreads = [scale * shape + size**2 * columns @ columns.T for size in SIZES]
        expected += np.logaddexp.reduce([multivariate_normal.logpdf(y, cov=s) for s in spreads])
        expected -= np.logaddexp.reduce([multivariate_normal.logpdf(y[rest], cov=s[inside]) for s in spreads])
    assert held_out(norm, shapes(norm), [[ramp]]).log_score == pytest.approx(expected, abs=1e-3)


def test_left_out_bins_are_compared_with_what_the_others_make_expected() -> None:
    """The effect's sizes are averaged over their prior, and over the grid points, as likely as each is."""
    norm, ramp, fold = only_the_norm()
    late = replace(ramp, columns=tuple(np.maximum(c - 0.5 * c[:, -1:], 0.0) for c in ramp.columns))
    view, shape, y = norm.views[0], shapes(norm)[0][0], norm.views[0].y[0]
    missed = []
    for k in range(FOLDS):
        rest = fold != k
        inside, likely, expected = np.ix_(rest, rest), [], []
        for columns in (h.columns[0][0] * h.sizes for h in (ramp, late)):
            left = float(y[rest] @ np.linalg.solve((shape + columns @ columns.T)[inside], y[rest]))
            scale = (view.known + left) / (view.known + rest.sum())
            for size in SIZES:
                signal = size**2 * columns @ columns.T
                spread = (scale * shape + signal)[inside]
                likely.append(multivariate_normal.logpdf(y[rest], cov=spread))
                expected.append(signal[np.ix_(~rest, rest)] @ np.linalg.solve(spread, y[rest]))
        weights = np.exp(np.array(likely) - np.logaddexp.reduce(likely))
        missed.append(y[~rest] - weights @ np.array(expected))
    found = held_out(norm, shapes(norm), [[ramp], [late]])
    assert rms(found.missed) == pytest.approx(rms(np.concatenate(missed)), rel=1e-6)


def test_leverage_is_the_variance_of_the_model_that_the_other_bins_tell() -> None:
    """Of all that is estimated together: affine parameters and the effect."""
    norm, ramp, fold = only_the_norm(absorbed=True)
    columns = ramp.columns[0][0] * ramp.sizes
    view, shape, y = norm.views[0], shapes(norm)[0][0], norm.views[0].y[0]
    assert view.absorbed is not None
    affine = view.absorbed @ view.absorbed.T
    expected = []
    for k in range(FOLDS):
        rest = fold != k
        left = float(y[rest] @ np.linalg.solve((shape + columns @ columns.T)[np.ix_(rest, rest)], y[rest]))
        scale = (view.known + left) / (view.known + rest.sum())
        model = scale * affine + columns @ columns.T
        told = model[np.ix_(~rest, rest)]
        around = model + scale * (shape - affine)
        told = told @ np.linalg.solve(around[np.ix_(rest, rest)], told.T)
        expected.append((model[np.ix_(~rest, ~rest)] - told).diagonal() / (scale * view.variance[~rest]))
    found = held_out(norm, shapes(norm), [[ramp]])
    np.testing.assert_allclose(found.leverage, np.concatenate(expected), rtol=1e-4)


def test_a_bin_that_the_others_do_not_tell_weighs_nothing() -> None:
    sure, unsure = np.zeros(20), np.where(np.arange(20) == 7, 1e6, 0.0)
    before = HeldOut(0.0, np.where(np.arange(20) == 7, 50.0, 3.0), sure, (), ())
    after = HeldOut(9.0, np.where(np.arange(20) == 7, 200.0, 1.0), unsure, (), ())
    assert rms(after.missed) > 3.0 * rms(before.missed)
    assert after.rmse(under=after) == pytest.approx(1.0, rel=0.01)
    assert before.rmse(under=after) == pytest.approx(3.0, rel=0.01)


def test_an_effect_that_is_there_leaves_little_more_than_noise() -> None:
    residuals, ramp = hour()
    noise = float(np.sqrt(np.mean(residuals.views[0].variance)))
    with_it, without = (held_out(residuals, shapes(residuals), [each]) for each in ([ramp], []))
    assert with_it.log_score > without.log_score + 20.0
    assert with_it.missed.size == residuals.views[0].y.size, "where a pose points, others do not tell"
    assert with_it.rmse(under=with_it) < 2.0 * noise
    assert with_it.rmse(under=with_it) < 0.5 * without.rmse(under=with_it)


def test_in_the_noise_of_another_model_a_model_is_judged_by_its_misses_alone() -> None:
    residuals, ramp = hour()
    with_it = held_out(residuals, shapes(residuals), [[ramp]])
    again = held_out(residuals, [], [[ramp]], with_it.noise)
    assert again.log_score == pytest.approx(with_it.log_score)
    without, in_its_noise = (
        held_out(residuals, chosen, [[]], noise)
        for chosen, noise in ((shapes(residuals), ()), ([], with_it.noise))
    )
    assert in_its_noise.log_score < without.log_score - 20.0, (
        "its own noise is larger, and allows for the ramp"
    )


def test_every_fold_chooses_its_own_shape_and_grid_point() -> None:
    residuals, ramp = hour()
    away = replace(ramp, columns=tuple(np.roll(c, 7, axis=1) for c in ramp.columns))
    good = shapes(residuals)
    wrong = [
        [
            one[0]
            * np.linspace(1.0, 400.0, len(one[0]))[:, None] ** 0.5
            * np.linspace(1.0, 400.0, len(one[0])) ** 0.5,
            *one,
        ]
        for one in good
    ]
    alone = held_out(residuals, good, [[ramp]])
    assert held_out(residuals, wrong, [[away], [ramp]]).log_score == pytest.approx(alone.log_score, abs=1e-6)
    assert held_out(residuals, good, [[away]]).log_score < alone.log_score - 3.0


def test_where_the_moment_of_a_step_is_left_out_itself_no_moment_is_chosen() -> None:
    """To choose one that the other bins do not tell would cost tens of nats, of a step that is sure."""
    rng, at = np.random.default_rng(4), 1890.0
    day = nulls.schedule(rng)
    jump = np.outer(day.t > at, [0.05, -0.05, 0.05])
    residuals = by_sensor(nulls.bins_of(rng, day, "white", jump), nulls.G)[0]
    step = Step("accel")
    moments = [
        residuals.hypothesis(step, {"t_start": at + away}) for away in (-120.0, -60.0, 0.0, 60.0, 120.0)
    ]
    alone, all_five = (
        held_out(residuals, shapes(residuals), c) for c in ([[moments[2]]], [[m] for m in moments])
    )
    assert held_out(residuals, shapes(residuals), [[moments[0]]]).log_score < alone.log_score - 30.0
    assert alone.log_score - 1.1 * np.log(5.0) < all_five.log_score < alone.log_score + 1e-6
