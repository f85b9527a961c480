"""Corrected samples as MCAP files, which Foxglove, PlotJuggler, Rerun and ROS 2 open.

Messages are ROS 2's own: sensor_msgs/Imu with one sensor each on /imu/accelerometer and /imu/gyroscope, and
on /imu/uncalibrated/... while there is no calibration; sensor_msgs/Temperature on /imu/temperature, one for
each change. /calibration has the calibration as JSON whenever it changes. A message's stamp is the daemon's
time; it is logged at the time of day, by this computer's clock, when the sample was taken.

The first file has the name that was given, the next ones a number (live.2.mcap, live.3.mcap, ...). A file
begins with the first sample and ends at FILE_BYTES. The newest are kept, as much as FILES full ones hold, so
that a daemon which restarts without end deletes none. What was published is with the system after FLUSH_S. A
daemon that is killed leaves a file without its index, which `stillcal convert` and `mcap recover` read.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import os
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.record import CalibrationRecord, SensorRecord
from stillcal.calib_core.streams import ros_messages as ros
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.service.live_stream import Interruption, Live, LiveBlock
from stillcal.daemon.settings import SettingsError
from stillcal.daemon.system.clock import Clock, host_time
from stillcal.daemon.system.files import RESERVE_BYTES

FILE_BYTES = 64 * 2**20
FILES = 8
MOST_FILES = 1000
"""Files that are kept however small they are."""

FLUSH_S = 5.0

SLEW, LEAP_S = 0.01, 10.0
"""The times of day follow the sensor's own clock, and this computer's by so much of the time that has passed,
so that they never run back. Where the two are further apart, s, they begin anew."""

_MATRIX = {"type": "array", "items": {"type": "array", "items": {"type": "number"}}}
_VECTOR = {"type": "array", "items": {"type": "number"}}
_SENSOR = {"type": "object", "properties": {"scale": _MATRIX, "bias": _VECTOR}}
_CALIBRATION = {
    "title": "stillcal.Calibration",
    "type": "object",
    "description": "calibrated = scale @ (raw - bias), m/s^2 and rad/s",
    "properties": {"id": {"type": "string"}, "accelerometer": _SENSOR, "gyroscope": _SENSOR},
}


class McapFiles:
    """Writes live samples to `path` and its successors. clock: CLOCK_BOOTTIME; time_of_day: s since 1970."""

    patience_s = 0.2

    def __init__(self, path: Path, clock: Clock = host_time, time_of_day: Clock = time.time) -> None:
        self.name = str(path)
        self._path, self._clock, self._time_of_day = path, clock, time_of_day
        self._file: BinaryIO | None = None
        self._writer: Any = None
        self._offset: float | None = None
        self._seen = 0.0

    def open(self) -> None:
        """See that a file can be begun. Raises OSError; SettingsError without library or folder."""
        try:
            importlib.import_module("mcap.writer")
        except ImportError:
            what = f"{self._path} is written by the library mcap: pip install 'stillcal[mcap]'"
            raise SettingsError(what) from None
        if not self._path.parent.is_dir():
            raise SettingsError(f"{self._path}: there is no folder {self._path.parent}: make it first")
        if not os.access(self._path.parent, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(self._path.parent))
        self._check_room()

    def take(self, items: Sequence[Live]) -> None:
        """Write samples. Raises OSError."""
        for item in items:
            if isinstance(item, Interruption):
                self._offset = None
                continue
            if self._file is None:
                self._begin()
            self._write(item)
        if self._file is not None and self._clock() - self._flushed >= FLUSH_S:
            self._flush()

    def close(self) -> None:
        """Complete the file, with its index. Raises OSError."""
        file, self._file = self._file, None
        if file is not None:
            with file:
                self._writer.finish()

    # Files

    def _begin(self) -> None:
        from mcap.writer import CompressionType, Writer  # noqa: PLC0415 - only where it is asked for

        self._check_room()
        numbered = _numbered(self._path)
        path = self._path.with_stem(f"{self._path.stem}.{max(numbered) + 1}") if numbered else self._path
        self._file = path.open("xb")
        _delete_oldest([numbered[number] for number in sorted(numbered, reverse=True)])
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        self._writer.start("ros2", "stillcal")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._record: CalibrationRecord | None = None
        self._celsius: float | None = None
        self._offset = None
        self._flushed = self._clock()

    def _flush(self) -> None:
        """Hand what was written to the system, and begin another file where this one is full."""
        assert self._file is not None
        self._flushed = self._clock()
        self._check_room()
        self._writer.flush()
        if self._file.tell() >= FILE_BYTES:
            self.close()
            self._begin()

    def _check_room(self) -> None:
        """Raise OSError where the disk is nearly full; nothing is deleted then."""
        room = os.statvfs(self._path.parent)
        if room.f_bavail * room.f_frsize < RESERVE_BYTES:
            raise OSError(errno.ENOSPC, f"less than {RESERVE_BYTES // 2**20} MiB are left on the disk")

    # Messages

    def _write(self, block: LiveBlock) -> None:
        samples = block.samples
        fit = (samples.t >= 0) & (samples.t < ros.LATEST_S)
        if not fit.all():
            return  # a stamp that ROS cannot hold: a phone's clock that is years off
        logged = self._logged(samples.t, block.host_s)
        if block.record is not None and block.record is not self._record:
            self._record = block.record
            self._send("/calibration", "json", [_described(block.record)], logged[:1])
        topic = f"/imu/{'' if block.calibrated else 'uncalibrated/'}{samples.sensor.value}"
        absent = np.full_like(samples.xyz, np.nan)
        accelerometer = samples.sensor is Sensor.ACCELEROMETER
        force, rate = (samples.xyz, absent) if accelerometer else (absent, samples.xyz)
        self._send(topic, ros.IMU, [m.tobytes() for m in ros.imu(samples.t, force, rate)], logged)
        if accelerometer:
            self._write_temperature(samples, logged)

    def _write_temperature(self, samples: Samples, logged: Any) -> None:
        """Write the last temperature of a block if it is another one."""
        celsius = None if samples.temperature is None else float(samples.temperature[-1])
        if celsius is not None and np.isfinite(celsius) and celsius != self._celsius:
            self._celsius = celsius
            message = ros.temperatures(samples.t[-1:], np.array([celsius])).tobytes()
            self._send("/imu/temperature", ros.TEMPERATURE, [message], logged[-1:])

    def _logged(self, t: Array, host_s: float) -> Any:
        """Return the samples' times of day, ns; (n,)."""
        target = self._time_of_day() - (self._clock() - host_s) - float(t[-1])
        if self._offset is None or abs(target - self._offset) > LEAP_S:
            self._offset, self._seen = target, float(t[-1])
        step = SLEW * max(float(t[-1]) - self._seen, 0.0)
        self._offset += min(max(target - self._offset, -step), step)
        self._seen = max(self._seen, float(t[-1]))
        return ros.nanoseconds(np.maximum(t + self._offset, 0.0))

    def _send(self, topic: str, kind: str, messages: Sequence[bytes], logged: Any) -> None:
        channel = self._channel(topic, kind)
        for when, message in zip(logged.tolist(), messages, strict=True):
            self._writer.add_message(channel, when, message, when)

    def _channel(self, topic: str, kind: str) -> int:
        if topic not in self._channels:
            if kind not in self._schemas:
                self._schemas[kind] = self._writer.register_schema(*_SCHEMAS[kind])
            encoding = "json" if kind == "json" else "cdr"
            self._channels[topic] = self._writer.register_channel(topic, encoding, self._schemas[kind])
        return self._channels[topic]


