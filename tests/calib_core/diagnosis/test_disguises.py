"""What is no fault of a sensor but looks like one: the Earth, a bed, a car. And an axis that is stuck."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.direct.saturation import saturation
from stillcal.calib_core.diagnosis.direct.stuck import stuck
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.vibration_gate import Shaking, steady
from stillcal.calib_core.streams.samples import Samples, Sensor
from tests.calib_core.diagnosis.slow.test_findings import day_of
from tests.support.diagnosis import nulls
from tests.support.diagnosis.said import slow_findings

EARTH = 7.292e-5
QUIET = {sensor: nulls.Wander() for sensor in nulls.WHITE}


def across(rng: np.random.Generator, up: np.ndarray) -> np.ndarray:
    """Draw a unit vector (3,) across `up` (3,)."""
    drawn = np.cross(up, rng.normal(size=3))
    return np.asarray(drawn / np.linalg.norm(drawn))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_earth_turns_and_the_gyroscope_is_sound(seed: int) -> None:
    rng, day = day_of(seed)
    latitude, rate = np.radians(50.0), np.zeros((day.t.size, 3))
    for r in range(day.rest.max() + 1):
        rows = day.rest == r
        up = day.up[rows].mean(axis=0)
        rate[rows] = EARTH * (np.sin(latitude) * up + np.cos(latitude) * across(rng, up))
    residuals = by_sensor(nulls.bins_of(rng, day, QUIET, gyro_error=rate), nulls.G)[1]
    assert slow_findings(residuals) == []


@pytest.mark.slow
@pytest.mark.parametrize("tau", [40.0, 200.0, 900.0])
def test_a_bed_that_gives_way_under_the_phone_is_no_fault(tau: float) -> None:
    """Four milliradians after each move, exponentially: more than a hundred times the noise of a bin."""
    rng = np.random.default_rng(round(tau))
    day = nulls.schedule(rng)
    while not 3 <= day.rest.max() <= 9:
        day = nulls.schedule(rng)
    tilt = np.zeros((day.t.size, 3))
    for r in range(day.rest.max() + 1):
        rows = np.flatnonzero(day.rest == r)
        age = day.t[rows] - day.t[rows[0]]
        tilt[rows] = 0.004 * np.exp(-age / tau)[:, None] * across(rng, day.up[rows[0]])
    residuals = by_sensor(nulls.bins_of(rng, day, QUIET, accel_error=nulls.G * tilt), nulls.G)[0]
    assert slow_findings(residuals) == []


def car() -> tuple[Bins, np.ndarray]:
    """Return the bins of a car that stands, and which of them the idling engine shakes."""
    rng, day = day_of(2)
    bins = nulls.bins_of(rng, day, QUIET)
    loud = rng.random(len(bins)) < 0.2
    return replace(bins, vibration=0.02**2 * np.where(loud, 20.0, 1.0) * bins.vibration), loud


def test_a_car_that_turns_slowly_does_not_rest() -> None:
    bins, loud = car()
    assert bins.rate is not None
    turning = loud & (np.arange(len(bins)) % 3 == 0)
    rate = bins.rate + turning[:, None] * np.array([0.0, 0.006, 0.002])
    kept = steady(replace(bins, rate=rate), Shaking(bins.vibration))
    np.testing.assert_array_equal(kept.t, bins.t[~turning])


def test_where_nothing_is_quiet_rates_are_not_judged() -> None:
    bins, _ = car()
    driven = steady(bins, Shaking(np.full(len(bins), 0.2**2)))
    assert driven.rate is None and len(driven) == len(bins)
    assert steady(bins, Shaking(np.full(len(bins), 0.05**2))).rate is not None
    assert steady(bins, Shaking(np.full(len(bins), 0.2**2), own=0.19**2)).rate is not None, "its own noise"


def test_a_bias_that_follows_the_shaking_stays() -> None:
    bins, _ = car()
    assert bins.rate is not None
    shaken = replace(bins, rate=bins.rate + bins.vibration[:, None] * np.array([0.5, 0.0, 0.0]))
    assert len(steady(shaken, Shaking(shaken.vibration))) == len(bins)


def stream(xyz: np.ndarray) -> Samples:
    return Samples.checked(Sensor.GYROSCOPE, np.arange(len(xyz)) / 50.0, xyz, None, None)


def test_an_axis_that_is_stuck_is_found_with_its_time() -> None:
    rng = np.random.default_rng(3)
    xyz = np.round(rng.normal(0.0, 0.01, (20000, 3)) / 0.004) * 0.004
    assert stuck(stream(xyz), "gyro") is None
    xyz[5000:6000, 1] = xyz[5000, 1]
    found = stuck(stream(xyz), "gyro")
    assert found is not None and found.effect == "unknown" and found.axes == ["y"]
    assert (found.where.t_start, found.where.t_end) == pytest.approx((100.0, 120.0), abs=0.1)


def test_coarse_values_that_stay_for_a_rest_are_not_stuck() -> None:
    """Half-way between steps an axis toggles, in the middle of a step it does not, rest after rest."""
    rng = np.random.default_rng(4)
    place = np.repeat(rng.uniform(-0.5, 0.5, (20, 3)), 1000, axis=0)
    assert stuck(stream(np.round(place + rng.normal(0.0, 0.1, place.shape))), "gyro") is None


def test_what_most_samples_lie_on_is_no_limit() -> None:
    """A walk taken for a rest: its spread is no noise, and as a width it would take in every sample."""
    swing = 3.0 * np.sin(np.arange(20000)[:, None] * 0.1 + np.array([0.0, 1.0, 2.0]))
    assert saturation(stream(swing), "gyro", np.full(3, 1.0), None) is None
