"""PX4's parameters: CAL_ACC0_*, CAL_GYRO0_* and the thermal polynomials TC_A0_*, TC_G0_*.

PX4/PX4-Autopilot, src/lib/sensor_calibration/Accelerometer.hpp: corrected = (raw - thermal offset - OFF) *
SCALE by axis, in the sensor's own axes; Gyroscope.hpp: the same without a scale. src/modules/
temperature_compensation/TemperatureCompensation.h: thermal offset = X3 dT^3 + X2 dT^2 + X1 dT + X0 with
dT = T - TREF, degC, T held within TMIN .. TMAX. SI units. The file is QGroundControl's: vehicle, component,
name, value and MAV_PARAM_TYPE (6 INT32, 9 REAL32), with tabs between. PX4 keeps REAL32 only: 24 bits.
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
WIDE = (-40.0, 125.0)
"""degC, where a curve has no limits: as far as parts are specified. PX4 holds the temperature within them."""

INT32, REAL32 = 6, 9
NAMES = {"accelerometer": ("ACC", "A"), "gyroscope": ("GYRO", "G")}


class Px4(Target):
    """A parameter file for QGroundControl's "Load from file" or `param import`."""

    name = "px4"
    title = "PX4"
    source = "PX4/PX4-Autopilot Accelerometer.hpp, Gyroscope.hpp, TemperatureCompensation.h"

    def holds(self, imu: ImuParameters) -> set[str]:
        """Return the biases with their slopes, and the accelerometer's scale by axis."""
        return imu.named("bias", "bias slope", "bias curve") | {"accelerometer scale"}

    def notes(self, imu: ImuParameters) -> list[str]:
        """Return what the vehicle adds."""
        out = ["CAL_ACC0_ID and CAL_GYRO0_ID stay the vehicle's own: they say which sensor is number 0"]
        if any(part.slope is not None for _, part in imu.parts()):
            out.append("set TC_A0_ID and TC_G0_ID to the same numbers; the polynomials act after a reboot")
        return out

    def write(self, imu: ImuParameters, remarks: Sequence[str]) -> bytes:
        """Return the parameters in QGroundControl's format."""
        head = commented([*remarks, "Vehicle-Id Component-Id Name Value Type"])
        return (head + "".join(f"1\t1\t{n}\t{v}\t{k}\n" for n, v, k in _parameters(imu))).encode()

    def read(self, data: bytes) -> ImuParameters:
        """Return biases, slopes and the accelerometer's scale."""
        values = dict(_lines(text_of(data)))
        accel, gyro = (_read_part(values, name) for name in NAMES)
        if accel is None and gyro is None:
            raise UserError("holds no CAL_ACC0_XOFF and no CAL_GYRO0_XOFF with their Y and Z")
        return ImuParameters(accelerometer=accel, gyroscope=gyro)


def _parameters(imu: ImuParameters) -> Iterator[tuple[str, str, int]]:
    for name, part in imu.parts():
        calibration, thermal = NAMES[name]
        if part.bias is not None:
            yield from _vector(f"CAL_{calibration}0_{{}}OFF", part.bias)
        if name == "accelerometer" and part.scale is not None:
            yield from _vector(f"CAL_{calibration}0_{{}}SCALE", np.diag(part.scale))
        if part.slope is not None and part.reference_c is not None:
            yield f"TC_{thermal}_ENABLE", "1", INT32
            low, high = part.limits or WIDE
            for suffix, value in (("TREF", part.reference_c), ("TMIN", low), ("TMAX", high)):
                yield f"TC_{thermal}0_{suffix}", repr(float(value)), REAL32
            for power, values in enumerate([np.zeros(3), *part.powers]):
                for axis, value in enumerate(values.tolist()):
                    yield f"TC_{thermal}0_X{power}_{axis}", repr(value), REAL32


def _vector(pattern: str, values: Array) -> Iterator[tuple[str, str, int]]:
    for axis, value in zip(AXES, values.tolist(), strict=True):
        yield pattern.format(axis), repr(value), REAL32


def _lines(text: str) -> Iterator[tuple[str, float]]:
    """Yield names and values; also of files with a name and a value only."""
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        pair = words[2:4] if len(words) == 5 else words
        try:
            name, value = pair
            yield name, float(value)
        except ValueError as error:
            raise UserError(
                f"line {number}: expected vehicle, component, name, value and type, or name and value"
            ) from error


def _read_part(values: dict[str, float], name: str) -> SensorPart | None:
    calibration, thermal = NAMES[name]
    bias = _three(values, [f"CAL_{calibration}0_{a}OFF" for a in AXES])
    if bias is None:
        return None
    scale = None
    if name == "accelerometer":
        diagonal = _three(values, [f"CAL_{calibration}0_{a}SCALE" for a in AXES])
        scale = None if diagonal is None else np.diag(diagonal)
    if not values.get(f"TC_{thermal}_ENABLE"):
        return SensorPart(scale=scale, bias=bias, by_axis=True)
    powers = [_three(values, [f"TC_{thermal}0_X{p}_{a}" for a in range(3)]) for p in range(4)]
    reference = values.get(f"TC_{thermal}0_TREF")
    if powers[1] is None or reference is None:
        raise UserError(
            f"TC_{thermal}_ENABLE is set, but TC_{thermal}0_X1_0 to _2 and TC_{thermal}0_TREF are not"
        )
    offset = bias if powers[0] is None else bias + powers[0]
    part = SensorPart(scale=scale, bias=offset, slope=powers[1], reference_c=reference, by_axis=True)
    limits = limits_of(values.get(f"TC_{thermal}0_TMIN"), values.get(f"TC_{thermal}0_TMAX"), WIDE)
    return replace(part, quadratic=powers[2], cubic=powers[3], limits=limits)


def _three(values: dict[str, float], names: Sequence[str]) -> Array | None:
    found = [values.get(name) for name in names]
    return None if None in found else np.array(found, dtype=np.float64)
