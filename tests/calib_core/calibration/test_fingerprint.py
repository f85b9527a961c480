"""Whose a calibration is, by bias and scale: other phones are told apart, one phone at other times is not."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy.stats import chi2

from stillcal.calib_core.accelerometer.parameters import names
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.fingerprint import (
    OTHER,
    OWN_BIAS,
    OWN_SCALE,
    _chi_square_tail,
    is_other_phone,
    likeness,
)
from stillcal.calib_core.calibration.record import AccelerometerRecord
from stillcal.calib_core.engine.full_calibration import FitTask, fit_and_decide
from stillcal.calib_core.engine.schedule import Occasion
from stillcal.replay.phone import load_scenario, simulate
from stillcal.replay.phone.population import population
from tests.calib_core.calibration.test_constancy import BIAS, GRAVITY, pool


def part(scale: Array, bias: Array, sd: float = 0.0, parameters: int = 9) -> AccelerometerRecord:
    covariance = frozen(np.eye(parameters) * sd**2)
    return AccelerometerRecord(
        scale=scale,
        bias=bias,
        parameters=parameters,
        names=names(parameters),
        covariance=covariance,
        gravity=9.8,
    )


@pytest.mark.parametrize("k", range(1, 10))
def test_the_tail_of_chi_square_is_scipys(k: int) -> None:
    for value in (0.0, 0.3, 4.0, 30.0):
        assert _chi_square_tail(value, k) == pytest.approx(float(chi2.sf(value, k)), rel=1e-9, abs=1e-15)


def test_a_population_of_phones_is_told_apart() -> None:
    """Of 40 phones as different as those of Stisen et al. 2015, 98 of 100 pairs at least."""
    truths = [simulate(load_scenario("lab"), phone, 1).truth.accelerometer for phone in population(40, 3)]
    parts = [part(np.linalg.inv(t.forward), t.bias, 1e-3) for t in truths]
    told = [likeness(one, other) < OTHER for one, other in itertools.combinations(parts, 2)]
    assert np.mean(told) > 0.98


def test_one_phone_warm_and_cold_is_one_phone() -> None:
    rng = np.random.default_rng(4)
    for _ in range(300):
        bias, scale = rng.normal(0.0, 0.3, 3), np.diag(1.0 + rng.normal(0.0, 0.01, 3))
        later = part(scale + np.diag(rng.normal(0, OWN_SCALE, 3)), bias + rng.normal(0, OWN_BIAS, 3))
        assert likeness(part(scale, bias), later) > OTHER / 10


def test_a_rotation_of_the_axes_and_what_is_not_stated_do_not_count() -> None:
    tilt = 0.05
    turned = np.array([[np.cos(tilt), -np.sin(tilt), 0], [np.sin(tilt), np.cos(tilt), 0], [0, 0, 1]])
    scale = np.diag([1.01, 0.99, 1.0])
    assert likeness(part(scale, BIAS), part(turned @ scale, BIAS)) == pytest.approx(1.0)
    skewed = scale + np.array([[0, 0.05, 0], [0, 0, 0], [0, 0, 0]])
    assert likeness(part(scale, BIAS), part(skewed, BIAS)) < OTHER
    assert likeness(part(scale, BIAS, parameters=6), part(skewed, BIAS)) > 0.5


def test_what_is_uncertain_tells_no_phones_apart() -> None:
    one, other = part(np.eye(3), np.zeros(3)), part(np.eye(3) * 1.02, np.full(3, 0.8))
    assert likeness(one, other) < OTHER
    assert likeness(one, part(np.asarray(other.scale), np.asarray(other.bias), sd=1.0)) > 0.5


def test_another_phone_under_no_name_takes_nothing_over() -> None:
    """Its scale differs by 3 % and its bias by 60 mg; the old one's rotation and terms are not its own."""
    first = fit_and_decide(replace(task(pool(25, 1)), t=-1.0)).record
    assert first is not None and first.accelerometer is not None
    second = pool(25, 2, lambda i, t: np.array([0.6, 0.4, -0.5]))
    held = [replace(h, rest=replace_force(h.rest, np.diag([1.03, 0.97, 1.02]))) for h in second.held]
    outcome = fit_and_decide(task(replace(second, held=tuple(held)), current=first, degraded=True))
    assert outcome.other_phone and outcome.accepted
    assert "another phone's" in outcome.reason and is_other_phone(outcome.record, first)
    same = fit_and_decide(task(pool(25, 3), current=first, degraded=True))
    assert not same.other_phone and "another phone" not in same.reason


def task(rests: Any, **known: Any) -> FitTask:
    confirmed = (True,) * len(rests.held)
    return FitTask(t=2000.0, occasion=Occasion.END, pool=rests, confirmed=confirmed, gravity=GRAVITY, **known)


def replace_force(rest: Any, gain: Array) -> Any:
    return msgspec.structs.replace(rest, specific_force=frozen(gain @ rest.specific_force))
