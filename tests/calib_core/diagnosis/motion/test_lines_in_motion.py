"""A vibration shakes both sensors in phases of their own, which are no arm; an arm is told beside it."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.streams.samples import Samples, Sensor


@pytest.mark.parametrize("arm", [0.0, 0.15])
def test_a_vibration_in_both_sensors_is_no_arm_and_hides_none(arm: float) -> None:
    """Of 0.02 m/s^2 and 2 mrad/s at 11 Hz an arm of 14 cm was told, where one lags by a quarter of a turn."""
    rng, t = np.random.default_rng(1), np.arange(0.0, 300.0, 0.02)
    part = np.clip((t % 23.0 - 20.0) / 3.0, 0.0, 1.0)
    angle = (t // 23.0 + part**3 * (10.0 - 15.0 * part + 6.0 * part**2)) * np.pi / 2.5
    speed = np.gradient(angle, t)
    # It turns about y; an arm along z feels the change of the rate along x, and pulls inward along z.
    force = 9.80665 * np.stack([np.sin(angle), 0.0 * t, np.cos(angle)], axis=1)
    force += arm * np.stack([-np.gradient(speed, t), 0.0 * t, -(speed**2)], axis=1)
    rate = np.stack([0.0 * t, -speed, 0.0 * t], axis=1)
    force += rng.normal(0.0, 0.01, force.shape)
    rate += rng.normal(0.0, 1e-3, rate.shape)
    force[:, 2] += 0.02 * np.sin(2.0 * np.pi * 11.0 * t)
    rate[:, 0] += 2e-3 * np.cos(2.0 * np.pi * 11.0 * t)
    streams = ((Sensor.ACCELEROMETER, force), (Sensor.GYROSCOPE, rate))
    shown = examine(*(Samples(sensor, frozen(t), frozen(xyz)) for sensor, xyz in streams), sought=())
    found = [
        s.finding.parameters["position"].value for s in shown.statements if s.finding.effect == "lever_arm"
    ]
    assert len(found) == (arm > 0.0)
    if found:
        assert np.asarray(found[0])[[0, 2]] == pytest.approx([0.0, arm], abs=0.02)
