"""MATLAB's imuSensor: accelparams and gyroparams, as a function that makes the sensor.

Read from the C that Simulink generates for the IMU block (fusion.internal.AccelerometerSimulator, step):
output = (1 + (T - 25) TemperatureScaleFactor / 100) (AxesMisalignment / 100 @ input + ConstantBias + noise
+ (T - 25) TemperatureBias), T in degC, SI units. White noise has the standard deviation
NoiseDensity sqrt(SampleRate / 2) for NoiseType "double-sided", its default; the random walk steps by
RandomWalk / sqrt(SampleRate / 2). The accelerometer's input is gravity less acceleration, which is minus the
specific force: its bias has the other sign than a store's. AccelerationBias of gyroparams multiplies the
acceleration without gravity in the world's axes, so it is no g-sensitivity.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import UserError
from stillcal.replay.export.imu import ImuParameters, SensorPart
from stillcal.replay.export.target import Target, commented, finite, text_of

REFERENCE_C = 25.0
PERCENT = 100.0
SIGNS = {"accelerometer": -1.0, "gyroscope": 1.0}
ASSIGNMENT = re.compile(
    r"^\s*\w+\.(Accelerometer|Gyroscope)\.(\w+)\s*=\s*(?:\[([^\]%]*)\]|([^\[;%]*));", re.MULTILINE
)
"""imu.Gyroscope.ConstantBias = [x y z]; or one number in place of the list."""


class ImuSensor(Target):
    """An .m file; imu = FILE(); then [accel, gyro] = imu(acceleration, rate, orientation)."""

    name = "imusensor"
    title = "MATLAB imuSensor"
    source = "C code generated from imuSensor by Simulink Coder; mathworks.com/help/nav/ref/accelparams.html"

    def holds(self, imu: ImuParameters) -> set[str]:
        """Return all but g-sensitivity and delay."""
        return imu.named("scale", "misalignment", "bias", "bias slope", "white noise", "slow noise")

    def notes(self, imu: ImuParameters) -> list[str]:
        """Return what a user of MATLAB must know."""
        out = ["imuSensor's accelerometer gives minus the specific force: negate it before you compare"]
        if any(part.slope is not None for _, part in imu.parts()):
            out.append(f"biases are those at {REFERENCE_C:g} degC, from which imuSensor's temperature counts")
        if any(part.bent for _, part in imu.parts()):
            out.append(f"TemperatureBias is the slope of the bias' curve at {REFERENCE_C:g} degC")
        if imu.rate_hz is None:
            out.append("the noise is not known, so there is none: add --phone")
        return out

    def write(self, imu: ImuParameters, remarks: Sequence[str]) -> bytes:
        """Return the function."""
        rate = "" if imu.rate_hz is None else f", 'SampleRate', {imu.rate_hz!r}"
        text = "function imu = calibrated_imu()\n" + commented(remarks, "% ")
        text += f"imu = imuSensor('accel-gyro'{rate});\n"
        for name, part in imu.parts():
            for key, value in settings(name, part).items():
                text += f"imu.{name.capitalize()}.{key} = {_matlab(value)};\n"
        return (text + "end\n").encode()

    def read(self, data: bytes) -> ImuParameters:
        """Return scale, bias and slope from assignments such as imu.Gyroscope.ConstantBias = [x y z];."""
        found: dict[str, dict[str, str]] = {"accelerometer": {}, "gyroscope": {}}
        for sensor, key, listed, alone in ASSIGNMENT.findall(text_of(data)):
            found[sensor.lower()][key] = listed or alone
        parts = {name: _part(name, values) for name, values in found.items() if "ConstantBias" in values}
        if not parts:
            raise UserError("holds no line such as imu.Accelerometer.ConstantBias = [x y z];")
        return ImuParameters(accelerometer=parts.get("accelerometer"), gyroscope=parts.get("gyroscope"))


def settings(name: str, part: SensorPart) -> dict[str, Array]:
    """Return the properties of one sensor by name, in imuSensor's units."""
    sign, out = SIGNS[name], {}
    if part.scale is not None:
        out["AxesMisalignment"] = PERCENT * part.gain
    if part.bias is not None:
        out["ConstantBias"] = sign * part.bias_at(REFERENCE_C)
    if part.slope is not None:
        out["TemperatureBias"] = sign * tangent_at(part, REFERENCE_C)
    if part.noise is not None:
        out["NoiseDensity"] = part.noise.white
        if part.noise.slow:
            out["RandomWalk"] = part.noise.walk_alike() / np.sqrt(2.0)
    return out


def tangent_at(part: SensorPart, temperature: float) -> Array:
    """Return the slope (3,) of a part's curve at a temperature, per K."""
    one, two, three = part.powers
    warmer = temperature - (part.reference_c or 0.0)
    return np.asarray(one + 2.0 * two * warmer + 3.0 * three * warmer**2)


def _matlab(value: Array) -> str:
    rows = np.atleast_2d(value) + 0.0
    return "[" + "; ".join(" ".join(map(repr, row)) for row in rows.tolist()) + "]"


def _part(name: str, values: dict[str, str]) -> SensorPart:
    sign = SIGNS[name]
    slope = None
    if "TemperatureBias" in values:
        slope = sign * _values(values["TemperatureBias"], name, "TemperatureBias")
    scale = None
    if "AxesMisalignment" in values:
        gain = finite(_split(values["AxesMisalignment"]), (3, 3), f"{name}: AxesMisalignment") / PERCENT
        if abs(np.linalg.det(gain)) < 1e-6:
            raise UserError(f"{name}: AxesMisalignment has no inverse")
        scale = np.asarray(np.linalg.inv(gain))
    return SensorPart(
        scale=scale,
        bias=sign * _values(values["ConstantBias"], name, "ConstantBias"),
        slope=slope,
        reference_c=None if slope is None else REFERENCE_C,
    )


def _values(text: str, name: str, key: str) -> Array:
    """Return three numbers; one stands for all axes, as in MATLAB."""
    words = _split(text)
    return finite(words * 3 if len(words) == 1 else words, (3,), f"{name}: {key}")


def _split(text: str) -> list[str]:
    return text.replace(";", " ").replace(",", " ").split()
