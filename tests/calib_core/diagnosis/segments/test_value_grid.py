"""The error that coarse steps leave in the mean of a rest, told from the codes that rests reach."""

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.segments.value_grid import (
    comb_step,
    keeps_to,
    rounding_error,
    step_at_rest,
)

STEP = 0.05
SAMPLES = 500


def rests(noise: float, places: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the means and variances (n, 3) of rounded rests; noise and places of the true means in steps."""
    rng = np.random.default_rng(5)
    true = np.array(places)[:, None, None] + rng.normal(0.0, noise, (len(places), SAMPLES, 3))
    values = STEP * np.rint(true)
    return values.mean(axis=1), values.var(axis=1)


@pytest.mark.parametrize("places", [[3.0, 7.1, 9.5], [0.1, 5.5, 8.4], [2.0, 2.02, -7.9]])
@pytest.mark.parametrize("noise", [0.26, 0.4])
def test_few_rests_tell_it_wherever_their_means_lie_between_two_codes(
    noise: float, places: list[float]
) -> None:
    """The variance of the values alone is up to twice as large midway between two codes as on one of them."""
    expected = STEP / np.pi / np.sqrt(2.0) * np.exp(-2.0 * (np.pi * noise) ** 2)
    assert rounding_error(*rests(noise, places), np.full(3, STEP)) == pytest.approx(expected, rel=0.45)


def test_noise_that_reaches_no_third_code_leaves_all_of_the_error() -> None:
    error = rounding_error(*rests(0.05, [0.5, 4.48, 7.0]), np.full(3, STEP))
    assert error == pytest.approx(STEP / np.sqrt(12.0), rel=0.1)


@pytest.mark.parametrize("apart", [0.25, 1.0])
def test_a_few_rests_in_which_the_bias_goes_from_code_to_code_tell_no_noise(apart: float) -> None:
    """Two of 32, weighed by what they show, made a noise of 0.2 steps one of half a step."""
    mean, variance = rests(0.2, [0.1, 3.3, 5.9, 8.0] * 8)
    variance[:2] += (apart * STEP) ** 2 * np.array([[1.0], [4.0]])
    expected = STEP / np.pi / np.sqrt(2.0) * np.exp(-2.0 * (np.pi * 0.2) ** 2)
    assert rounding_error(mean, variance, np.full(3, STEP)) == pytest.approx(expected, rel=0.25)


def test_no_step_leaves_no_error() -> None:
    assert not rounding_error(*rests(0.3, [0.0, 1.0]), np.zeros(3)).any()


@pytest.mark.parametrize("count", [8, 60, 135])
def test_few_values_lie_on_no_grid_by_chance(count: int) -> None:
    """A fourth of such draws had a step: a simulation without noise has few values, those of its turns."""
    drawn = [np.random.default_rng(seed).normal(0.0, 0.5, count) for seed in range(200)]
    assert sum(comb_step(values) is not None for values in drawn) <= 3


def test_few_codes_are_a_grid() -> None:
    assert comb_step(np.repeat(0.0012 * np.array([3, 4, 5, 7, 12]), 40)) == pytest.approx(0.0012)


def test_few_codes_are_a_grid_that_were_printed_with_few_digits() -> None:
    codes = np.repeat(np.round(0.0012207 * np.array([3, 4, 5, 7, 12]), 5), 40)
    assert comb_step(codes) == pytest.approx(0.0012207, rel=5e-3)


def test_values_that_go_between_few_codes_have_a_step() -> None:
    """A phone that stays in one attitude reaches two to four codes: too few for a comb by themselves."""
    noise = np.random.default_rng(1).normal(0.0, 0.003, 2000)
    assert step_at_rest(0.01 * np.rint((0.203 + noise) / 0.01)) == pytest.approx(0.01)
    two_attitudes = np.repeat([0.0, 4.2, 9.8], 700)
    plugged = np.repeat(np.tile([0.2, 0.25], 20), 50)
    uneven = np.random.default_rng(2).choice([0.0, 1.0, 2.5], 2000)
    assert [step_at_rest(x) for x in (two_attitudes, plugged, uneven, np.full(2000, 9.8))] == [None] * 4


def test_the_step_of_codes_that_were_rounded_a_second_time_is_that_of_the_usual_values() -> None:
    """Counts of 41 mm/s^2 on a grid of 13.6 mm/s^2 are apart by three and, now and then, by two of it."""
    fine = 0.04086 / 3.0
    codes = np.rint(np.random.default_rng(0).normal(0.4, 0.7, 4000))
    values = fine * np.where(codes < 3.0, 3.0 * codes, 3.0 * codes - 1.0)
    assert {round(gap / fine) for gap in np.diff(np.unique(values))} == {2, 3}
    assert step_at_rest(values) == pytest.approx(3.0 * fine, rel=1e-3)
    assert step_at_rest(np.random.default_rng(0).normal(0.4, 0.7, 4000)) is None
    assert step_at_rest(np.empty(0)) is None


def test_changes_tell_a_step_though_no_grid_holds_all_values() -> None:
    values = np.random.default_rng(0).normal(0.0, 0.7, 4000)
    codes = np.rint(values)
    assert keeps_to(np.where(codes < 2.0, codes, codes - 1.0 / 3.0), 1.0)
    assert not keeps_to(values, 1.0) and not keeps_to(np.rint(2.0 * values) / 2.0, 1.0)
    assert not keeps_to(np.zeros(100), 1.0)
    assert not keeps_to(2.0 * codes, 1.0) and not keeps_to(3.0 * codes, 1.0), "a step that is coarser"
    halves = np.rint(2.0 * np.random.default_rng(1).normal(0.0, 0.2, 4000)) / 2.0
    assert not keeps_to(halves, 1.0), "a finer one, of quiet values"
