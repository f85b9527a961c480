"""What drives effects at single samples, of devices with a gyroscope and without one."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.diagnosis.model.moments import History, at_samples
from stillcal.calib_core.streams.samples import Samples, Sensor

T = np.arange(0.0, 10.0, 0.1)
FORCE = Samples(Sensor.ACCELEROMETER, T, np.outer(T, [1.0, 0.0, 2.0]))
HISTORY = History((0.0, 10.0), np.zeros((0, 2)))


def test_what_the_sensors_read_stands_for_force_and_rate() -> None:
    rate = Samples(Sensor.GYROSCOPE, T, np.outer(T, [0.0, 3.0, 0.0]))
    t = np.array([1.25, 2.5])
    seen = at_samples(t, HISTORY, (FORCE, rate))
    assert seen.force is not None and seen.rate is not None
    np.testing.assert_allclose(seen.force, np.outer(t, [1.0, 0.0, 2.0]))
    np.testing.assert_allclose(seen.rate, np.outer(t, [0.0, 3.0, 0.0]))
    part = seen.during(slice(1, 2))
    assert part.t.tolist() == [2.5] and part.rate is not None and part.rate.shape == (1, 3)


def test_a_gyroscope_without_samples_is_none() -> None:
    empty = Samples(Sensor.GYROSCOPE, T[:0], np.zeros((0, 3)))
    assert at_samples(T, HISTORY, (FORCE, empty)).rate is None
    assert at_samples(T, HISTORY, (FORCE, None)).rate is None
