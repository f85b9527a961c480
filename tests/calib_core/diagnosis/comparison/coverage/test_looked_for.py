"""Why an effect was not looked for: that of a logged column needs the column, whatever its name says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import direct_checks, obstacle, of_motion
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.effects.covariate import kind_of_column
from stillcal.calib_core.diagnosis.effects.followed import driver_of, follows_temperature, follows_time
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.calib_core.streams.time_series import TimeSeries
from stillcal.replay.diagnosis.judged import examined
from tests.support.diagnosis.turned_pairs import turned


@pytest.mark.parametrize("column", ["temperature 2", "charging_bias", "warmup"])
def test_a_column_named_as_another_driver_needs_no_such_driver(column: str) -> None:
    """Without a thermometer it was said that there is "no temperature" for the column `temperature 2`."""
    t = np.arange(0.0, 600.0, 0.04)
    xyz = np.array([0.0, 0.0, 9.81]) + np.random.default_rng(0).normal(0.0, 0.01, (t.size, 3))
    samples = Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz))
    exam = examine(samples, None, sought=(), covariates={column: TimeSeries(t, np.sin(t / 100.0))})
    effect = f"accel_{kind_of_column(column)}"
    assert exam.sensors[0].column_means.keys() == {column}
    assert obstacle(exam, effect, "accel") is None
    assert obstacle(exam, "accel_bias_temperature", "accel") == "no temperature"


@pytest.mark.parametrize(
    ("driver", "time", "temperature"),
    [
        ("time since start", True, False),
        ("charging and use", True, False),
        ("temperature", False, True),
        ("attitude", False, False),
        (driver_of("uptime"), False, False),
        (driver_of("board temperature"), False, False),
    ],
)
def test_what_an_effect_follows_is_read_of_what_is_no_columns_name(
    driver: str, time: bool, temperature: bool
) -> None:
    assert (follows_time(driver), follows_temperature(driver)) == (time, temperature)


def test_a_delay_that_turns_do_not_agree_about_is_not_compared() -> None:
    """It was counted as a check that was made, and a recording that no delay fits was said to match."""
    exam = examined(turned(1), sought=())
    assert exam.delay is not None and [c.reason for c in of_motion(exam)] == [None, None]
    untold = replace(exam, delay=None, why_no_delay="its axes do not agree about it")
    assert [c.reason for c in of_motion(untold)] == ["its axes do not agree about it", None]


@pytest.mark.parametrize("noise", [0.0, 0.0027])
def test_a_sensor_that_hardly_changes_shows_no_step(noise: float) -> None:
    """One of coarse steps that hide its noise reads as one without any noise: which it is nobody knows."""
    n, rng = 5000, np.random.default_rng(1)
    force = 0.02 * np.rint((np.array([0.0, 0.0, 9.8]) + rng.normal(0.0, noise, (n, 3))) / 0.02)
    rate = rng.normal(0.0, 1e-3, (n, 3))
    assert np.count_nonzero(np.diff(force, axis=0)) < 20
    t = np.arange(n) / 10.0
    exam = examine(Samples(Sensor.ACCELEROMETER, t, force), Samples(Sensor.GYROSCOPE, t, rate), sought=())
    reasons = {c.effect: c.reason for c in direct_checks(exam)}
    assert reasons["accel_quantisation"] == "without noise and motion its values stay as they are"
    assert reasons["gyro_quantisation"] is None


@pytest.mark.parametrize(
    ("moved", "hidden"),
    [("swings", ("accel", "gyro")), ("held", ("gyro",)), ("breathes", ("gyro",))],
)
def test_where_rests_move_a_random_walk_is_not_looked_for(moved: str, hidden: tuple[str, ...]) -> None:
    exam = examined(turned(1), sought=())
    shaken = replace(exam, bins=replace(exam.bins, **{moved: True}))
    for sensor in ("accel", "gyro"):
        assert obstacle(exam, f"{sensor}_bias_random_walk", sensor) is None
        assert (obstacle(shaken, f"{sensor}_bias_random_walk", sensor) is None) == (sensor not in hidden)
