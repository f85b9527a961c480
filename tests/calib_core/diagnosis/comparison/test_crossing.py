"""The temperature at which constants are compared where the slopes of two recordings differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillcal import diagnose
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.linear.reference_point import crossing_temperatures
from stillcal.calib_core.diagnosis.comparison.quantity import Part, Quantity

SLOPE = np.array([2e-3, -1e-3, 1e-3])


def side(constant: Array, slope: Array, of: str = "bias") -> dict[tuple[str, str], Quantity]:
    """Return an accelerometer's bias or scale at 24 degC and its slope, in m/s^2 or parts, and each by K."""

    def quantity(name: str, value: Array, error: float, size: float) -> Quantity:
        part = (Part(name, "m/s^2", 3),)
        each = (np.full(3, size), np.full(3, 1e-9), np.arange(3))
        return Quantity(f"accel_{of}{name}", "accel", part, value, error**2 * np.eye(3), *each)

    parts = (quantity("", constant, 1e-3, 0.5), quantity("_temperature", slope, 2e-5, 0.02))
    return {(q.effect, "accel"): q for q in parts}


@pytest.mark.parametrize(("warmer", "at"), [(8.0, 32.0), (-8.0, 16.0), (120.0, None)])
def test_biases_are_compared_where_they_meet_if_a_phone_is_ever_as_warm(
    warmer: float, at: float | None
) -> None:
    """A bias that differs for another reason was stated at 148 degC, where its sign was the opposite one."""
    sides = [side(np.zeros(3), SLOPE), side(SLOPE * warmer, np.zeros(3))]
    found = crossing_temperatures(sides, {"accel": 24.0})
    assert found == ({} if at is None else {"accel": pytest.approx(at, abs=0.5)})


def test_scales_are_compared_where_they_meet() -> None:
    """The scale is that of the correction: it falls by as much as the sensor's gain grows."""
    sides = [side(-SLOPE * 8.0, SLOPE, "scale"), side(np.zeros(3), np.zeros(3), "scale")]
    assert crossing_temperatures(sides, {"accel": 24.0}) == {"accel": pytest.approx(16.0, abs=0.5)}


def test_a_gyroscopes_scale_is_nine_numbers_of_which_temperature_moves_the_diagonal() -> None:
    mean, slope = (
        np.zeros(9),
        Quantity(
            "gyro_scale_temperature",
            "gyro",
            (Part("slope", "1/K", 3),),
            SLOPE,
            2e-5**2 * np.eye(3),
            np.full(3, 1e-3),
            np.full(3, 1e-9),
            np.arange(3),
        ),
    )
    mean[[0, 4, 8]] = -SLOPE * 6.0
    of = (np.full(9, 0.2), np.full(9, 1e-9), np.repeat(np.arange(3), 3))
    scale = Quantity("gyro_scale", "gyro", (Part("scale", "1", 9),), mean, 1e-4**2 * np.eye(9), *of)
    recorded = {(q.effect, "gyro"): q for q in (scale, slope)}
    simulated = {(q.effect, "gyro"): replace(q, value=np.zeros(q.value.size)) for q in (scale, slope)}
    found = crossing_temperatures([recorded, simulated], {"gyro": 24.0})
    assert found == {"gyro": pytest.approx(18.0, abs=0.5)}


def test_of_one_motion_a_scale_that_follows_temperature_is_not_repeated_as_a_scale() -> None:
    """It was compared where the biases agree, at the mean temperature, and there it differs."""
    rng, n = np.random.default_rng(5), 12 * 600
    turn = Rotation.random(12, rng)[np.repeat(np.arange(12), 600)]
    warm = 27.0 + 7.0 * np.sin(np.arange(n) / n * 9.0) ** 2
    force = turn.inv().apply([0.0, 0.0, 9.80665])

    def read(gain: Array) -> dict[str, Array]:
        read = force * (1.0 + gain) + rng.normal(0.0, 0.005, (n, 3))
        return {
            "t": np.arange(n) / 20.0,
            **dict(zip(("ax", "ay", "az"), read.T, strict=True)),
            "temperature": warm,
        }

    real, sim = read((warm - 27.0)[:, None] * [4e-4, 3e-4, -4e-4]), read(np.zeros((n, 3)))
    (found,) = diagnose(real, simulated=sim, paired=True).findings
    assert found["effect"] == "accel_scale_temperature"
    assert "It adds nothing at 27.0 °C" in found["statement"]
