"""From a file that was read back to a calibration for the store."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.corrections.bias_temperature import learnt_between
from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.record import (
    AccelerometerRecord,
    Acceptance,
    CalibrationRecord,
    GyroscopeRecord,
    Provenance,
    Validity,
)
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.export.imu import ImuParameters, SensorPart, can_be_read, of_record

CURVE = ("slope", "quadratic", "cubic", "reference_c", "limits")
SAME_BIAS = 1e-9
"""m/s^2 or rad/s: a bias that was written and read back differs by less."""

AFFINE, SYMMETRIC, DIAGONAL = 12, 9, 6
"""Numbers of a calibration whose scale is any matrix, symmetric or triangular, or diagonal."""


def record_of(imu: ImuParameters, before: CalibrationRecord | None, source: str) -> CalibrationRecord:
    """Return what a file holds as a calibration; what it does not hold stays as it was `before`.

    Where nothing was before, a scale that is not known is unity and a bias that is not known is zero: both
    are what a sensor without calibration has. Raises ValueError where the numbers are no calibration.
    """
    old = ImuParameters() if before is None else of_record(before)
    accel = _merged(imu.accelerometer, old.accelerometer)
    gyro = _merged(imu.gyroscope, old.gyroscope)
    kept, _ = _beyond_files(imu, before)
    terms = [*_terms(accel, Sensor.ACCELEROMETER), *_terms(gyro, Sensor.GYROSCOPE), *kept]
    gravity = STANDARD
    if before is not None and before.accelerometer is not None:
        gravity = before.accelerometer.gravity
    return CalibrationRecord(
        accelerometer=_accelerometer(accel, gravity),
        gyroscope=_gyroscope(gyro),
        gravity=None if before is None else before.gravity,
        validity=Validity() if before is None else before.validity,
        acceptance=Acceptance(how="migration", reason=f"imported from {source}"),
        provenance=Provenance(source=source, device="" if before is None else before.provenance.device),
        terms=tuple(terms),
    )


def not_in_file(imu: ImuParameters, before: CalibrationRecord | None) -> list[str]:
    """Return what a file does not hold, a line each, with what is taken instead."""
    old = ImuParameters() if before is None else of_record(before)
    out = []
    for name, default in (("accelerometer", old.accelerometer), ("gyroscope", old.gyroscope)):
        part: SensorPart | None = getattr(imu, name)
        for field in ("scale", "bias") if part is not None else ():
            if getattr(part, field) is None:
                kept = default is not None and getattr(default, field) is not None
                other = "unity is taken" if field == "scale" else "zero is taken"
                out.append(f"{name} {field}: {'the store keeps its own' if kept else other}")
        if part is not None and default is not None and _keeps_crossed(part, default):
            out.append(f"{name} misalignment: the store keeps its own")
        if part is not None and default is not None:
            out.extend(f"{name} {line}" for line in _of_curve(part, default))
        if part is None and default is not None:
            out.append(f"{name}: the store keeps its own")
    staying, dropped = _beyond_files(imu, before)
    out += [f"{term.effect}: the store keeps its own" for term in staying]
    out += [f"{term.effect}: the store's own is dropped, as {_OF_ANOTHER}" for term in dropped]
    return out


_OF_ANOTHER = "the new bias and scale were fitted without it ('stillcal store rollback' undoes the import)"


def _beyond_files(imu: ImuParameters, before: CalibrationRecord | None) -> tuple[list[Term], list[Term]]:
    """Return those terms of the store that no file can give back: which are kept, and which are dropped.

    They belong to the bias and the scale that were fitted with them, and are kept where these stay.
    """
    kept: list[Term] = []
    dropped: list[Term] = []
    if before is None:
        return kept, dropped
    old = of_record(before)
    for term in before.terms:
        name = "accelerometer" if term.sensor == Sensor.ACCELEROMETER else "gyroscope"
        own: SensorPart | None = getattr(old, name)
        after = _merged(getattr(imu, name), own)
        if not can_be_read(term):
            (kept if own is None or after is None or _is_same(after, own) else dropped).append(term)
    return kept, dropped


def _is_same(one: SensorPart, other: SensorPart) -> bool:
    """Tell whether two parts have the same bias and scale."""
    pairs = ((one.offset, other.offset), (one.gain, other.gain))
    return all(np.allclose(a, b, rtol=0.0, atol=SAME_BIAS) for a, b in pairs)


def _of_curve(part: SensorPart, old: SensorPart) -> Iterator[str]:
    """Say what becomes of the store's curve of temperature where the file does not have all of it."""
    if old.slope is None or part.bias is None:
        return
    if _keeps_curve(part, old):
        yield "bias by temperature: the store keeps its own"
    elif part.slope is None:
        yield (
            "bias by temperature: the store's own is dropped, because the new bias holds at a temperature"
            " that is not known ('stillcal store rollback' undoes the import)"
        )
    elif old.bent and not part.bent:
        yield "bias curve: the store's own gives way to the file's straight line"


