"""A bias that bends with temperature is one effect with a curve, stated about any reference."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.linear.wanted import Wanted, proposed
from stillcal.calib_core.diagnosis.effects.temperature import BiasTemperature
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from tests.calib_core.diagnosis.slow.test_findings import day_of
from tests.support.diagnosis import nulls
from tests.support.diagnosis.said import slow_findings

SLOPE, QUADRATIC = np.array([4e-4, 0.0, -2e-4]), np.array([8e-5, -6e-5, 0.0])


def gyro_of(error: np.ndarray | None) -> SensorResiduals:
    rng, day = day_of(5)
    return by_sensor(nulls.bins_of(rng, day, "white", gyro_error=error), nulls.G)[1]


@pytest.mark.slow
def test_a_curve_is_one_effect_with_its_bend() -> None:
    _, day = day_of(5)
    warm = day.temperature - day.temperature.mean()
    (finding,) = slow_findings(gyro_of(np.outer(warm, SLOPE) + np.outer(warm**2, QUADRATIC)))
    assert finding.effect == "gyro_bias_temperature"
    bend = finding.parameters["quadratic"]
    assert bend.value == pytest.approx(QUADRATIC.tolist(), abs=1.5e-5)
    for value, (low, high) in zip(QUADRATIC, bend.ci95, strict=True):
        assert low < value < high
    assert bend.unit == "rad/s/K^2"


@pytest.mark.slow
def test_a_straight_line_has_no_bend() -> None:
    _, day = day_of(5)
    (finding,) = slow_findings(gyro_of(np.outer(day.temperature, SLOPE)))
    assert set(finding.parameters) == {"slope"}


def test_another_recording_is_asked_for_the_same_degree() -> None:
    residuals = gyro_of(None)
    for degree in (1, 2, 3):
        wanted = Wanted("gyro", residuals.hypotheses(BiasTemperature("gyro", degree))[0], {})
        found = proposed(residuals, wanted)
        assert found is not None
        assert found.columns[0].shape[2] == 3 * degree


def test_the_response_is_the_polynomial() -> None:
    moments = gyro_of(None).moments
    assert moments.temperature is not None
    response = BiasTemperature("gyro", 3).response(moments, {})
    size = np.array([1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0])
    warm = moments.temperature
    assert response @ size == pytest.approx(np.column_stack([warm, 2.0 * warm**2, 3.0 * warm**3]))
