"""A bias that is another one while the phone is on the charger, at once. It counts from off the charger."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.base import (
    LARGEST_BIAS,
    PREFIX,
    UNIT,
    Correction,
    Drivers,
    Parameter,
)
from stillcal.calib_core.calibration.corrections.term import Term
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.charger import FULL_K


class ChargingBias(Correction):
    """The bias gains a step on the charger."""

    refits = True
    by_charger = True
    driver = "whether the phone was on the charger"
    remedy = "a calibration from a recording with charging events, by this version"

    def __init__(self, sensor: Sensor) -> None:
        self.sensor, self.effect = sensor, f"{PREFIX[sensor]}_charging_bias"
        self.parameters = (Parameter("step", UNIT[sensor], LARGEST_BIAS[sensor]),)

    def response(self, term: Term, at: Drivers) -> Mapping[str, Array] | None:
        """Return 1 on the charger and 0 off it."""
        return None if at.charged is None else {"step": np.atleast_2d(at.charged)[:, :1] / FULL_K}

    def unknown(self, term: Term, at: Drivers) -> Array:
        """Return the error of a bias that is right as often as it is off by the step."""
        return np.asarray(np.abs(term.parameters["step"].value) * np.sqrt(0.5))
