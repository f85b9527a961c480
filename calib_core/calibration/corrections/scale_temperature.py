"""A scale that follows the temperature.

reading = true value x (1 + slope (T - T_ref)), T_ref the mean temperature of the rests that the calibration
was fitted to, because its scale holds there.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.base import PREFIX, Correction, Drivers, Parameter
from stillcal.calib_core.calibration.corrections.term import Term
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.charger import FULL_K

_STRAY_K = FULL_K / 2.0
"""K (root mean square) by which an unknown temperature differs from the mean, at least: that of a phone which
is on the charger, and warmed up there, half of the time."""


class ScaleTemperature(Correction):
    """The scale of each axis is a straight line of temperature."""

    references = ("temperature",)
    keeps_spread = True
    of_reading = True
    refits = True
    driver = "the temperature"
    remedy = "a calibration from a recording with temperature"
    parameters = (Parameter("slope", "1/K", 0.01),)

    def __init__(self, sensor: Sensor) -> None:
        self.sensor, self.effect = sensor, f"{PREFIX[sensor]}_scale_temperature"

    def response(self, term: Term, at: Drivers) -> Mapping[str, Array] | None:
        """Return the reading times the temperature above the reference."""
        if at.celsius is None or at.reading is None:
            return None
        return {"slope": at.reading * (at.celsius - term.reference["temperature"])[:, None]}

    def unknown(self, term: Term, at: Drivers) -> Array:
        """Return the error of the reading as far from the reference as the calibration's rests were, or more.

        That is how they scatter about it (`temperature_sd`; a term of an earlier version does not say it), or
        half of what charging warms a phone by, whichever is larger: a calibration of one warm room knows no
        other temperature.
        """
        if at.reading is None:
            return np.zeros(3)
        stray = max(_STRAY_K, term.reference.get("temperature_sd", 0.0))
        return np.asarray(np.abs(at.reading * term.parameters["slope"].value) * stray)
