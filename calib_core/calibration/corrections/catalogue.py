"""All effects that a calibration can correct, by name."""

from __future__ import annotations

from collections.abc import Iterable

from stillcal.calib_core.calibration.corrections.base import Correction
from stillcal.calib_core.calibration.corrections.bias_temperature import BiasTemperature
from stillcal.calib_core.calibration.corrections.charging_bias import ChargingBias
from stillcal.calib_core.calibration.corrections.charging_heat import BY_CHARGING, ChargingHeat
from stillcal.calib_core.calibration.corrections.g_sensitivity import GSensitivity
from stillcal.calib_core.calibration.corrections.nonlinearity import Nonlinearity
from stillcal.calib_core.calibration.corrections.scale_temperature import ScaleTemperature
from stillcal.calib_core.calibration.corrections.term import Term
from stillcal.calib_core.calibration.corrections.warmup import Warmup
from stillcal.calib_core.streams.samples import Sensor

_OF_EITHER = (BiasTemperature, ScaleTemperature, Nonlinearity, Warmup, ChargingBias)

CORRECTIONS: dict[str, Correction] = {
    correction.effect: correction
    for correction in (
        *(kind(sensor) for kind in _OF_EITHER for sensor in (Sensor.ACCELEROMETER, Sensor.GYROSCOPE)),
        GSensitivity(),
        ChargingHeat(),
    )
}

ADOPTABLE = tuple(effect for effect in CORRECTIONS if effect != BY_CHARGING)
"""Effects of a diagnosis that a calibration can take up. The heat of charging the daemon learns itself."""

ADOPT = "stillcal store adopt-terms"
"""The command that takes them up."""


def follows_charger(term: Term) -> bool:
    """Tell whether a term follows the charger."""
    correction = CORRECTIONS.get(term.effect)
    return correction is not None and correction.by_charger


def follows_start(term: Term) -> bool:
    """Tell whether a term follows the time since the sensors were switched on."""
    correction = CORRECTIONS.get(term.effect)
    return correction is not None and correction.by_start


def follows_temperature(term: Term) -> bool:
    """Tell whether a term follows the thermometer."""
    correction = CORRECTIONS.get(term.effect)
    return correction is not None and "temperature" in correction.references


def check_terms(terms: Iterable[Term]) -> None:
    """Refuse terms that cannot be applied as they are: ValueError. An effect that is not known here passes.

    Such a one is of another version, and is kept without being applied.
    """
    for term in terms:
        correction = CORRECTIONS.get(term.effect)
        if correction is None:
            continue
        if correction.sensor not in {None, term.sensor}:
            raise ValueError(f"{term.effect} is no effect of the {term.sensor}")
        correction.check(term)
