"""ArduPilot's parameters: INS_ACCOFFS_*, INS_ACCSCAL_*, INS_GYROFFS_*, and INS_TCAL1_*, thermal polynomials.

ArduPilot/ardupilot, libraries/AP_InertialSensor/AP_InertialSensor_Backend.cpp, _rotate_and_correct_accel:
corrected = (raw - OFFS) * SCAL by axis, in the sensor's axes; _rotate_and_correct_gyro: the same without a
scale. AP_InertialSensor_tempcal.cpp, correct_sensor, before that: raw - p(T) + p(CALTEMP) with
p(T) = (ACC1 dT + ACC2 dT^2 + ACC3 dT^3) / 10^6, dT = T - 35 degC, both temperatures held within TMIN .. TMAX.
SI units and degC. The file has a name and a value a line, as Mission Planner and MAVProxy read and write it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import UserError
from stillcal.replay.export.imu import ImuParameters, SensorPart, limits_of
from stillcal.replay.export.target import Target, commented, text_of

AXES = "XYZ"
PER_MILLION = 1e6
REFERENCE_C = 35.0
"""degC, from which ArduPilot's polynomials count."""

WIDE = (-70.0, 80.0)
"""degC, the range of TMIN and TMAX, where a curve has no limits."""

UNKNOWN_C = -300.0
"""degC, CALTEMP of a sensor that was not calibrated with a thermometer."""

NAMES = {"accelerometer": ("ACC", "ACC"), "gyroscope": ("GYR", "GYR")}
OFFSETS = {"accelerometer": "INS_ACCOFFS", "gyroscope": "INS_GYROFFS"}


class ArduPilot(Target):
    """A parameter file for Mission Planner, QGroundControl and MAVProxy (`param load`)."""

    name = "ardupilot"
    title = "ArduPilot"
    source = "ArduPilot/ardupilot AP_InertialSensor_Backend.cpp, AP_InertialSensor_tempcal.cpp"

    def holds(self, imu: ImuParameters) -> set[str]:
        """Return the biases with their slopes, and the accelerometer's scale by axis."""
        return imu.named("bias", "bias slope", "bias curve") | {"accelerometer scale"}

    def notes(self, imu: ImuParameters) -> list[str]:
        """Return what ArduPilot does by itself."""
        out = []
        if imu.gyroscope is not None and imu.gyroscope.bias is not None:
            out.append("ArduPilot measures gyroscope offsets anew at each start, unless INS_GYR_CAL is 0")
        if len({part.limits for _, part in imu.parts() if part.slope is not None}) > 1:
            out.append("both sensors share INS_TCAL1_TMIN and TMAX; they are the wider ones of the two")
        return out

    def write(self, imu: ImuParameters, remarks: Sequence[str]) -> bytes:
        """Return the parameters, a name and a value a line."""
        lines = (f"{name},{value!r}\n" for name, value in _parameters(imu))
        return (commented(remarks) + "".join(lines)).encode()

    def read(self, data: bytes) -> ImuParameters:
        """Return biases, slopes and the accelerometer's scale."""
        values = dict(_lines(text_of(data)))
        accel, gyro = (_read_part(values, name) for name in NAMES)
        if accel is None and gyro is None:
            raise UserError("holds no INS_ACCOFFS_X and no INS_GYROFFS_X with their Y and Z")
        return ImuParameters(accelerometer=accel, gyroscope=gyro)


def _parameters(imu: ImuParameters) -> Iterator[tuple[str, float | int]]:
    for name, part in imu.parts():
        if part.bias is not None:
            yield from _vector(OFFSETS[name], part.bias)
        if name == "accelerometer" and part.scale is not None:
            yield from _vector("INS_ACCSCAL", np.diag(part.scale))
    sloped = [(NAMES[name], part) for name, part in imu.parts() if part.slope is not None]
    if not sloped:
        return
    # Both temperatures of the correction are held within the range, so CALTEMP must lie in it.
    known = [part.reference_c for _, part in sloped if part.reference_c is not None]
    ends = [part.limits or WIDE for _, part in sloped]
    low, high = min([*known, *(e[0] for e in ends)]), max([*known, *(e[1] for e in ends)])
    yield from (("INS_TCAL1_ENABLE", 1), ("INS_TCAL1_TMIN", low), ("INS_TCAL1_TMAX", high))
    for (calibrated, thermal), part in sloped:
        assert part.slope is not None and part.reference_c is not None, "a slope counts from a temperature"
        yield f"INS_{calibrated}1_CALTEMP", part.reference_c
        counted = counted_from(part.powers, REFERENCE_C - part.reference_c)
        for power, values in enumerate(counted * PER_MILLION, start=1):
            yield from _vector(f"INS_TCAL1_{thermal}{power}", values)


def _vector(name: str, values: Array) -> Iterator[tuple[str, float]]:
    for axis, value in zip(AXES, values.tolist(), strict=True):
        yield f"{name}_{axis}", value


def _lines(text: str) -> Iterator[tuple[str, float]]:
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").replace("=", " ").split()
        if not words:
            continue
        try:
            name, value = words
            yield name, float(value)
        except ValueError as error:
            raise UserError(f"line {number}: expected a name and a value") from error


def _read_part(values: dict[str, float], name: str) -> SensorPart | None:
    bias = _three(values, OFFSETS[name])
    if bias is None:
        return None
    diagonal = _three(values, "INS_ACCSCAL") if name == "accelerometer" else None
    scale = None if diagonal is None else np.diag(diagonal)
    calibrated, thermal = NAMES[name]
    at = values.get(f"INS_{calibrated}1_CALTEMP", UNKNOWN_C)
    found = [_three(values, f"INS_TCAL1_{thermal}{power}") for power in (1, 2, 3)]
    powers = np.array([np.zeros(3) if c is None else c for c in found]) / PER_MILLION
    if values.get("INS_TCAL1_ENABLE") != 1 or not powers.any():
        return SensorPart(scale=scale, bias=bias, by_axis=True)
    if at == UNKNOWN_C:
        raise UserError(f"INS_TCAL1_ENABLE is 1, but INS_{calibrated}1_CALTEMP is not known")
    slope, quadratic, cubic = counted_from(powers, at - REFERENCE_C)
    limits = limits_of(values.get("INS_TCAL1_TMIN"), values.get("INS_TCAL1_TMAX"), WIDE)
    part = SensorPart(scale=scale, bias=bias, slope=slope, reference_c=at, limits=limits, by_axis=True)
    return replace(part, quadratic=quadratic, cubic=cubic)


def counted_from(powers: Array, shift: float) -> Array:
    """Return the coefficients (3, 3), powers 1 to 3, of the same polynomial about a point `shift` K on."""
    one, two, three = powers
    return np.array([one + 2.0 * two * shift + 3.0 * three * shift**2, two + 3.0 * three * shift, three])


def _three(values: dict[str, float], name: str) -> Array | None:
    found = [values.get(f"{name}_{axis}") for axis in AXES]
    return None if None in found else np.array(found, dtype=np.float64)
