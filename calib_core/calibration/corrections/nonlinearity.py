"""An error that grows with the square, or the cube, of what an axis reads."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.base import PREFIX, UNIT, Correction, Drivers, Parameter
from stillcal.calib_core.calibration.corrections.term import Term
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Sensor

_POWERS = {"quadratic": 2, "cubic": 3}

_REACH = {Sensor.ACCELEROMETER: 2.0 * STANDARD, Sensor.GYROSCOPE: 6.0}
"""Beyond this reading the error stays as it is: rests show 1 g, and turns by hand some 6 rad/s."""

_MOST = {Sensor.ACCELEROMETER: (1e-2, 5e-4), Sensor.GYROSCOPE: (5e-2, 1e-2)}
"""Quadratic and cubic that leave a reading of `_REACH` a rising function of the truth, about."""


class Nonlinearity(Correction):
    """Each axis gains quadratic x^2 + cubic x^3 of its own true input x.

    reach: beyond this input the error stays as it is.
    """

    of_reading = True
    refits = True
    driver = "what the sensor read"

    def __init__(self, sensor: Sensor) -> None:
        self.sensor, self.effect = sensor, f"{PREFIX[sensor]}_nonlinearity"
        self.parameters = tuple(
            Parameter(name, f"1/({UNIT[sensor]})^{power - 1}", most, required=power == 2)
            for (name, power), most in zip(_POWERS.items(), _MOST[sensor], strict=True)
        )
        self.reach = _REACH[sensor]
        self.in_turns = sensor is Sensor.GYROSCOPE

    def response(self, term: Term, at: Drivers) -> Mapping[str, Array] | None:
        """Return powers of the reading."""
        if at.reading is None:
            return None
        known = np.clip(at.reading, -self.reach, self.reach)
        return {name: known**power for name, power in _POWERS.items() if name in term.parameters}

    def held_by_scale(self, term: Term, turn_powers: Array) -> Array:
        """Return the effect on the angle of the turns that a scale was fitted to, per radian."""
        total = np.sum(
            [
                term.parameters[name].value * turn_powers[power - 2]
                for name, power in _POWERS.items()
                if name in term.parameters
            ],
            axis=0,
        )
        return np.asarray(total)
