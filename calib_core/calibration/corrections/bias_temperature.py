"""A bias that follows the temperature: a straight line from a diagnosis, or a curve that was learnt.

In a diagnosis a slope counts from a temperature of its own. Here it counts from the mean temperature of the
rests that the calibration was fitted to, because its bias holds there. A term that the daemon learnt itself
(calibration/bias_curve) is a polynomial, and knows the span that it was learnt at.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import comb
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.corrections.base import PREFIX, UNIT, Correction, Drivers, Parameter
from stillcal.calib_core.calibration.corrections.term import Term, TermParameter, lag_of
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.forecast import PLAUSIBLE_K
from stillcal.calib_core.temperature.thermometer import felt

POWER_NAMES = ("slope", "quadratic", "cubic")
"""A temperature term's parameters: per K, K^2 and K^3."""

_MOST = {Sensor.ACCELEROMETER: 1.0, Sensor.GYROSCOPE: 0.1}
"""Per K: 100 mg, and 6 degrees a second."""

_BEYOND = 0.25
_BEYOND_K = 1.0


def followed_between(low: float, high: float) -> tuple[float, float]:
    """Return the temperatures, degC, beyond which a curve learnt from `low` to `high` stays as it is."""
    beyond = _BEYOND * (high - low) + _BEYOND_K
    return low - beyond, high + beyond


def learnt_between(low: float, high: float) -> tuple[float, float]:
    """Return the span, degC, of a curve followed from `low` to `high`: `followed_between` turned round."""
    beyond = (_BEYOND * (high - low) + _BEYOND_K) / (1.0 + 2.0 * _BEYOND)
    return low + beyond, high - beyond


def _moved(parameters: Mapping[str, TermParameter], by: float) -> dict[str, TermParameter]:
    """Return a polynomial's parameters about a temperature that is higher by `by` K.

    What is constant goes into the bias, which is that of the calibration there. The errors of the powers are
    taken for independent.
    """
    out = {}
    for k, name in enumerate(POWER_NAMES, start=1):
        if name not in parameters:
            continue
        parts = [
            (comb(n, k) * by ** (n - k), parameters[higher])
            for n, higher in enumerate(POWER_NAMES[k - 1 :], start=k)
            if higher in parameters
        ]
        value = frozen(np.sum([factor * part.value for factor, part in parts], axis=0))
        known = [(factor, part.ci95) for factor, part in parts if part.ci95 is not None]
        reaches = [factor * np.ptp(ci95, axis=-1) / 2.0 for factor, ci95 in known]
        reach = np.sqrt(np.sum(np.square(reaches), axis=0))
        ci95 = frozen(np.stack([value - reach, value + reach], axis=-1)) if reaches else None
        out[name] = replace(parameters[name], value=value, ci95=ci95)
    return out


class BiasTemperature(Correction):
    """The bias is a polynomial in temperature."""

    references = ("temperature",)
    has_forecast = True
    refits = True
    without_rests = True

    def __init__(self, sensor: Sensor) -> None:
        self.sensor, self.effect = sensor, f"{PREFIX[sensor]}_bias_temperature"
        self.parameters = tuple(
            Parameter(name, f"{UNIT[sensor]}/K^{power}", _MOST[sensor], required=power == 1)
            for power, name in enumerate(POWER_NAMES, start=1)
        )

    def term(self, sensor: Sensor, finding: Mapping[str, Any], reference: dict[str, float]) -> Term:
        """Turn a finding into a checked term that counts from the temperature of `reference`, degC."""
        found = super().term(sensor, finding, reference)
        own = (finding.get("reference") or {}).get("temperature_c")
        if own is None:
            return found
        moved = replace(found, parameters=_moved(found.parameters, reference["temperature"] - float(own)))
        self.check(moved)
        return moved

    def offset(self, term: Term, at: Drivers) -> Array | None:
        """Return the bias by temperature, (n, 3); zero where the temperature is unknown."""
        if at.celsius is None:
            return None
        return self.of_temperature(term, felt(at.celsius, at.lagged, lag_of(term)))

    @staticmethod
    def of_temperature(term: Term, temperature: Array) -> Array:
        """Return the bias at the sensor's own temperatures (n,), degC: (n, 3); zero where they are unknown.

        A term that knows the span of temperatures that it was learnt at is followed beyond them by a quarter
        of the span and 1 K at most; there it stays as it is. Beyond the span by more than the span and 10 K
        the thermometer is doubted, and the temperature taken for unknown (forecast.plausible).
        """
        low, high = (term.reference.get(f"temperature_{end}") for end in ("min", "max"))
        if low is not None and high is not None:
            reach = high - low + PLAUSIBLE_K
            doubted = (temperature < low - reach) | (temperature > high + reach)
            temperature = np.where(doubted, np.nan, np.clip(temperature, *followed_between(low, high)))
        warmer = np.nan_to_num(temperature - term.reference["temperature"])
        total = np.zeros((len(warmer), 3))
        for power, name in enumerate(POWER_NAMES, start=1):
            if name in term.parameters:
                total = total + warmer[:, None] ** power * term.parameters[name].value
        return total
