"""Linux industrial I/O: calibbias and calibscale of an accelerometer and a gyroscope.

Linux, Documentation/ABI/testing/sysfs-bus-iio: in_accel_x_calibbias is the offset and in_accel_x_calibscale
the factor that the hardware applies, by axis. The inv_icm42600 driver takes calibbias in SI units (m/s^2,
rad/s) into the chip's OFFSET_USER registers (drivers/iio/imu/inv_icm42600), which the chip adds to its
readings: other drivers of the ICM-42688-P write minus the bias there. Hence calibbias = -bias here, and
calibrated = calibscale (raw + calibbias). Many other drivers want counts of the chip, and some have
no calibscale: see the driver.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import UserError
from stillcal.replay.export.imu import ImuParameters, SensorPart
from stillcal.replay.export.target import Target, commented, text_of

CHANNELS = {"accelerometer": "in_accel", "gyroscope": "in_anglvel"}


class Iio(Target):
    """Names of attributes and their values, a line each."""

    name = "iio"
    title = "Linux IIO"
    source = "Linux Documentation/ABI/testing/sysfs-bus-iio"

    def holds(self, imu: ImuParameters) -> set[str]:
        """Return biases and scales by axis."""
        return imu.named("bias", "scale")

    def notes(self, imu: ImuParameters) -> list[str]:
        """Return how to put the values into effect, and where they fit."""
        return [
            "values are in SI units, which inv_icm42600 takes; other drivers may want counts",
            "as root, in /sys/bus/iio/devices/iio:device0: while read name value; do"
            " [ -e $name ] && echo $value > $name; done < FILE",
        ]

    def write(self, imu: ImuParameters, remarks: Sequence[str]) -> bytes:
        """Return the attributes."""
        return (commented(remarks) + "".join(f"{n} {v!r}\n" for n, v in _attributes(imu))).encode()

    def read(self, data: bytes) -> ImuParameters:
        """Return biases and scales."""
        values: dict[str, float] = {}
        for number, line in enumerate(text_of(data).splitlines(), 1):
            words = line.partition("#")[0].replace("=", " ").split()
            try:
                if words:
                    name, value = words
                    values[name] = float(value)
            except ValueError as error:
                raise UserError(f"line {number}: expected an attribute and its value") from error
        parts = {name: _part(values, channel) for name, channel in CHANNELS.items()}
        if not any(parts.values()):
            raise UserError("holds no in_accel_x_calibbias and no in_anglvel_x_calibbias with their y and z")
        return ImuParameters(accelerometer=parts["accelerometer"], gyroscope=parts["gyroscope"])


def _attributes(imu: ImuParameters) -> Iterator[tuple[str, float]]:
    for name, part in imu.parts():
        if part.bias is not None:
            yield from _vector(f"{CHANNELS[name]}_{{}}_calibbias", 0.0 - part.bias)
        if part.scale is not None:
            yield from _vector(f"{CHANNELS[name]}_{{}}_calibscale", np.diag(part.scale))


def _vector(pattern: str, values: Array) -> Iterator[tuple[str, float]]:
    for axis, value in zip("xyz", values.tolist(), strict=True):
        yield pattern.format(axis), value


def _part(values: dict[str, float], channel: str) -> SensorPart | None:
    bias, scale = (
        [values.get(f"{channel}_{axis}_{kind}") for axis in "xyz"] for kind in ("calibbias", "calibscale")
    )
    if None in bias:
        return None
    diagonal = None if None in scale else np.diag(np.array(scale, dtype=np.float64))
    return SensorPart(scale=diagonal, bias=0.0 - np.array(bias, dtype=np.float64), by_axis=True)