_SCHEMAS = {
    ros.IMU: (ros.IMU, "ros2msg", ros.IMU_SCHEMA.encode()),
    ros.TEMPERATURE: (ros.TEMPERATURE, "ros2msg", ros.TEMPERATURE_SCHEMA.encode()),
    "json": ("stillcal.Calibration", "jsonschema", msgspec.json.encode(_CALIBRATION)),
}
"""Kind of message -> its schema's name, encoding and text."""


def _described(record: CalibrationRecord) -> bytes:
    parts: dict[str, SensorRecord | None] = {
        "accelerometer": record.accelerometer,
        "gyroscope": record.gyroscope,
    }
    known = {
        name: {"scale": part.scale.tolist(), "bias": part.bias.tolist()}
        for name, part in parts.items()
        if part is not None
    }
    return msgspec.json.encode({"id": record.id, **known})


def _numbered(path: Path) -> dict[int, Path]:
    """Return the files of this name that are there, by number; the first has none in its name."""
    pattern = re.compile(rf"{re.escape(path.stem)}(?:\.(\d+))?{re.escape(path.suffix)}")
    found = ((pattern.fullmatch(there.name), there) for there in path.parent.iterdir())
    return {int(match[1] or 1): there for match, there in found if match is not None}


def _delete_oldest(files: Sequence[Path]) -> None:
    """Delete those of these files, newest first, that are too much beside one that begins."""
    held = 0
    for kept, path in enumerate(files):
        with contextlib.suppress(OSError):  # it is gone, or a folder of this name
            held += min(path.stat().st_size, FILE_BYTES)
            if held > (FILES - 1) * FILE_BYTES or kept >= MOST_FILES:
                path.unlink()
