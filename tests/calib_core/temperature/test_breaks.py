"""Steps of a bias and bad rests, found in made rests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.temperature.breaks import learn
from stillcal.calib_core.temperature.regression import DEG, GYROSCOPE, Model
from tests.calib_core.temperature.test_regression import made, observed


@pytest.mark.parametrize("last", [False, True])
def test_a_knock_is_a_step_and_widens_the_uncertainty_at_once(last: bool) -> None:
    seen, _ = made(np.random.default_rng(2))
    row = len(seen.t) - 1 if last else 40
    value = seen.value + 0.2 * DEG * (np.arange(len(seen.t)) >= row)[:, None]
    model = Model(GYROSCOPE, 25.0, with_curve=True)
    knocked = learn(observed(seen.t, seen.celsius, value), model, float(seen.t[-1]))
    calm = learn(seen, model, float(seen.t[-1]))
    assert [step.t for step in knocked.steps] == [seen.t[row]]
    assert knocked.bias == pytest.approx(calm.bias + 0.2 * DEG, abs=5e-3 * DEG)
    assert knocked.curve[0] == pytest.approx(calm.curve[0], abs=0.02 * DEG)


def test_one_bad_rest_is_doubted_and_changes_little() -> None:
    seen, _ = made(np.random.default_rng(3))
    value = seen.value.copy()
    value[30] += 0.2 * DEG
    model = Model(GYROSCOPE, 25.0, with_curve=True)
    fit = learn(observed(seen.t, seen.celsius, value), model, float(seen.t[-1]))
    calm = learn(seen, model, float(seen.t[-1]))
    assert fit.doubted == (30,) and fit.steps == ()
    assert fit.bias == pytest.approx(calm.bias, abs=1e-3 * DEG)


def test_without_rests_there_is_nothing_to_learn() -> None:
    none = observed(np.zeros(0), np.zeros(0), np.zeros((0, 3)))
    with pytest.raises(ValueError, match="no rests"):
        learn(none, Model(GYROSCOPE, 25.0, with_curve=True), 0.0)


def test_without_a_search_the_wander_stays_until_a_rest_misses_its_prediction() -> None:
    seen, _ = made(np.random.default_rng(2))
    model, now = Model(GYROSCOPE, 25.0, with_curve=True), float(seen.t[-1])
    searched = learn(seen, model, now)
    held = replace(searched.wander, flicker=1.2 * searched.wander.flicker)
    kept = learn(seen, model, now, held, search=False)
    assert kept.wander == held
    assert kept.bias == pytest.approx(searched.bias, abs=1e-3 * DEG)
    value = seen.value + 0.2 * DEG * (np.arange(len(seen.t)) >= 40)[:, None]
    knocked = observed(seen.t, seen.celsius, value)
    fit = learn(knocked, model, now, held, search=False)
    again = learn(knocked, model, now, held)
    assert [step.t for step in fit.steps] == [seen.t[40]] and fit.log_likelihood == again.log_likelihood
