"""A bias that follows a logged column is found as it follows: late, or along a curve."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.catalogue import effects_in, own_effects
from stillcal.calib_core.diagnosis.effects.covariate import CovariateBias, kind_of_column
from stillcal.calib_core.diagnosis.model.moments import first_order
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.slow.search import forward
from stillcal.calib_core.diagnosis.slow.standing import statements_of
from stillcal.calib_core.streams.time_series import TimeSeries
from tests.support.diagnosis import nulls

SECONDS, LAG = 3600, 60.0
MIDDLES = np.arange(SECONDS, dtype=np.float64) + 0.5
"""The middle of every second, s."""

SIZE = np.array([-1e-3, 0.0, 2e-3])
"""rad/s per unit, or per unit squared, by axis."""


def levels(rng: np.random.Generator) -> Array:
    """Return a load that is another one every two minutes, (SECONDS,)."""
    return np.repeat(rng.uniform(-1.0, 1.0, SECONDS // 120), 120)


def late(values: Array) -> Array:
    """Return the answer of a first-order system to values (n,) of a second each, in steps of 0.01 s."""
    out, now = np.empty(values.size), values[0]
    for i, value in enumerate(values):
        for _ in range(100):
            now += (value - now) / (100.0 * LAG)
        out[i] = now
    return out


def test_the_lag_is_that_of_a_first_order_system() -> None:
    values = levels(np.random.default_rng(1))
    made = first_order(TimeSeries(MIDDLES, values), LAG).at(MIDDLES)
    assert np.abs(made - late(values)).max() < 2.0 / LAG
    assert made[0] == values[0]


@pytest.mark.parametrize("form", ["late", "bent"])
def test_a_bias_is_found_in_the_form_in_which_it_follows_a_column(form: str) -> None:
    rng = np.random.default_rng(5)
    values = levels(rng)
    error = np.outer(late(values) if form == "late" else values**2, SIZE)
    bins = nulls.bins_of(rng, nulls.schedule(rng), "white", gyro_error=error)
    residuals = by_sensor(bins, nulls.G, {"load": TimeSeries(MIDDLES, values)})[1]
    effects = [e for e in effects_in(residuals) if isinstance(e, CovariateBias)]
    (stated,) = statements_of(residuals, forward(residuals, effects))
    numbers = stated.finding.parameters
    assert stated.finding.effect == "gyro_bias_load"
    sizes = numbers["slope" if form == "late" else "quadratic"]
    low, high = np.array(sizes.ci95).T
    assert (low < SIZE).all() and (high > SIZE).all()
    assert (high - low).max() < 0.2 * SIZE[2]
    if form == "late":
        shortest, longest = np.ravel(numbers["tau_s"].ci95)
        assert 0.8 * LAG < shortest < LAG < longest < 1.25 * LAG
    else:
        assert sizes.unit == "rad/s per squared unit of load"


@pytest.mark.parametrize("other", ["accel_bias", "accel_scale", "accel_slow_noise", "accel_bias_random_walk"])
def test_a_column_of_any_name_has_an_effect_that_is_taken_for_no_other(other: str) -> None:
    """The bias that followed a column `drift` was told as the drift, and `step` as a step at 0 s."""
    names = {other, *(e.name for e in own_effects())}
    for word in {name.partition("_")[2] for name in names} | {name.rpartition("_")[2] for name in names}:
        assert kind_of_column(word) == f"bias_{word}_column"
        assert kind_of_column(f"CPU {word}") == f"bias_cpu_{word}_column"
    assert kind_of_column("Battery V") == "bias_battery_v"
