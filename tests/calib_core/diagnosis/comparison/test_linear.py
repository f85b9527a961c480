"""Constants and slow effects that are measured together, in a recording in which nothing is searched for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.linear.quantities import (
    every_linear_quantity,
    linear_quantities,
)
from stillcal.calib_core.diagnosis.comparison.linear.wanted import Wanted
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.effects.catalogue import effects_in
from stillcal.calib_core.diagnosis.effects.temperature import BiasTemperature
from stillcal.calib_core.streams.samples import Samples, Sensor
from tests.calib_core.diagnosis.model.test_rotation_alignment import GYRO, day
from tests.support.diagnosis import nulls

SLOPE = np.array([5e-3, -3e-3, 4e-3])


def in_a_chamber(seed: int) -> Samples:
    """Return two hours at 1 Hz in a chamber that warms by 90 K: 12 rests near the faces of the phone."""
    rng = np.random.default_rng(seed)
    t = np.arange(7200.0)
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    tilted = faces[rng.permutation(12) % 6] + rng.normal(0.0, 0.05, (12, 3))
    up = (tilted / np.linalg.norm(tilted, axis=1, keepdims=True))[(t // 600).astype(int)]
    warm = np.interp(t, [0.0, 3600.0, 7200.0], [-20.0, 70.0, 25.0])
    force = nulls.G * up + np.outer(warm - 25.0, SLOPE) + rng.normal(0.0, 2e-3, (t.size, 3))
    return Samples.checked(Sensor.ACCELEROMETER, t, frozen(force), frozen(warm))


@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.slow), 2])
def test_a_large_effect_that_is_not_searched_for_leaves_the_constants_as_they_are(seed: int) -> None:
    """Linear about a bias that changes by 0.45 m/s^2, slopes were off by a half, angles by 0.01 rad."""
    exam = examine(in_a_chamber(seed), None, sought=())
    (own,) = exam.sensors
    effect = BiasTemperature("accel", 1)
    wanted = [Wanted("accel", own.hypothesis(effect, {}), {})]
    found = linear_quantities(exam, wanted, {"accel": 25.0})
    np.testing.assert_allclose(found[effect.name, "accel"].value, SLOPE, rtol=0.02)
    np.testing.assert_allclose(found["accel_scale", "accel"].value[3:], 0.0, atol=1e-3)


def stepping() -> Samples:
    """Return an hour at 2 Hz: 24 rests near the faces; the bias steps by 0.03 m/s^2 on z after the tenth."""
    rng = np.random.default_rng(5)
    t = np.arange(7200.0) / 2.0
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    tilted = faces[rng.permutation(24) % 6] + rng.normal(0.0, 0.2, (24, 3))
    up = (tilted / np.linalg.norm(tilted, axis=1, keepdims=True))[(t // 150).astype(int)]
    force = nulls.G * up + np.outer(t > 1500.0, [0.0, 0.0, 0.03]) + rng.normal(0.0, 2e-3, (t.size, 3))
    return Samples.checked(Sensor.ACCELEROMETER, t, frozen(force))


@pytest.mark.slow
def test_what_is_beside_the_constants_counts_as_much_as_it_is_probable() -> None:
    """What was hardly likely was taken for certain, and a scale that both had was told as different."""
    exam = examine(stepping(), None)
    (own,) = (s for s in exam.statements if s.finding.effect == "accel_bias_step")

    def bias_z(nats: float) -> tuple[float, float]:
        evidence = replace(own.finding.evidence, log_bayes_factor=nats)
        doubted = replace(own, finding=replace(own.finding, evidence=evidence))
        (found,) = (
            q
            for q in every_linear_quantity(replace(exam, statements=[doubted]), [], {})
            if q.effect == "accel_bias"
        )
        return float(found.value[2]), float(found.sigma[2])

    absent = every_linear_quantity(replace(exam, statements=[]), [], {})[0].value[2]
    (sure, narrow), (no, _), (between, wide) = (
        bias_z(nats) for nats in (60.0, -60.0, float(np.log(len(effects_in(exam.sensors[0])))))
    )
    assert abs(no - absent) < 1e-9 and abs(sure - absent) > 0.005
    np.testing.assert_allclose(between, (sure + absent) / 2.0, rtol=1e-6)
    assert wide > abs(sure - absent) / 2.0 > narrow


def test_the_gyroscopes_scale_of_few_turns_is_off_by_its_errors() -> None:
    """Nine to eleven turns: squares of what it was off by were three times those of its errors."""
    off = []
    for seed in (1, 2, 3, 5, 7, 8, 10):
        accelerometer, gyroscope, _ = day(seed, 12)
        found = linear_quantities(examine(accelerometer, gyroscope, sought=()), [], {})["gyro_scale", "gyro"]
        away = found.value - (np.linalg.inv(GYRO) - np.eye(3)).ravel()
        off.append(away @ np.linalg.solve(found.covariance, away) / away.size)
    assert 0.6 < np.mean(off) < 1.6


@pytest.mark.parametrize("seconds", [45.0, 100.0])
def test_a_rest_of_a_minute_shows_the_bias_of_a_gyroscope_and_nothing_else(seconds: float) -> None:
    """It was not compared with a simulation's: twelve bins of 10 s are needed for what changes it."""
    rng, t = np.random.default_rng(3), np.arange(0.0, seconds, 0.01)
    bias = np.array([5e-3, -1e-2, 3e-3])
    force = np.array([0.3, -0.5, 9.78]) + rng.normal(0.0, 0.02, (t.size, 3))
    rate = bias + rng.normal(0.0, 1.5e-3, (t.size, 3))
    still = (
        Samples(sensor, frozen(t), frozen(xyz))
        for sensor, xyz in ((Sensor.ACCELEROMETER, force), (Sensor.GYROSCOPE, rate))
    )
    found = linear_quantities(examine(*still), [], {})
    assert [*found] == [("gyro_bias", "gyro")]
    shown = found["gyro_bias", "gyro"]
    error = np.sqrt(shown.covariance.diagonal())
    assert (np.abs(np.abs(shown.value) - np.abs(bias)) < 3.0 * error).all() and (error < 5e-4).all()
