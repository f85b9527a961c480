"""A bias that settles after the start, in minutes or in hours."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.streams.samples import Samples, Sensor


@pytest.mark.parametrize("tau", [900.0, 9000.0])
def test_a_box_that_warms_up_for_hours_has_its_own_time_constant(tau: float) -> None:
    """A day's was taken for one of 18 minutes and a third of the size: no longer one was tried."""
    t = np.arange(0.0, 40.0 * tau, tau / 900.0)
    force = np.random.default_rng(1).normal([0.1, 0.2, 9.81], 1e-3, (t.size, 3))
    force[:, 2] += 0.02 * np.exp(-t / tau)
    samples = Samples(Sensor.ACCELEROMETER, frozen(t), frozen(force))
    (said,) = (s.finding for s in examine(samples, None).statements if s.finding.sensor == "accel")
    assert said.effect == "accel_warmup"
    low, high = np.ravel(said.parameters["tau_s"].ci95)
    assert low < tau < high < 2.0 * low
    assert np.asarray(said.parameters["amplitude"].value)[2] == pytest.approx(-0.02, rel=0.1)
