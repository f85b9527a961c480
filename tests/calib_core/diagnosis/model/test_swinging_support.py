"""What a support does that swings or turns is motion, and no error of the gyroscope."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.noise.slow_noise import hidden_by_motion
from stillcal.calib_core.diagnosis.effects.unknown import UnknownCurve
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis
from stillcal.calib_core.diagnosis.model.rates import tilt_rate
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.model.turning_support import turning
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.findings import _along_gravity, _moved_at_rest
from stillcal.calib_core.diagnosis.slow.standing import _turns
from stillcal.calib_core.maths.rms import rms
from tests.calib_core.diagnosis.slow.test_between_rest_variance import by_rest, short_rests
from tests.support.diagnosis import nulls
from tests.support.diagnosis.said import slow_findings


def moored(seed: int, family: str = "white") -> Bins:
    """Return a day on a boat whose heading swings by 3 degrees in 180 s."""
    rng, day = short_rests(seed)
    rate = 0.05 * 2.0 * np.pi / 180.0 * np.cos(2.0 * np.pi * day.t / 180.0)
    return nulls.bins_of(rng, day, family, gyro_error=day.up * rate[:, None])


def test_a_boat_whose_heading_swings_raises_no_alarm() -> None:
    residuals = by_sensor(moored(3), nulls.G)[1]
    assert slow_findings(residuals) == []
    assert hidden_by_motion(residuals), "its slow noise is the boat's"


def in_ten_attitudes(seed: int) -> tuple[np.random.Generator, nulls.Day]:
    """Draw half an hour of thirty rests of 30 to 90 s."""
    rng = np.random.default_rng([seed, 5])
    ups = rng.normal(size=(10, 3))
    ups /= np.linalg.norm(ups, axis=1, keepdims=True)
    t, rest, up, start = [], [], [], 0.0
    for r in range(30):
        seconds = 10 * int(rng.uniform(3, 10))
        t.append(start + np.arange(seconds))
        rest.append(np.full(seconds, r))
        up.append(np.tile(ups[rng.integers(10)], (seconds, 1)))
        start += seconds + rng.integers(2, 5)
    moments = np.concatenate(t)
    return rng, nulls.Day(moments, np.concatenate(rest), np.vstack(up), 25.0 + 0.0 * moments, 0.0 * moments)


@pytest.mark.slow
def test_a_steady_swing_is_no_period_of_the_bias_and_a_period_of_the_bias_is() -> None:
    """Gravity lies more on one side of an axis than on the other, so that the swing has a mean on each."""
    rng, day = in_ten_attitudes(2)
    wave = np.cos(2.0 * np.pi * day.t / 60.0)[:, None]
    swung = nulls.bins_of(rng, day, "white", gyro_error=5e-3 * day.up * wave)
    assert slow_findings(by_sensor(swung, nulls.G)[1]) == []
    still = by_sensor(nulls.bins_of(rng, day, "white"), nulls.G)
    assert not any(hidden_by_motion(residuals) for residuals in still)
    biased = nulls.bins_of(rng, day, "white", gyro_error=np.array([2e-3, -1e-3, 1e-3]) * wave)
    found = slow_findings(by_sensor(biased, nulls.G)[1])
    assert "a period in time" in {f.where.driver for f in found}


def test_in_one_rest_what_is_along_gravity_alone_may_be_a_turn() -> None:
    """Someone with the phone in a pocket turns in a chair for half a minute."""
    rng, day = in_ten_attitudes(2)
    then = (day.rest == 4) & (day.t - day.t[day.rest == 4].min() < 30.0)
    across = np.cross(day.up, np.array([0.0, 0.6, 0.8]))
    for direction, turns in ((day.up, True), (day.up + 2.0 * across, False)):
        bins = nulls.bins_of(rng, day, "white", gyro_error=1e-3 * direction * then[:, None])
        residuals = by_sensor(bins, nulls.G)[1]
        inside = np.interp(residuals.moments.t, day.t, then)
        columns = residuals.columns_of(inside[:, None, None] * np.eye(3))
        curve = UnknownCurve("gyro", "a stretch of time", lambda _: None)
        assert _turns(residuals, Hypothesis(curve, {}, columns), []) == turns


def test_rates_that_differ_from_rest_to_rest_along_gravity_alone_are_turns_of_the_support() -> None:
    """A train in its bends, the phone flat on the table and then against the window."""
    rng, day = in_ten_attitudes(2)
    up = np.where(day.rest[:, None] < 15, np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8]))
    day = replace(day, up=up)
    rate = rng.normal(0.0, 5e-3, 30)[day.rest, None]
    for direction, turns in ((day.up, True), (np.array([0.5, -0.6, 0.6]), False)):
        bins = nulls.bins_of(rng, day, "white", gyro_error=rate * direction)
        assert _along_gravity(by_sensor(bins, nulls.G)[1], []) == turns


def test_a_turn_about_gravity_is_told_from_a_bias_that_is_another_in_every_rest() -> None:
    for seed in range(3):
        bins = moored(seed)
        gravity = bins.force / np.linalg.norm(bins.force, axis=1, keepdims=True)
        between, within = turning(bins, gravity, np.zeros_like(gravity))
        assert 5e-4 < between < 3e-3 and 5e-4 < within < 3e-3
        rng, day = short_rests(seed)
        error = by_rest(rng, day, np.array([0.0, 0.0, 1e-3]))
        biased = nulls.bins_of(rng, day, "white", gyro_error=error)
        assert turning(biased, gravity, np.zeros_like(gravity)) == (0.0, 0.0)


def test_a_swing_is_followed_where_it_is_itself_taken_for_noise() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(600.0)
    angle = 0.09 * np.sin(2.0 * np.pi * t / 100.0)
    up = np.stack([np.sin(angle), np.zeros_like(t), np.cos(angle)], axis=1)
    rate = np.cross(np.gradient(up, axis=0), up)
    day = nulls.Day(t, np.zeros(600, dtype=np.int64), up, 25.0 + 0.0 * t, 0.0 * t)
    bins = nulls.bins_of(rng, day, "white", gyro_error=rate)
    bins = replace(bins, force_variance=1e3 * bins.force_variance)
    assert bins.rate is not None
    seen = tilt_rate(bins, bins.force / np.linalg.norm(bins.force, axis=1, keepdims=True))
    varies = bins.rate - bins.rate.mean(axis=0)
    assert rms((bins.rate - seen) - (bins.rate - seen).mean(axis=0)) < 0.4 * rms(varies)


@pytest.mark.parametrize("where", ["held", "breathes"])
def test_in_a_hand_or_on_a_chest_only_the_gyroscope_seems_to_wander(where: str) -> None:
    accel, gyro = by_sensor(replace(moored(3), **{where: True}), nulls.G)
    assert _moved_at_rest(gyro) and not _moved_at_rest(accel)