def _merged(fresh: SensorPart | None, old: SensorPart | None) -> SensorPart | None:
    if fresh is None or old is None:
        return fresh or old
    known = {
        name: value for name in ("scale", "bias", "matrix") if (value := getattr(fresh, name)) is not None
    }
    if fresh.scale is not None and _keeps_crossed(fresh, old):
        known["scale"] = fresh.scale + old.crossed
    if fresh.bias is not None and not _keeps_curve(fresh, old):
        # Without a slope of its own a new bias holds at a temperature that nobody knows: the old curve has
        # no start any more.
        known |= {name: getattr(fresh, name) for name in CURVE}
    return replace(old, **known)


def _keeps_curve(fresh: SensorPart, old: SensorPart) -> bool:
    """Whether the old curve holds on: the file has none, and has the bias that it is about."""
    if fresh.slope is not None or fresh.bias is None or old.bias is None:
        return False
    return bool(np.allclose(fresh.bias, old.bias, rtol=0.0, atol=SAME_BIAS))


def _keeps_crossed(fresh: SensorPart, old: SensorPart) -> bool:
    """Whether the old scale has what a file with scales by axis cannot say."""
    return fresh.by_axis and fresh.scale is not None and bool(old.crossed.any())


def _accelerometer(part: SensorPart | None, gravity: float) -> AccelerometerRecord | None:
    if part is None:
        return None
    scale = np.eye(3) if part.scale is None else part.scale
    return AccelerometerRecord(scale=scale, bias=part.offset, parameters=_parameters(scale), gravity=gravity)


def _gyroscope(part: SensorPart | None) -> GyroscopeRecord | None:
    if part is None:
        return None
    scale = np.eye(3) if part.scale is None else part.scale
    count = 3 if np.array_equal(scale, np.eye(3)) else _parameters(scale)
    return GyroscopeRecord(scale=scale, bias=part.offset, parameters=count)


def _parameters(scale: Array) -> int:
    upper, lower = np.triu(scale, 1), np.tril(scale, -1)
    if not upper.any() and not lower.any():
        return DIAGONAL
    return (
        SYMMETRIC if not upper.any() or not lower.any() or np.allclose(upper, lower.T, atol=1e-12) else AFFINE
    )


def _terms(part: SensorPart | None, sensor: Sensor) -> list[Term]:
    out: list[Term] = []
    if part is None:
        return out
    accel = sensor == Sensor.ACCELEROMETER
    if part.slope is not None and part.reference_c is not None:
        unit = "m/s^2" if accel else "rad/s"
        effect = "accel_bias_temperature" if accel else "gyro_bias_temperature"
        per = {"slope": "K", "quadratic": "K^2", "cubic": "K^3"}
        curve = {
            name: TermParameter(value=frozen(getattr(part, name)), unit=f"{unit}/{k}")
            for name, k in per.items()
            if name == "slope" or (getattr(part, name) is not None and part.bent)
        }
        reference = {"temperature": part.reference_c}
        if part.limits is not None:
            reference |= dict(
                zip(("temperature_min", "temperature_max"), learnt_between(*part.limits), strict=True)
            )
        out.append(Term(effect=effect, sensor=sensor, parameters=curve, reference=reference))
    if part.matrix is not None:
        matrix = TermParameter(value=frozen(part.matrix), unit="(rad/s)/(m/s^2)")
        out.append(Term(effect="gyro_g_sensitivity", sensor=sensor, parameters={"matrix": matrix}))
    return out
