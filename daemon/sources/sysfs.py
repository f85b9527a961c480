"""The kernel's accelerometers and gyroscopes as files (Documentation/ABI/testing/sysfs-bus-iio).

A channel's value is (raw + offset) * scale, in m/s^2 (in_accel) or rad/s (in_anglvel), temperatures in
thousandths of a degree (the same document). The mount matrix turns the chip's axes into the phone's, y to the
top and z out of the screen, in which a phone on its back reads +9.81 (Documentation/iio/mount-matrix): they
are Android's. Files in, numbers out; no time and no loop here.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams import limits
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.sources import chip_correction

DEVICES = "/sys/bus/iio/devices"
AXES = "xyz"
CHANNELS = {Sensor.ACCELEROMETER: "in_accel", Sensor.GYROSCOPE: "in_anglvel"}


class SensorGoneError(OSError):
    """A sensor's file cannot be read: it was removed, its driver was unloaded, or it never worked."""


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """One sensor of one device. files: of its raw x, y and z. SI value: mount @ ((raw + offset) * scale).

    chip_bias, chip_scale: (3,) what the chip corrects by itself, which is taken off again: the calibration is
    of the sensor, whatever its registers hold.
    """

    sensor: Sensor
    name: str
    folder: Path
    files: tuple[Path, ...]
    scale: Array
    offset: Array
    mount: Array
    chip_bias: Array
    chip_scale: Array

    def read(self) -> Array:
        """Return one reading (3,), SI, the phone's axes. Raises SensorGoneError."""
        raw = np.array([number(file) for file in self.files])
        with np.errstate(over="ignore", invalid="ignore"):  # refused below
            own = (raw + self.offset) * self.scale / self.chip_scale - self.chip_bias
            xyz = np.asarray(self.mount @ own)
        if not (np.abs(xyz) <= limits.READING).all():
            raise SensorGoneError(f"{self.files[0]}: {xyz.tolist()} is no reading")
        return xyz

    def read_again(self) -> Channel:
        """Return the channel with what the chip corrects by itself now. Raises SensorGoneError."""
        bias, scale = _chip(self.folder, CHANNELS[self.sensor], self.name)
        return replace(self, chip_bias=bias, chip_scale=scale)

    def correct_chip(self, bias: Array, scale: Array, memory: Path) -> bool:
        """Have the chip correct by bias (3,) and scale (3, 3), SI, the phone's axes; return whether it wrote.

        The chip takes a scale by axis only, where it takes one. Raises ChipError, and OSError with nothing
        changed.
        """
        own = self.mount.T @ bias, np.diag(self.mount.T @ scale @ self.mount)
        values = chip_correction.wanted(self.folder, CHANNELS[self.sensor], self.name, *own)
        if values:
            chip_correction.write(values, memory)
        return bool(values)


@dataclass(frozen=True, slots=True, eq=False)
class Sensors:
    """The sensors of one machine.

    gyroscope, thermometer: None where there is none. rate_hz: 0 where the driver does not say.
    """

    accelerometer: Channel
    gyroscope: Channel | None
    thermometer: Path | None
    rate_hz: float

    def channels(self) -> Iterator[Channel]:
        """Yield the sensors."""
        yield self.accelerometer
        if self.gyroscope is not None:
            yield self.gyroscope

    def read_again(self) -> Sensors:
        """Return the sensors with what the chips correct by themselves now. Raises SensorGoneError."""
        gyroscope = None if self.gyroscope is None else self.gyroscope.read_again()
        return replace(self, accelerometer=self.accelerometer.read_again(), gyroscope=gyroscope)

    def celsius(self) -> float | None:
        """Return the accelerometer's temperature, °C; None without a thermometer."""
        if self.thermometer is None:
            return None
        folder = self.thermometer.parent
        value = number(self.thermometer)
        if self.thermometer.name == "in_temp_raw":
            value = (value + _optional(folder / "in_temp_offset", 0.0)) * _optional(
                folder / "in_temp_scale", 1.0
            )
        return value / 1000.0


def find(devices: Path) -> Sensors:
    """Return the first accelerometer under `devices`, and a gyroscope: of the same device if it has one.

    Raises SensorGoneError where there is no accelerometer or one of its files makes no sense.
    """
    folders = sorted(devices.glob("iio:device*"), key=_number_of)
    accelerometer = next(_with(folders, Sensor.ACCELEROMETER), None)
    if accelerometer is None:
        raise SensorGoneError(f"no accelerometer (in_accel_x_raw) under {devices}")
    nearest = sorted(folders, key=lambda folder: folder != accelerometer)
    gyroscope = next(_with(nearest, Sensor.GYROSCOPE), None)
    thermometers = (accelerometer / name for name in ("in_temp_input", "in_temp_raw"))
    rates = ("in_accel_sampling_frequency", "sampling_frequency")
    return Sensors(
        _channel(accelerometer, Sensor.ACCELEROMETER),
        None if gyroscope is None else _channel(gyroscope, Sensor.GYROSCOPE),
        next((file for file in thermometers if file.exists()), None),
        next((number(accelerometer / name) for name in rates if (accelerometer / name).exists()), 0.0),
    )


