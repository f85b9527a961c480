"""The page's curves: every one over its own driver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.pair.alignment import Readings
from stillcal.calib_core.diagnosis.comparison.pair.pair_residuals import pair_residuals
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.phone.case import Case
from stillcal.replay.diagnosis.report.curves import affine_columns, curves_of
from stillcal.replay.diagnosis.report.figures import broken
from stillcal.replay.diagnosis.report.page import element_labels
from stillcal.replay.diagnosis.report.sides import Side

SENSITIVE: dict[str, object] = {
    "name": "gyro_g_sensitivity",
    "matrix": [[0.0, 0.0, 4e-4], [3e-4, 0.0, 0.0], [0.0, -4e-4, 2e-4]],
}


def test_affine_columns_leave_a_change_of_the_norm_that_is_no_matter_of_attitude() -> None:
    rng = np.random.default_rng(3)
    up = rng.normal(size=(200, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    columns = affine_columns(up)
    error = rng.normal(size=200)
    left = error - columns @ np.linalg.lstsq(columns, error, rcond=None)[0]
    assert np.linalg.matrix_rank(columns) == 9
    np.testing.assert_allclose(left.std() / error.std(), np.sqrt(191 / 200), rtol=0.05)


@pytest.mark.slow
def test_a_matrix_is_drawn_as_a_line_over_the_one_force_that_it_is_drawn_against(
    case_with: Callable[..., Case],
) -> None:
    case = case_with(SENSITIVE)
    (one,) = [m for m in case.mapped if m.finding.effect == SENSITIVE["name"]]
    curves = curves_of(one, case.bins, case.conditions, case.affine, case.gravity)
    assert curves
    for curve in curves:
        assert curve.partial_component is not None
        slope, offset = np.polyfit(curve.x, curve.partial_component, 1)
        np.testing.assert_allclose(curve.partial_component, slope * curve.x + offset, atol=1e-9)
        row = np.asarray(SENSITIVE["matrix"])["xyz".index(curve.axis)]
        assert abs(slope - row[np.argmax(np.abs(row))]) < 5e-5


def test_a_line_is_broken_where_no_point_is_and_not_between_rests_that_are_alike_far_apart() -> None:
    t = np.array([0.0, 10.0, 20.0, 200.0, 210.0, 220.0])
    x, y = broken(t, t + 1.0, 1000.0)
    assert np.flatnonzero(np.isnan(x)).tolist() == [3] == np.flatnonzero(np.isnan(y)).tolist()
    even = np.arange(0.0, 1000.0, 100.0)
    assert np.isfinite(broken(even, even, 1000.0)[0]).all()


def rocked(sensor: str, size: float, seed: int) -> Side:
    """Rest for 25 minutes in five attitudes; the gyroscope's z follows a sine of 90 s of this size, rad/s."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 1500.0, 0.2)
    up = rng.normal(size=(5, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    force = 9.80665 * up[(t // 300.0).astype(int)] + rng.normal(0.0, 0.003, (t.size, 3))
    rate = rng.normal(0.0, 3e-4, (t.size, 3))
    rate[:, 2] += size * np.sin(2.0 * np.pi * t / 90.0)
    samples = [Samples.checked(s, t, v) for s, v in ((Sensor.ACCELEROMETER, force), (Sensor.GYROSCOPE, rate))]
    exam = examine(*samples, sought=())
    return Side("recorded", "#000000", "parameters" if sensor == "recorded" else "simulated", exam)


def test_a_period_is_folded_and_drawn_beside_a_simulation_that_has_none_of_it() -> None:
    size = 4e-4
    period = {"value": 90.0, "unit": "s"}
    amplitude = {"value": [0.0, 0.0, size, 0.0, 0.0, 0.0], "unit": "rad/s"}
    answered = {
        "effect": "unknown",
        "sensor": "gyro",
        "axes": ["z"],
        "where": {"t_start": 0.0, "t_end": 1500.0, "band_hz": [0.0, 0.05], "driver": "a period in time"},
        "parameters": {"amplitude": amplitude, "period_s": period},
        "simulated": {"amplitude": {"value": [0.0] * 6, "unit": "rad/s"}},
    }
    (recorded,) = rocked("recorded", size, 1).curves(answered)
    (simulated,) = rocked("simulated", 0.0, 2).curves(answered)
    assert recorded.x.max() <= 90.0 and recorded.x_name == simulated.x_name
    wave = recorded.partial_component
    assert wave is not None and np.abs(wave).max() == pytest.approx(size, rel=0.02)
    assert (recorded.partial_point - wave).std() < 0.3 * recorded.partial_point.std()
    assert simulated.partial_component is None and np.abs(simulated.point).max() < 0.3 * size
    labels = element_labels(answered, "amplitude", 6)
    assert labels[2] == "sine of z" and labels[3] == "cosine of x"


def test_a_pair_draws_the_difference_of_two_sensors_however_they_were_moved() -> None:
    slope, rng = 4e-3, np.random.default_rng(5)
    t = np.arange(0.0, 900.0, 0.1)
    moved = 9.8 + rng.normal(0.0, 2.0, (t.size, 3))
    warm = 25.0 + 5.0 * np.sin(t / 150.0)
    left = rng.normal(0.0, 0.003, (t.size, 3)) + np.outer(slope * (warm - 25.0), [1.0, 0.0, 0.0])
    force = Samples.checked(Sensor.ACCELEROMETER, t, moved)
    apart = Samples.checked(Sensor.ACCELEROMETER, t, left, warm)
    bins, sensors = pair_residuals(Readings(apart, None), Readings(force, None), [], 0.0)
    exam = replace(examine(force, None, sought=()), bins=bins, sensors=sensors, statements=[])
    answered = {
        "effect": "accel_bias_temperature",
        "sensor": "accel",
        "axes": ["x"],
        "where": {"t_start": 0.0, "t_end": 900.0, "band_hz": [0.0, 0.05], "driver": "temperature"},
        "parameters": {"slope": {"value": [slope, 0.0, 0.0], "unit": "m/s^2/K"}},
        "simulated": {},
    }
    side = Side("recorded", "#000000", "parameters", exam)
    (curve,) = side.curves(answered)
    assert side.paired and curve.partial_component is not None
    assert (curve.point - curve.partial_component).std() < 0.1 * curve.point.std()
