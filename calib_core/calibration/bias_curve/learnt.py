"""What was learnt of one sensor's bias, and the term that corrects it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.corrections.base import REACH_OF_95
from stillcal.calib_core.calibration.corrections.bias_temperature import POWER_NAMES
from stillcal.calib_core.calibration.corrections.charging_heat import BY_CHARGING
from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.record import Evidence
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.charger import FULL_K
from stillcal.calib_core.temperature.forecast import Forecast
from stillcal.calib_core.temperature.regression import (
    POWERS,
    UNIT_K,
)

EFFECTS = {
    Sensor.ACCELEROMETER: ("accel_bias_temperature", "m/s^2"),
    Sensor.GYROSCOPE: ("gyro_bias_temperature", "rad/s"),
}
TAKEN_UP, DROPPED = "taken up", "dropped"


@dataclass(frozen=True, slots=True, eq=False)
class Learnt:
    """The result of learning one sensor's bias.

    bias: (3,) at the reference temperature now, and scale_change (3, 3), to be added. forecast: of this bias
    with this term. term: the curve to correct by, None for none. change: "taken up", "dropped" or empty.
    evidence: the figures of that decision. covariance: (9, 9) of bias and scale, as an accelerometer's record
    has it, else None. t, errors, errors_sd: (n,) times of the rests, s, errors of predicting each from those
    before it, and standard uncertainties of the predictions. steps: s, the rests at which the bias stepped.
    doubted: s, the rests that disagree with those before and after them. doubt: why the readings that a curve
    followed are believed no longer, empty where that is not why it was dropped.
    """

    sensor: Sensor
    bias: Array
    scale_change: Array
    forecast: Forecast
    term: Term | None
    change: str
    evidence: Evidence
    covariance: Array | None
    t: Array
    errors: Array
    errors_sd: Array
    steps: tuple[float, ...] = ()
    doubted: tuple[float, ...] = ()
    doubt: str = ""

    @property
    def reason(self) -> str:
        """The decision on the curve in a sentence."""
        figures, unit = self.evidence, EFFECTS[self.sensor][1]
        driver = "charging" if self.forecast.by_charger else "temperature"
        if self.doubt:
            return f"{self.sensor}: bias by {driver} {self.change}: {self.doubt}"
        return (
            f"{self.sensor}: bias by {driver} {self.change}: over {figures['hours']} hours, rests "
            f"are typically predicted to {figures['typical_with']:.2g} {unit} with it, "
            f"to {figures['typical_without']:.2g} without"
        )


def is_thermal(term: Term, sensor: Sensor) -> bool:
    """Tell whether a term corrects a sensor's bias for temperature, or for the heat of charging."""
    return term.effect == EFFECTS[sensor][0] or (term.effect == BY_CHARGING and term.sensor == sensor)


def held_term(terms: Iterable[Term], sensor: Sensor) -> Term | None:
    """Return the term by which a sensor's bias is corrected for temperature, None for none."""
    return next((term for term in terms if is_thermal(term, sensor)), None)


def told_curve(term: Term) -> Array:
    """Return a term's coefficients about its own reference, (4, 3) as Forecast.error has them."""
    told = np.zeros((POWERS + 1, 3))
    if term.effect == BY_CHARGING:
        told[1] = term.parameters["amplitude"].value * UNIT_K / FULL_K
    for power, name in enumerate(POWER_NAMES, start=1):
        if name in term.parameters:
            told[power] = term.parameters[name].value * UNIT_K**power
    return told


def term_of(sensor: Sensor, forecast: Forecast) -> Term:
    """Return the term that corrects a forecast's curve."""
    effect, unit = EFFECTS[sensor]
    sd = np.sqrt(np.diag(forecast.covariance))[3:].reshape(-1, 3)
    lag = {"lag_s": forecast.lag_s} if forecast.lag_s else {}

    def parameter(power: int, per: float, unit: str) -> TermParameter:
        value, reach = forecast.curve[power - 1] * per, REACH_OF_95 * sd[power - 1] * per
        ci95 = frozen(np.stack([value - reach, value + reach], axis=1))
        return TermParameter(value=frozen(value), unit=unit, ci95=ci95)

    if forecast.by_charger:
        amplitude = parameter(1, FULL_K / UNIT_K, unit)
        return Term(effect=BY_CHARGING, sensor=sensor, parameters={"amplitude": amplitude}, reference=lag)
    parameters = {
        name: parameter(power, UNIT_K**-power, f"{unit}/K" if power == 1 else f"{unit}/K^{power}")
        for power, name in enumerate(POWER_NAMES, start=1)
    }
    reference = {"temperature": forecast.reference}
    if forecast.temperature_min is not None and forecast.temperature_max is not None:
        reference |= {
            "temperature_min": forecast.temperature_min,
            "temperature_max": forecast.temperature_max,
        }
    return Term(effect=effect, sensor=sensor, parameters=parameters, reference=reference | lag)
