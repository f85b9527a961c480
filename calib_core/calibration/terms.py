"""Terms beyond the affine model: taken from a diagnosis into a calibration, and applied to readings.

Two kinds come from a diagnosis: a bias that follows the temperature, and a gyroscope's sensitivity to force
(g-sensitivity). In a diagnosis a slope counts from a temperature of its own. Here it counts from the mean
temperature of the rests that the calibration was fitted to, because its bias holds there. A temperature term
that the daemon learnt itself (bias_curve.py) is a polynomial, and knows the span that it was learnt at. A
third kind is learnt where there is no thermometer: a bias that follows the heat of charging, by as much as
its amplitude once that has come in full.

calibrated = scale @ (raw - bias - slope (T - T_ref) - matrix @ force)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.record import CalibrationRecord, NotCalibratedError, Term, TermParameter
from stillcal.calib_core.calibration.rest_pool import Pool
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.samples import Samples, Sensor, warmed
from stillcal.calib_core.temperature.charger import FULL_K, Charger, followed
from stillcal.calib_core.temperature.forecast import PLAUSIBLE_K
from stillcal.calib_core.temperature.thermometer import Thermometer, felt

NO_READINGS = Thermometer()
NO_CHARGER = Charger()

_KINDS: dict[str, tuple[Sensor, str, tuple[int, ...]]] = {
    "accel_bias_temperature": (Sensor.ACCELEROMETER, "slope", (3,)),
    "gyro_bias_temperature": (Sensor.GYROSCOPE, "slope", (3,)),
    "gyro_g_sensitivity": (Sensor.GYROSCOPE, "matrix", (3, 3)),
}
"""Effect -> its sensor, the name of its parameter and the shape of that."""

APPLIED = tuple(_KINDS)
"""Effects of a diagnosis that `correct` applies; it may find others, which cannot be taken over."""

BY_CHARGING = "thermal_latent"
"""The effect of a term that follows the charger; of either sensor."""


def with_terms(record: CalibrationRecord, findings: Iterable[Mapping[str, Any]]) -> CalibrationRecord:
    """Return the calibration with terms for those findings (of `diagnose --json`) that can be applied.

    A finding replaces an earlier term of the same effect. Raises NotSupported where none of the findings can
    be applied, or where a slope has no temperature to count from; ValueError on a malformed finding.
    """
    fresh = terms_of(record, findings)
    if not fresh:
        raise NotSupported(
            f"no finding can be applied: only {', '.join(APPLIED)} can, where no other effect fits as well"
        )
    others = [term for term in record.terms if term.effect not in fresh]
    return replace(record, terms=(*others, *fresh.values()))


def terms_of(record: CalibrationRecord, findings: Iterable[Mapping[str, Any]]) -> dict[str, Term]:
    """Return the terms, by effect, of those findings that can be applied; errors as `with_terms`."""
    return {f["effect"]: _term(record, f) for f in findings if f["effect"] in _KINDS and not _ambiguous(f)}


def correct(
    record: CalibrationRecord,
    samples: Samples,
    force: Array | None = None,
    thermometer: Thermometer = NO_READINGS,
    charger: Charger = NO_CHARGER,
) -> Samples:
    """Correct a run of samples by the model and by those terms whose temperature, charger or force is known.

    force: (n, 3) m/s^2, the calibrated specific force at these samples' times, or None. The temperature comes
    with the samples; thermometer: its readings before them. charger: its changes up to the last of them.
    Raises NotCalibratedError where the record has no part of their sensor.
    """
    celsius = samples.temperature
    late = celsius is not None and any(lag_of(term) for term in record.terms)
    lagged = thermometer.course(samples.t, celsius) if late and celsius is not None else None
    follows = any(term.effect == BY_CHARGING for term in record.terms)
    charged = charger.course(samples.t) if follows else None
    offset = bias_terms(record, samples.sensor, celsius, force, lagged, charged=charged)
    return record.model(samples.sensor).correct(replace(samples, xyz=samples.xyz - offset))


def correct_both(
    record: CalibrationRecord,
    accelerometer: Samples,
    gyroscope: Samples | None,
    thermometer: Thermometer = NO_READINGS,
    charger: Charger = NO_CHARGER,
) -> tuple[Samples, Samples | None]:
    """Correct both sensors' samples; a sensor that the record holds nothing of stays as it is.

    The gyroscope's terms that follow force take it from the corrected accelerometer, interpolated to the
    gyroscope's times; those that follow temperature take the accelerometer's where it has none of its own.
    thermometer: its readings before them. charger: its changes up to the last of them.
    """
    accel = _corrected(record, accelerometer, None, thermometer, charger)
    if gyroscope is None:
        return accel, None
    force = interpolated(accel, gyroscope.t)
    gyro = _corrected(record, warmed(gyroscope, accelerometer), force, thermometer, charger)
    return accel, replace(gyro, temperature=gyroscope.temperature)


def _corrected(
    record: CalibrationRecord,
    samples: Samples,
    force: Array | None,
    thermometer: Thermometer,
    charger: Charger,
) -> Samples:
    try:
        return correct(record, samples, force, thermometer, charger)
    except NotCalibratedError:
        return samples


def bias_terms(
    record: CalibrationRecord,
    sensor: Sensor,
    temperature: Array | None,
    force: Array | None = None,
    lagged: Array | None = None,
    *,
    charged: Array | None = None,
) -> Array:
    """Return what the terms add to the bias, (n, 3) in raw units, or (3,) zeros where no term applies.

    temperature: (n,) degC, NaN where unknown, or None. force: (n, 3) m/s^2, calibrated, or None. lagged:
    (n, k) degC, of sensors that follow the thermometer late, as thermometer.py has it, or None. charged:
    (n, 1 + k) K, as charger.py has it, or None. Outside the temperatures that the calibration was measured
    at, a slope is extrapolated as a straight line.
    """
    offset = np.zeros(3)
    for term in record.terms:
        if term.sensor != sensor or term.effect not in (*_KINDS, BY_CHARGING):
            continue
        if "slope" in term.parameters and temperature is not None:
            offset = offset + polynomial(term, felt(temperature, lagged, lag_of(term)))
        elif "matrix" in term.parameters and force is not None:
            offset = offset + force @ term.parameters["matrix"].value.T
        elif term.effect == BY_CHARGING and charged is not None:
            offset = offset + polynomial(term, followed(charged, lag_of(term)))
    return offset


def lag_of(term: Term) -> float:
    """Return with what lag (s) a term follows the thermometer or the charger; 0 for none."""
    return term.reference.get("lag_s", 0.0)


POWER_NAMES = ("slope", "quadratic", "cubic")
"""A temperature term's parameters: per K, K^2 and K^3."""

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


