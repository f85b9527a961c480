"""Terms beyond the affine model: from a diagnosis' findings into a calibration, and applied to readings.

Two kinds: a bias that follows the temperature, and a gyroscope that feels force (g-sensitivity). What a
diagnosis calls a slope counts from a temperature of its own; here it counts from the mean temperature of
the rests that the calibration stands on, where its bias holds.

calibrated = scale @ (raw - bias - slope (T - T_ref) - matrix @ force)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.record import CalibrationRecord, NotCalibratedError, Term, TermParameter
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.streams.samples import Samples, Sensor

_KINDS: dict[str, tuple[Sensor, str, tuple[int, ...]]] = {
    "accel_bias_temperature": (Sensor.ACCELEROMETER, "slope", (3,)),
    "gyro_bias_temperature": (Sensor.GYROSCOPE, "slope", (3,)),
    "gyro_g_sensitivity": (Sensor.GYROSCOPE, "matrix", (3, 3)),
}
"""Effect -> its sensor, its parameter and that one's shape."""

APPLIED = tuple(_KINDS)
"""Effects that `correct` applies; a diagnosis may find others, which stay where they are."""


def with_terms(record: CalibrationRecord, findings: Iterable[Mapping[str, Any]]) -> CalibrationRecord:
    """Return the calibration with terms for those findings (of `diagnose --json`) that can be applied.

    A term of the same effect that it had is replaced. Raises NotSupported where none of the findings can
    be applied, or where a slope has no temperature to count from; ValueError on a malformed one.
    """
    fresh = {f["effect"]: _term(record, f) for f in findings if f["effect"] in _KINDS and not _ambiguous(f)}
    if not fresh:
        raise NotSupported(f"no finding to apply: only {', '.join(APPLIED)} can be, and only if told apart")
    kept = [term for term in record.terms if term.effect not in fresh]
    return replace(record, terms=(*kept, *fresh.values()))


def inherit_terms(old: CalibrationRecord | None, new: CalibrationRecord) -> CalibrationRecord:
    """Return a new calibration with the old one's terms, counted from where its own bias holds."""
    reference = None if old is None else mean_temperature(new)
    terms = [] if old is None else [_referred(term, reference) for term in old.terms]
    return replace(new, terms=tuple(term for term in terms if term is not None))


def correct(record: CalibrationRecord, samples: Samples, force: Array | None = None) -> Samples:
    """Correct a run of samples by the model and those terms for which there is what they follow.

    force: (n, 3) m/s^2, the calibrated specific force at these samples' times, or None. Temperature comes
    with the samples. Raises NotCalibratedError where the record holds nothing of their sensor.
    """
    offset = bias_terms(record, samples.sensor, samples.temperature, force)
    return record.model(samples.sensor).correct(replace(samples, xyz=samples.xyz - offset))


def correct_both(
    record: CalibrationRecord, accelerometer: Samples, gyroscope: Samples | None
) -> tuple[Samples, Samples | None]:
    """Correct both sensors' samples; a sensor that the record holds nothing of stays as it is.

    The gyroscope's terms that follow force take it from the corrected accelerometer, interpolated to the
    gyroscope's times.
    """
    accel = _corrected(record, accelerometer)
    if gyroscope is None:
        return accel, None
    return accel, _corrected(record, gyroscope, interpolated(accel, gyroscope.t))


def _corrected(record: CalibrationRecord, samples: Samples, force: Array | None = None) -> Samples:
    try:
        return correct(record, samples, force)
    except NotCalibratedError:
        return samples


def bias_terms(
    record: CalibrationRecord, sensor: Sensor, temperature: Array | None, force: Array | None = None
) -> Array:
    """Return what the terms add to the bias, (n, 3) in raw units, or (3,) zeros where none applies.

    temperature: (n,) degC, NaN where unknown. Beyond the temperatures that the calibration was measured at
    the term goes on as a straight line.
    """
    offset = np.zeros(3)
    for term in record.terms:
        if term.sensor != sensor or term.effect not in _KINDS:
            continue
        if "slope" in term.parameters and temperature is not None:
            warmer = np.nan_to_num(temperature - term.reference["temperature"])
            offset = offset + warmer[:, None] * term.parameters["slope"].value
        elif "matrix" in term.parameters and force is not None:
            offset = offset + force @ term.parameters["matrix"].value.T
    return offset


def interpolated(samples: Samples, t: Array) -> Array | None:
    """Return readings at other times t (n,), s, on straight lines between them, (n, 3); None of none."""
    if not len(samples):
        return None
    return np.column_stack([np.interp(t, samples.t, samples.xyz[:, axis]) for axis in range(3)])


def mean_temperature(record: CalibrationRecord) -> float | None:
    """Return the mean temperature (degC) of the rests it stands on, else the middle of its range."""
    seen = [s.temperature for s in record.states if s.temperature is not None]
    if seen:
        return float(np.mean(seen))
    low, high = record.validity.temperature_min, record.validity.temperature_max
    return None if low is None or high is None else 0.5 * (low + high)


def _ambiguous(finding: Mapping[str, Any]) -> bool:
    return any(other.get("indistinguishable") for other in finding.get("alternatives", ()))


def _term(record: CalibrationRecord, finding: Mapping[str, Any]) -> Term:
    effect = finding["effect"]
    sensor, name, shape = _KINDS[effect]
    told = (finding.get("parameters") or {}).get(name)
    if told is None:
        raise ValueError(f"{effect}: the finding has no {name}")
    value = np.asarray(told["value"], dtype=np.float64)
    if value.shape != shape or not np.isfinite(value).all():
        raise ValueError(f"{effect}: {name} has shape {value.shape}: expected finite numbers, {shape}")
    ci95 = None if told.get("ci95") is None else frozen(np.asarray(told["ci95"], dtype=np.float64))
    reference = {}
    if name == "slope":
        t = mean_temperature(record)
        if t is None:
            raise NotSupported(
                f"{effect}: the calibration's rests have no temperature", ["a recording with temperature"]
            )
        reference = {"temperature": t}
    parameter = TermParameter(value=frozen(value), unit=str(told.get("unit", "")), ci95=ci95)
    return Term(effect=effect, sensor=sensor, parameters={name: parameter}, reference=reference)


def _referred(term: Term, temperature: float | None) -> Term | None:
    """Return a term counted from another temperature; None where it needs one and there is none."""
    if "temperature" not in term.reference:
        return term
    return None if temperature is None else replace(term, reference={"temperature": temperature})
