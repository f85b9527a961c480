"""How much white noise sensors have: less is none of their own, and more is motion."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.streams.samples import Sensor

QUIETEST = {Sensor.ACCELEROMETER: 1e-3, Sensor.GYROSCOPE: float(np.deg2rad(0.0038))}
"""Densities of white noise, one-sided, m/s^2 and rad/s per sqrt(Hz): the quietest of 35 real accelerometers
(still experiment of Stisen et al. 2015), and a quiet phone's gyroscope (data sheet of the LSM6DSO)."""

LOUDEST = {"accel": 0.02, "gyro": 2e-3}
"""Densities, m/s^2 and rad/s per sqrt(Hz), above which noise is motion. 35 real accelerometers have 0.001 to
0.017 (still experiment of Stisen et al. 2015), gyroscopes up to 5e-4 (datasheet of the L3G4200D)."""

SLOWEST_HZ = 21.0
"""Lowest rate of those accelerometers. What is logged more slowly, without a filter, has all the noise of a
sensor in a narrower band: in proportion, its densities may be larger."""


def loudest(sensor: str, rate: float) -> float:
    """Return the largest density, m/s^2 or rad/s per sqrt(Hz), of a sensor's noise in a log of `rate` Hz."""
    return float(LOUDEST[sensor] * np.sqrt(max(SLOWEST_HZ / rate, 1.0)))