def set_rate(sensors: Sensors, hz: float) -> bool:
    """Set the chips' sampling rate; return whether all accepted it (most allow only root, and some rates)."""
    accepted = True
    for channel in sensors.channels():
        prefix = CHANNELS[channel.sensor]
        names = (f"{prefix}_sampling_frequency", "sampling_frequency")
        file = next((channel.folder / name for name in names if (channel.folder / name).exists()), None)
        try:
            if file is not None:
                file.write_text(f"{hz:g}\n")
            accepted = accepted and file is not None
        except OSError:
            accepted = False
    return accepted


def number(file: Path) -> float:
    """Return the number that a file holds. Raises SensorGoneError."""
    text = _text(file)
    try:
        return float(text)
    except ValueError:
        raise SensorGoneError(f"{file}: expected a number, found {text[:40]!r}") from None


def matrix(text: str) -> Array:
    """Return a mount matrix (3, 3) from "a, b, c; d, e, f; g, h, i". Raises ValueError where it is none.

    >>> matrix("0, 1, 0; -1, 0, 0; 0, 0, 1") @ [1.0, 2.0, 3.0]
    array([ 2., -1.,  3.])
    """
    rows = [[float(cell) for cell in row.split(",")] for row in text.split(";")]
    value = np.array(rows)
    if value.shape != (3, 3) or not np.allclose(value @ value.T, np.eye(3), atol=0.02):
        raise ValueError(f"{text!r} is not a rotation or reflection")
    return frozen(value)


def _with(folders: list[Path], sensor: Sensor) -> Iterator[Path]:
    return (folder for folder in folders if (folder / f"{CHANNELS[sensor]}_x_raw").exists())


def _channel(folder: Path, sensor: Sensor) -> Channel:
    prefix = CHANNELS[sensor]
    scale = np.array([_shared(folder, prefix, axis, "scale", 1.0) for axis in AXES])
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        raise SensorGoneError(f"{folder}/{prefix}_scale is {scale.tolist()}: must be positive")
    name = _text(folder / "name") if (folder / "name").exists() else folder.name
    return Channel(
        sensor,
        name,
        folder,
        tuple(folder / f"{prefix}_{axis}_raw" for axis in AXES),
        frozen(scale),
        frozen([_shared(folder, prefix, axis, "offset", 0.0) for axis in AXES]),
        _mount(folder, prefix),
        *_chip(folder, prefix, name),
    )


def _shared(folder: Path, prefix: str, axis: str, what: str, default: float) -> float:
    """Return an axis's own scale or offset, else the one that the axes share, else the default."""
    own = folder / f"{prefix}_{axis}_{what}"
    return number(own) if own.exists() else _optional(folder / f"{prefix}_{what}", default)


def _optional(file: Path, default: float) -> float:
    return number(file) if file.exists() else default


def _chip(folder: Path, prefix: str, name: str) -> tuple[Array, Array]:
    """Return the bias and the scale by which the chip corrects itself. Raises SensorGoneError."""
    try:
        bias, scale = chip_correction.applied(folder, prefix, name)
    except (OSError, ValueError) as error:
        raise SensorGoneError(f"{folder}/{prefix}_?_calibbias: {error}") from error
    if not (np.isfinite(bias).all() and np.isfinite(scale).all() and (scale > 0).all()):
        raise SensorGoneError(f"{folder}/{prefix}_?_calibscale: {scale.tolist()} must be positive")
    return frozen(bias), frozen(scale)


def _mount(folder: Path, prefix: str) -> Array:
    for name in (f"{prefix}_mount_matrix", "in_mount_matrix", "mount_matrix"):
        if (folder / name).exists():
            try:
                return matrix(_text(folder / name))
            except ValueError as error:
                raise SensorGoneError(f"{folder / name}: {error}") from None
    return frozen(np.eye(3))


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="ascii", errors="replace").strip()
    except OSError as error:
        raise SensorGoneError(f"{file}: {error.strerror or os.strerror(error.errno or 0)}") from error


def _number_of(folder: Path) -> int:
    value = re.search(r"\d+$", folder.name)
    return int(value[0]) if value else 0
