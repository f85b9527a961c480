"""Both sides of each line that the gyroscope's fit draws, and its figures against their definitions."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec import structs

from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gyroscope import fit as gyroscope
from stillcal.calib_core.gyroscope.bias import bias_from_rests
from stillcal.calib_core.gyroscope.fit import GyroscopeSettings, Parameters
from stillcal.calib_core.gyroscope.solver import (
    NOMINAL,
    Problem,
    System,
    _covariance,
    _inliers,
    _normal_equations,
    _rate_density,
    _require_observed,
    _require_plausible,
    _searched,
    solve,
)
from tests.support.turned_phones import ACCEL, G, recorded, recording, some_phone

EVERYTHING = np.full(12, True)


# Settings


@pytest.mark.parametrize(
    "name", ["nominal_error", "bias_shift", "g_sensitivity", "max_uncertainty", "tolerance"]
)
def test_shares_lie_between_nought_and_one(name: str) -> None:
    for value in (1e-12, 1 - 1e-12):
        assert getattr(GyroscopeSettings(**{name: value}), name) == value  # type: ignore[arg-type]
    for value in (0.0, 1.0, -0.1, np.nan):
        with pytest.raises(ValueError, match=f"{name} is"):
            GyroscopeSettings(**{name: value})  # type: ignore[arg-type]


def test_the_other_settings_hold_down_to_their_limits() -> None:
    assert GyroscopeSettings(outlier=2.0, max_iterations=1).max_iterations == 1
    for bad in ({"outlier": 1.999}, {"outlier": np.nan}, {"max_iterations": 0}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            GyroscopeSettings(**bad)  # type: ignore[arg-type]


# The bias alone


def test_without_turns_all_else_is_empty_and_shaped_as_ever() -> None:
    trip = recording(20, n=5)
    for parameters in (None, Parameters.BIAS):
        found = gyroscope.fit([], ACCEL, G, rests=trip.rests, parameters=parameters)
        assert found.parameters is Parameters.BIAS
        np.testing.assert_array_equal(found.model.scale, np.eye(3))
        assert found.covariance.shape == (12, 12)
        np.testing.assert_array_equal(found.covariance[9:, 9:], found.bias.covariance)
        assert not found.covariance[:9].any() and not found.covariance[:, :9].any()
        assert (found.shift.tolist(), found.turned.tolist()) == ([0.0] * 3, [0.0] * 3)
        assert not found.g_sensitivity.any() and found.g_sensitivity.shape == (3, 3)
        assert found.g_sensitivity_uncertainty.shape == (3, 3)
        assert np.isnan(found.g_sensitivity_uncertainty).all() and np.isnan(found.shift_uncertainty).all()
        assert found.shift_uncertainty.shape == (3,)
        assert (found.before.size, found.after.size, found.rejected, found.iterations) == (0, 0, (), 0)
        assert np.isnan([found.rms_before, found.rms_after, found.variance_factor]).all()
        assert [m[-len("x level, from rest to rest") :][0] for m in found.missing] == ["x", "y", "z"]


def test_each_rest_counts_once_for_the_bias() -> None:
    """Turns share rests with their neighbours, and the rests may be given again."""
    trip = recording(21, n=12)
    fitted = gyroscope.fit(trip.turns, ACCEL, G, rests=trip.rests)
    assert fitted.bias.n_rests == len(trip.rests) == 13
    np.testing.assert_array_equal(fitted.bias.bias, bias_from_rests(trip.rests).bias)


def test_a_scale_that_is_held_is_nominal_and_judged_by_the_residuals() -> None:
    """A true scale of one: squared residuals are what their uncertainties promise, 120 of them (sd 0.13)."""
    rng = np.random.default_rng(5)
    trip = recorded(rng, some_phone(rng, scale=np.eye(3)), 60)
    found = trip.fit(parameters=Parameters.BIAS)
    np.testing.assert_array_equal(found.model.scale, np.eye(3))
    assert (found.iterations, found.rejected, found.missing) == (0, (), ())
    assert not found.covariance[:9].any() and found.shift.tolist() == [0.0] * 3
    assert 0.6 < found.variance_factor < 1.5
    np.testing.assert_allclose(found.before, found.after, atol=1e-4)  # the force along each turn differs


# What a fit reports


def test_three_scale_factors_leave_the_rest_nominal() -> None:
    rng = np.random.default_rng(6)
    scale = np.diag([1.03, 0.98, 1.01])
    trip = recorded(rng, some_phone(rng, scale=scale), 20)
    found = trip.fit(parameters=Parameters.SCALE3)
    off = ~np.eye(3, dtype=bool)
    assert not found.model.scale[off].any() and not found.scale_uncertainty[off].any()
    assert (found.scale_uncertainty[np.eye(3, dtype=bool)] > 0).all()
    np.testing.assert_allclose(np.diag(found.model.scale), np.diag(scale), atol=5e-4)


def test_figures_are_over_the_turns_used() -> None:
    trip = recording(11, n=20)
    turn = trip.turns[7]
    clipped = replace(turn, rates=np.clip(turn.rates, *np.quantile(turn.rates, (0.1, 0.9), axis=0)))
    spoilt = [*trip.turns[:7], clipped, *trip.turns[8:]]
    found = gyroscope.fit(spoilt, ACCEL, G)
    used = np.arange(20) != 7
    assert found.rejected == (7,)
    assert found.before.shape == found.after.shape == (20,)
    for rms, gravity_rms, angles in (
        (found.rms_before, found.gravity_rms_before, found.before),
        (found.rms_after, found.gravity_rms_after, found.after),
    ):
        assert rms == pytest.approx(np.sqrt(np.mean(angles[used] ** 2)))
        assert gravity_rms == pytest.approx(G * rms)
    assert found.after[7] > 50 * found.rms_after
    path = np.zeros(3)
    for t in (s for s, use in zip(spoilt, used, strict=True) if use):
        path += np.trapezoid(np.abs(t.rates - trip.phone.bias), t.t, axis=0)
    np.testing.assert_allclose(found.turned, path, rtol=0.06)
    np.testing.assert_array_equal(found.covariance[9:, 9:], found.bias.covariance)
    assert not found.covariance[9:, :9].any() and not found.covariance[:9, 9:].any()
    assert found.covariance[:9, :9].any(axis=1).all()
    assert 2 <= found.iterations <= 2 * GyroscopeSettings().max_iterations


def test_before_is_what_the_nominal_scale_leaves() -> None:
    trip = recording(12, n=16)
    nominal = gyroscope.residuals(trip.turns, ACCEL, np.eye(3))
    np.testing.assert_allclose(trip.fit().before, nominal, rtol=1e-6)


def test_residuals_are_what_their_uncertainties_promise() -> None:
    """30 phones of 20 turns: 31 degrees of freedom each; the mean of the factor has an sd of 0.046."""
    factors = [recording(seed, n=20).fit().variance_factor for seed in range(300, 330)]
    assert 0.85 < np.mean(factors) < 1.15


def test_a_bias_that_differs_while_turning_is_found_as_a_shift() -> None:
    trip = recording(31, n=40)
    shift = np.array([2e-4, -3e-4, 1e-4])
    turns = []
    for turn in trip.turns:
        inside = (turn.t > turn.before.t_end) & (turn.t < turn.after.t_start)
        turns.append(replace(turn, rates=turn.rates + inside[:, None] * shift))
    found = gyroscope.fit(turns, ACCEL, G)
    assert (np.abs(found.shift - shift) < 4 * found.shift_uncertainty).all()
    assert np.linalg.norm(found.shift - shift) < 0.5 * np.linalg.norm(shift)
    assert (
        found.shift_uncertainty < GyroscopeSettings().bias_shift * np.sqrt(found.variance_factor + 1)
    ).all()
    tight = gyroscope.fit(turns, ACCEL, G, settings=GyroscopeSettings(bias_shift=1e-7))
    assert np.abs(tight.shift).max() < 1e-5


# Lines of the search


@pytest.mark.parametrize(("length", "inside"), [(4.49, True), (4.51, False)])
def test_a_turn_is_left_out_beyond_so_many_standard_deviations(length: float, inside: bool) -> None:
    """Where the others are as quiet as promised or quieter, the promise counts."""
    lengths = np.array([0.1] * 9 + [length])
    assert _inliers(lengths, 9, 4.5).tolist() == [True] * 9 + [inside]


@pytest.mark.parametrize(("share", "inside"), [(0.999, True), (1.001, False)])
def test_a_robust_spread_counts_where_all_are_louder_than_promised(share: float, inside: bool) -> None:
    """The median length of a normal 2-vector is sqrt(2 ln 2); nine of 20 degrees go to the scale."""
    spread = 3.0 / (np.sqrt(2 * np.log(2)) * np.sqrt(11 / 20))
    lengths = np.array([3.0] * 9 + [share * 4.5 * spread])
    assert _inliers(lengths, 9, 4.5)[-1] == inside
    one = _inliers(np.array([3.0]), 9, 4.5)  # two equations for nine elements: one degree is taken
    assert one.tolist() == [True]


def test_what_is_known_of_the_shift_stands_beside_the_turns() -> None:
    theta = np.arange(12.0)
    slopes, misfit = np.zeros((4, 12)), np.ones(4)
    slopes[0, 3] = 2.0
    normal, gradient = _normal_equations(slopes, misfit, theta, GyroscopeSettings(bias_shift=0.5))
    np.testing.assert_array_equal(np.diag(normal), [0, 0, 0, 4, 0, 0, 0, 0, 0, 4, 4, 4])
    np.testing.assert_array_equal(gradient, [0, 0, 0, 2, 0, 0, 0, 0, 0, 36, 40, 44])


@pytest.mark.parametrize(("factor", "counts"), [(0.5, 1.0), (1.5, 1.5)])
def test_residuals_louder_than_promised_widen_the_covariance_and_quiet_ones_do_not(
    factor: float, counts: float
) -> None:
    free = EVERYTHING.copy()
    free[[1, 10]] = False
    found = np.diag(_covariance(np.diag(np.full(12, 4.0)), free, factor))
    expected = counts * np.array([1 / 5] * 9 + [1 / 4] * 3)  # the scale has a weak prior of variance 1
    np.testing.assert_allclose(found, np.where(free, expected, 0.0))


@pytest.mark.parametrize("element", range(9))
def test_a_scale_half_off_its_nominal_value_is_no_scale(element: int) -> None:
    for off, plausible in (
        (0.4999, True),
        (-0.4999, True),
        (0.5001, False),
        (-0.5001, False),
        (np.nan, False),
    ):
        theta = NOMINAL.copy()
        theta[element] += off
        theta[9:] = 7.0  # the shift is no matter of the scale
        if plausible:
            _require_plausible(theta)
        else:
            with pytest.raises(NotSupported, match="off its nominal value"):
                _require_plausible(theta)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("row", range(3))
def test_a_column_of_the_scale_is_observed_to_half_a_per_cent(row: int, axis: int) -> None:
    for sd, observed in ((0.00499, True), (0.00501, False)):
        variances = np.full(12, 1e-8)
        variances[3 * row + axis] = sd**2
        variances[9:] = 1.0
        if observed:
            _require_observed(np.diag(variances), 0.005)
        else:
            with pytest.raises(NotSupported, match=f"gyroscope's {'xyz'[axis]} scale") as refusal:
                _require_observed(np.diag(variances), 0.005)
            assert len(refusal.value.missing) == 1


def test_the_search_takes_as_many_steps_as_it_may() -> None:
    problem = Problem.of(recording(13, n=12).turns, ACCEL, GyroscopeSettings())
    steps = _searched(problem, EVERYTHING, NOMINAL, 0.0, 1e-7).iterations
    assert steps > 2
    enough = replace(problem, settings=GyroscopeSettings(max_iterations=steps))
    assert _searched(enough, EVERYTHING, NOMINAL, 0.0, 1e-7).iterations == steps
    fewer = replace(problem, settings=GyroscopeSettings(max_iterations=steps - 1))
    with pytest.raises(NotSupported, match=f"did not settle in {steps - 1} iterations"):
        _searched(fewer, EVERYTHING, NOMINAL, 0.0, 1e-7)


def test_a_search_that_starts_at_its_end_takes_one_step() -> None:
    problem = Problem.of(recording(13, n=12).turns, ACCEL, GyroscopeSettings())
    found = _searched(problem, EVERYTHING, NOMINAL, 0.0, 1e-9)
    assert _searched(problem, EVERYTHING, found.theta, 0.0, 1e-6).iterations == 1


def test_the_shift_counts_among_the_residuals_by_what_is_known_beforehand() -> None:
    """The variance factor: squares of whitened residuals and of the shift over its prior sd, per degree."""
    trip = recording(31, n=40)
    turns = []
    for turn in trip.turns:
        inside = (turn.t > turn.before.t_end) & (turn.t < turn.after.t_start)
        turns.append(replace(turn, rates=turn.rates + inside[:, None] * 4e-4))
    settings = GyroscopeSettings(bias_shift=1e-4)
    posed, found = solve(Problem.of(turns, ACCEL, settings), Parameters.FULL9)
    _, misfit = posed.at(found.theta, 0.0).whitened(found.used)
    prior = ((found.theta[9:] / 1e-4) ** 2).sum()
    assert prior > 3.0
    expected = (misfit @ misfit + prior) / (2 * found.used.sum() - 9)
    assert found.variance_factor == pytest.approx(expected, rel=1e-3)


def test_steps_of_both_searches_are_counted() -> None:
    problem = Problem.of(recording(13, n=12).turns, ACCEL, GyroscopeSettings())
    rough = _searched(problem, EVERYTHING, NOMINAL, 0.15, 1e-3)
    fine = _searched(problem.along(rough.theta), EVERYTHING, rough.theta, 0.0, 1e-7)
    assert (
        recording(13, n=12).fit(parameters=Parameters.FULL9).iterations == rough.iterations + fine.iterations
    )


def test_lengths_and_whitening_go_by_the_covariance() -> None:
    covariance = np.diag([4.0, 1.0, 9.0, 16.0])
    covariance[0, 1] = covariance[1, 0] = 1.0
    residuals = np.array([[2.0, 1.0], [6.0, 4.0]])
    slopes = np.random.default_rng(1).normal(size=(2, 2, 12))
    system = System(SimpleNamespace(residuals=residuals), slopes, covariance)  # type: ignore[arg-type]
    inverse = np.linalg.inv(covariance[:2, :2])
    np.testing.assert_allclose(
        system.lengths(), [np.sqrt(residuals[0] @ inverse @ residuals[0]), np.sqrt(36 / 9 + 16 / 16)]
    )
    white, misfit = system.whitened(np.array([True, True]))
    flat = slopes.reshape(4, 12)
    np.testing.assert_allclose(white.T @ white, flat.T @ np.linalg.inv(covariance) @ flat, rtol=1e-9)
    assert misfit @ misfit == pytest.approx((system.lengths() ** 2).sum())
    white, misfit = system.whitened(np.array([False, True]))
    np.testing.assert_allclose(misfit, [2.0, 1.0])
    np.testing.assert_allclose(white, flat[2:] / np.array([[3.0], [4.0]]))


def test_a_start_that_may_be_wrong_is_allowed_for_by_the_angle_turned() -> None:
    trip = recording(14, n=6)
    problem = Problem.of(trip.turns, ACCEL, GyroscopeSettings())
    sure, unsure = (problem.at(NOMINAL, allowance).covariance for allowance in (0.0, 0.1))
    added = np.diag(unsure - sure).reshape(-1, 2)
    paths = [np.linalg.norm(np.trapezoid(np.abs(t.rates - trip.phone.bias), t.t, axis=0)) for t in trip.turns]
    np.testing.assert_allclose(added, (0.1 * np.array(paths))[:, None] ** 2 * np.ones(2), rtol=0.06)
    off = ~np.eye(12, dtype=bool)
    np.testing.assert_array_equal(unsure[off], sure[off])


def test_the_rates_noise_is_the_median_of_the_rests() -> None:
    """Angle random walk: the variance of a rest's mean rate times its length, averaged over the axes."""
    rests = recording(15, n=2).rests
    known = [
        structs.replace(r, t_start=0.0, t_end=length, rate_uncertainty=np.array(sd))
        for r, length, sd in zip(
            rests, (4.0, 2.0, 1.0), ([1.0, 2.0, 2.0], [1.0, 1.0, 1.0], [3.0, 0, 0]), strict=True
        )
    ]
    assert _rate_density(known) == pytest.approx(3.0)  # of 12, 2 and 3
    none = [structs.replace(r, rate_uncertainty=None) for r in rests]
    assert _rate_density(none) == 0.0