def polynomial(term: Term, temperature: Array) -> Array:
    """Return a temperature term's bias at temperatures (n,), degC: (n, 3); zero where they are unknown.

    The temperatures are those of the sensor, which may follow the thermometer late (thermometer.felt).

    A term that knows the span of temperatures that it was learnt at is followed beyond them by a quarter of
    the span and 1 K at most; there it stays as it is. Beyond the span by more than the span and 10 K the
    thermometer is doubted, and the temperature taken for unknown (forecast.plausible). For a term that
    follows the charger they are the readings (n,) K that it stands in for (charger.py).
    """
    if term.effect == BY_CHARGING:
        return np.nan_to_num(temperature / FULL_K)[:, None] * term.parameters["amplitude"].value
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


def compensated(pool: Pool, record: CalibrationRecord) -> Pool:
    """Return a pool whose rests have a record's terms taken off their means; turns stay as they are.

    The bias of the rests is then that at the terms' reference temperature and without force. Rests of unknown
    temperature keep what depends on it.
    """
    if not record.terms:
        return pool
    return replace(pool, held=tuple(replace(h, rest=_compensated(h.rest, record)) for h in pool.held))


def _compensated(rest: RestState, record: CalibrationRecord) -> RestState:
    at = None if rest.temperature is None else np.array([rest.temperature])
    charged = None if rest.charged is None else rest.charged[None]
    by_temperature = bias_terms(record, Sensor.ACCELEROMETER, at, None, rest.lagged, charged=charged)
    force = rest.specific_force - np.ravel(by_temperature)
    if rest.rate is None:
        return msgspec.structs.replace(rest, specific_force=frozen(force))
    by_temperature = bias_terms(record, Sensor.GYROSCOPE, at, None, rest.lagged, charged=charged)
    rate = rest.rate - np.ravel(by_temperature) - force_terms(record, force[None])[0]
    return msgspec.structs.replace(rest, specific_force=frozen(force), rate=frozen(rate))


def force_terms(record: CalibrationRecord, raw: Array) -> Array:
    """Return what force adds to the gyroscope's bias at rests of raw force (n, 3) m/s^2: (n, 3) rad/s."""
    part = record.accelerometer
    force = raw if part is None else part.model.apply(raw)
    return np.zeros((len(raw), 3)) + bias_terms(record, Sensor.GYROSCOPE, None, force)


def interpolated(samples: Samples, t: Array) -> Array | None:
    """Interpolate readings linearly at times t (n,), s: (n, 3), or None where there are no samples."""
    if not len(samples):
        return None
    return np.column_stack([np.interp(t, samples.t, samples.xyz[:, axis]) for axis in range(3)])


def mean_temperature(record: CalibrationRecord) -> float | None:
    """Return the mean temperature (degC) of the rests fitted to, else the middle of the range of validity."""
    known = [s.temperature for s in record.states if s.temperature is not None]
    if known:
        return float(np.mean(known))
    low, high = record.validity.temperature_min, record.validity.temperature_max
    return None if low is None or high is None else 0.5 * (low + high)


def _ambiguous(finding: Mapping[str, Any]) -> bool:
    """Tell whether another effect explains the recording as well as the one found."""
    return any(other.get("indistinguishable") for other in finding.get("alternatives", ()))


def _term(record: CalibrationRecord, finding: Mapping[str, Any]) -> Term:
    """Turn a finding into a term, checking the shape of its parameter."""
    effect = finding["effect"]
    sensor, name, shape = _KINDS[effect]
    given = (finding.get("parameters") or {}).get(name)
    if given is None:
        raise ValueError(f"{effect}: the finding has no {name}")
    value = np.asarray(given["value"], dtype=np.float64)
    if value.shape != shape or not np.isfinite(value).all():
        raise ValueError(f"{effect}: {name} has shape {value.shape}: expected finite numbers, {shape}")
    ci95 = None if given.get("ci95") is None else frozen(np.asarray(given["ci95"], dtype=np.float64))
    reference = {}
    if name == "slope":
        t = mean_temperature(record)
        if t is None:
            raise NotSupported(
                f"{effect}: the calibration's rests have no temperature", ["a recording with temperature"]
            )
        reference = {"temperature": t}
    parameter = TermParameter(value=frozen(value), unit=str(given.get("unit", "")), ci95=ci95)
    return Term(effect=effect, sensor=sensor, parameters={name: parameter}, reference=reference)
