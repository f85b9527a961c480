"""A bias that settles after the sensor was switched on. It counts from the settled bias."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
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

_SHORTEST_S, _LONGEST_S = 1.0, 1e5


class Warmup(Correction):
    """The bias is off by its amplitude at first and settles as a first-order system does."""

    refits = True
    by_start = True
    driver = "how long before them the sensors were switched on"
    remedy = "a calibration by stillcal replay from the recording that was diagnosed"

    def __init__(self, sensor: Sensor) -> None:
        self.sensor, self.effect = sensor, f"{PREFIX[sensor]}_warmup"
        amplitude = Parameter("amplitude", UNIT[sensor], LARGEST_BIAS[sensor])
        self.parameters = (amplitude, Parameter("tau_s", "s", _LONGEST_S, ()))

    def response(self, term: Term, at: Drivers) -> Mapping[str, Array] | None:
        """Return -1 when it was switched on, and 0 once it has settled."""
        if at.age is None:
            return None
        return {"amplitude": -np.exp(-at.age / float(term.parameters["tau_s"].value))[:, None]}

    def unknown(self, term: Term, at: Drivers) -> Array:
        """Return the error of a bias that may be anywhere on its way."""
        return np.asarray(np.abs(term.parameters["amplitude"].value) / np.sqrt(3.0))

    def from_start(self, term: Term, after: float) -> Term:
        """Return the term with the larger amplitude that it had at the start."""
        tau, amplitude = float(term.parameters["tau_s"].value), term.parameters["amplitude"]
        more = np.exp(after / tau)
        ci95 = None if amplitude.ci95 is None else frozen(more * amplitude.ci95)
        then = replace(amplitude, value=frozen(more * amplitude.value), ci95=ci95)
        earlier = replace(term, parameters=term.parameters | {"amplitude": then})
        self.check(earlier)
        return earlier

    def check(self, term: Term) -> None:
        """Refuse a time constant that is not positive, too: ValueError."""
        super().check(term)
        if float(term.parameters["tau_s"].value) < _SHORTEST_S:
            raise ValueError(f"{self.effect}: tau_s must be {_SHORTEST_S:g} s or more")
