"""A bias that follows the rate of heating, by a thermometer with noise and steps as a phone's."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.noise.slow_noise import slow_noise
from stillcal.calib_core.diagnosis.effects.curves import heating
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.model.moments import moments_of
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.findings import slow_statements
from tests.support.diagnosis import nulls
from tests.support.diagnosis.said import slow_findings


def heated(largest: float) -> tuple[Bins, nulls.Day]:
    """Return an hour in twelve attitudes. largest: m/s^2, the bias on z where it heats fastest."""
    rng = np.random.default_rng(0)
    t = np.arange(3600.0)
    rest, left = np.divmod(t.astype(int), 90)
    up = nulls.random_attitudes(rng, 12)[rest % 12]
    warm = 25.0 + 8.0 * np.sin(2.0 * np.pi * t / 1500.0) + 3.0 * (1.0 - np.exp(-t / 600.0))
    day = nulls.Day(t, np.where(left < 82, rest, -1), up, warm, np.zeros(t.size))
    rate = np.gradient(warm)
    error = np.outer(largest * rate / np.abs(rate).max(), [0.3, 0.5, 1.0])
    quiet = {"accel": nulls.Wander(pink=3e-4), "gyro": nulls.Wander()}
    bins = nulls.bins_of(rng, day, quiet, accel_error=error, charger=False)
    assert bins.temperature is not None
    read = np.round((bins.temperature + rng.normal(0.0, 0.05, len(bins))) / 0.1) * 0.1
    return replace(bins, temperature=read), day


def test_two_milli_g_by_the_rate_of_heating_follow_it() -> None:
    """By the rate between bins they followed a period in time: the thermometer's noise is a tenth of it."""
    bins, _ = heated(0.02)
    found = slow_findings(by_sensor(bins, nulls.G)[0])
    assert [(f.effect, f.where.driver) for f in found] == [("unknown", "rate of heating")]


def test_a_rate_over_minutes_is_free_of_the_thermometers_noise() -> None:
    bins, day = heated(0.0)
    true = np.interp(bins.t, day.t, np.gradient(day.temperature))
    moments = moments_of(bins, None, {})
    between, over = (heating(moments, width) for width in (0.0, 60.0))
    assert between is not None and over is not None
    inner = slice(5, -5)  # a line at an end knows one side only
    left = [float(np.std((rate - true)[inner]) / np.std(true)) for rate in (between, over)]
    assert left[0] > 0.1 and left[1] < 0.05


def test_between_bins_that_are_far_apart_the_rate_is_that_from_one_to_the_next() -> None:
    bins, _ = heated(0.0)
    moments = moments_of(bins, None, {})
    apart = replace(moments, t=1e4 * np.arange(len(bins)))
    np.testing.assert_array_equal(heating(apart, 60.0), heating(apart, 0.0))


def quiet_day(day: nulls.Day, error: Array) -> Bins:
    """Return the bins of a day whose gyroscope is off by `error` (n, 3), rad/s, and hardly wanders."""
    quiet = {"accel": nulls.Wander(), "gyro": nulls.Wander(pink=5e-6)}
    return nulls.bins_of(np.random.default_rng(1), day, quiet, gyro_error=error, charger=False)


def read_late(late: float) -> SensorResiduals:
    """Return residuals of a gyroscope whose bias goes with a temperature that is read `late` s after it."""
    _, day = heated(0.0)
    bins = quiet_day(day, np.outer(day.temperature - 25.0, [6e-4, -5e-4, 3e-4]))
    read = np.interp(bins.t - late, day.t, day.temperature)
    return by_sensor(replace(bins, temperature=read), nulls.G)[1]


@pytest.mark.parametrize(
    ("late", "drivers"), [(2.0, ["temperature"]), pytest.param(60.0, None, marks=pytest.mark.slow)]
)
def test_a_thermometer_that_is_little_late_leaves_no_second_effect(
    late: float, drivers: list[str] | None
) -> None:
    """A second late, by a robot's rests, 1.4 % of the bias gained 7.7 % of what the whole gains."""
    found = slow_findings(read_late(late))
    assert ([f.where.driver for f in found] == ["temperature"]) is (drivers is not None)
    assert found[0].effect == "gyro_bias_temperature" or drivers is None


@pytest.mark.slow
def test_what_is_small_on_an_axis_that_the_name_hardly_moves_is_an_effect_of_its_own() -> None:
    """Of all axes together it is 3 % of the name, which moves another axis."""
    _, day = heated(0.0)
    rate = np.gradient(day.temperature)
    error = np.outer(day.temperature - 25.0, [1e-3, 0.0, 0.0])
    error += np.outer(rate / np.abs(rate).max(), [0.0, 2e-4, 0.0])
    found = slow_findings(by_sensor(quiet_day(day, error), nulls.G)[1])
    assert [(f.effect, f.axes) for f in found] == [("gyro_bias_temperature", ["x"]), ("unknown", ["y"])]


@pytest.mark.parametrize("late", [0.0, pytest.param(10.0, marks=pytest.mark.slow)])
def test_the_error_of_a_names_model_is_no_slow_noise(late: float) -> None:
    """What is fitted beside a name and not told is taken out of what wanders, too."""
    residuals = read_late(late)
    (stated,) = slow_statements(residuals)
    assert bool(stated.beside) is (late > 0.0)
    exam: Any = SimpleNamespace(statements=[stated], sensors=[residuals], streams=[])
    noise = slow_noise(exam, residuals)
    assert noise is not None and (np.exp(noise.value) < 2e-5).all()
