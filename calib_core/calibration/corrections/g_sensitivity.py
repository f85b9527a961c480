"""A gyroscope that is sensitive to acceleration."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.base import Correction, Drivers, Parameter
from stillcal.calib_core.calibration.corrections.term import Term
from stillcal.calib_core.streams.samples import Sensor


class GSensitivity(Correction):
    """The rate gains a matrix times the specific force."""

    effect = "gyro_g_sensitivity"
    sensor = Sensor.GYROSCOPE
    refits = True
    without_rests = True
    parameters = (Parameter("matrix", "(rad/s)/(m/s^2)", 0.1, (3, 3)),)

    def offset(self, term: Term, at: Drivers) -> Array | None:
        """Return what force adds to the rate, (n, 3)."""
        return None if at.force is None else np.asarray(at.force @ term.parameters["matrix"].value.T)

    def uncertainty(self, term: Term, at: Drivers) -> Array:
        """Return zeros: in a rest the bias is measured with it, and stands for its own uncertainty."""
        return np.zeros(3)
