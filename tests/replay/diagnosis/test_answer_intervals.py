"""The intervals of an answer are those of the numbers that were measured."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.diagnosis.comparison.direct import _logarithm
from stillcal.calib_core.diagnosis.comparison.quantity import Part, Quantity, subtract
from stillcal.calib_core.diagnosis.model.measurement import Measured
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.diagnosis.answer import _difference, _values


def share(value: float, error: float) -> Quantity:
    samples = Samples(Sensor.GYROSCOPE, frozen(np.arange(9.0)), frozen(np.zeros((9, 3))))
    return _logarithm(
        ("held_samples", "gyro"), Part("fraction", "1", 1), Measured(value, error), 1e-5, samples
    )


def test_a_share_that_may_be_nothing_is_as_sure_upwards_as_it_was_measured() -> None:
    """Its logarithm reaches down to the floor; as far up it was 44,000 %."""
    sure, perhaps = share(0.066, 0.004), share(0.018, 0.01)
    (low, high) = _values(perhaps)["fraction"]["ci95"]
    assert low == 0.0 and abs(high - (0.018 + 1.96 * 0.01)) < 1e-4
    (low, high) = _difference(subtract(sure, perhaps))["fraction"]["ci95"]
    assert abs((high - low) / 2.0 - 1.96 * np.hypot(0.004, 0.01)) < 1e-4
