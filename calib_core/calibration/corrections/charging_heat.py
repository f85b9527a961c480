"""A bias that follows the heat of charging, learnt where there is no thermometer."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.base import Correction, Drivers, Parameter
from stillcal.calib_core.calibration.corrections.term import Term, lag_of
from stillcal.calib_core.temperature.charger import FULL_K, followed

BY_CHARGING = "thermal_latent"
"""The effect of a term that follows the charger; of either sensor."""


class ChargingHeat(Correction):
    """The bias gains its amplitude once charging has warmed the phone in full."""

    effect = BY_CHARGING
    sensor = None
    parameters = (Parameter("amplitude", "", 10.0),)
    has_forecast = True
    by_charger = True

    def offset(self, term: Term, at: Drivers) -> Array | None:
        """Return the bias by the charger's heat, (n, 3); zero where that is unknown."""
        return None if at.charged is None else self.of_heat(term, followed(at.charged, lag_of(term)))

    @staticmethod
    def of_heat(term: Term, kelvin: Array) -> Array:
        """Return the bias at readings (n,) K that the charger stands in for: (n, 3)."""
        return np.asarray(np.nan_to_num(kelvin / FULL_K)[:, None] * term.parameters["amplitude"].value)
