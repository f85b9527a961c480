"""Writing a recording as MCAP with ROS 2 messages, which Foxglove, PlotJuggler and ROS 2 open.

Topic /imu holds both sensors where all their time stamps are shared; else /imu/accelerometer and
/imu/gyroscope hold one each, and say by a covariance that begins with -1 what they do not have
(sensor_msgs/Imu.msg). Temperatures go to /imu/temperature, one message for each change.
"""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.limits import within
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.logs.extras import library
from stillcal.replay.formats.writer import TraceWriter

_FRAME = b"imu\0"
_HEAD = [("encapsulation", "S4"), ("sec", "<i4"), ("nanosec", "<u4"), ("length", "<u4"), ("frame", "S4")]
_CDR_LITTLE_ENDIAN = b"\0\1\0\0"
"""Doubles are aligned to 8 bytes from here on (OMG DDSI-RTPS), for which a frame's name of four fits."""

_IMU = np.dtype([*_HEAD, ("doubles", "<f8", 37)])
_TEMPERATURE = np.dtype([*_HEAD, ("doubles", "<f8", 2)])
_RATE, _FORCE = 13, 25
_LATEST_S = float(1 << 31)

_COMMON = """\
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_IMU_SCHEMA = f"""\
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
{_COMMON}\
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
_TEMPERATURE_SCHEMA = f"std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n{_COMMON}"


class McapTraceWriter(TraceWriter):
    """Writes NAME.mcap, with events and claims beside it; used as TraceWriter is.

    shared: whether all stamps of the two sensors are the same, so that one topic holds both.
    """

    def __init__(self, *args: Any, shared: bool, **options: Any) -> None:
        super().__init__(*args, **options)
        self._shared = shared or not self._gyroscope

    def _begin(self, file: BinaryIO) -> None:
        library("mcap", "mcap", self.path, "MCAP")
        from mcap.writer import CompressionType, Writer  # noqa: PLC0415 - only where MCAP is written

        self._writer = Writer(file, compression=CompressionType.ZSTD)
        self._writer.start("ros2", "stillcal")
        imu = self._writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", _IMU_SCHEMA.encode())
        names = ["/imu"] if self._shared else ["/imu/accelerometer", "/imu/gyroscope"]
        self._topics = [self._writer.register_channel(name, "cdr", imu) for name in names]
        if self._temperature:
            kind = "sensor_msgs/msg/Temperature"
            schema = self._writer.register_schema(kind, "ros2msg", _TEMPERATURE_SCHEMA.encode())
            self._thermometer = self._writer.register_channel("/imu/temperature", "cdr", schema)
        self._last_temperature = np.nan

    def _append(self, rows: Array) -> None:
        if not len(rows):
            return
        if rows[0, 0] < 0 or rows[-1, 0] >= _LATEST_S or not within("t", float(rows[-1, 0])):
            what = f"time stamps from {rows[0, 0]:.6g} to {rows[-1, 0]:.6g} s do not fit into ROS messages"
            raise TraceError(self.path, what, "write .csv or .parquet")
        arrival = rows[:, self.columns.index("t_arrival")] if self._arrival else rows[:, 0]
        logged = _ns(np.where(np.isfinite(arrival) & (arrival >= 0), arrival, rows[:, 0]))
        force = rows[:, 1:4]
        rate = rows[:, 4:7] if self._gyroscope else np.full_like(force, np.nan)
        parts = [(force, rate)] if self._shared else [(force, rate * np.nan), (force * np.nan, rate)]
        for channel, (own_force, own_rate) in zip(self._topics, parts, strict=True):
            there = np.isfinite(own_force).all(axis=1) | np.isfinite(own_rate).all(axis=1)
            self._send(channel, _imu(rows[there, 0], own_force[there], own_rate[there]), logged[there])
        if self._temperature:
            self._send_temperatures(rows[:, 0], rows[:, self.columns.index("temperature")], logged)

    def _send_temperatures(self, t: Array, celsius: Array, logged: Array) -> None:
        known = np.isfinite(celsius)
        t, celsius, logged = t[known], celsius[known], logged[known]
        before = np.concatenate([[self._last_temperature], celsius[:-1]])
        changed: NDArray[np.bool_] = celsius != before
        if celsius.size:
            self._last_temperature = float(celsius[-1])
        self._send(self._thermometer, _temperatures(t[changed], celsius[changed]), logged[changed])

    def _send(self, channel: int, messages: Any, logged: Array) -> None:
        size = messages.dtype.itemsize
        content = messages.tobytes()
        for i, when in enumerate(logged.tolist()):
            self._writer.add_message(channel, when, content[i * size : (i + 1) * size], when)

    def _end(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]


def _ns(t: Array) -> Any:
    return np.rint(t * 1e9).astype(np.int64)


def _headed(t: Array, layout: Any) -> Any:
    """Return messages (n,) with their headers filled in. t: (n,) s."""
    messages = np.zeros(len(t), dtype=layout)
    stamps = _ns(t)
    messages["encapsulation"] = _CDR_LITTLE_ENDIAN
    messages["sec"], messages["nanosec"] = stamps // 10**9, stamps % 10**9
    messages["length"], messages["frame"] = len(_FRAME), _FRAME
    return messages


def _imu(t: Array, force: Array, rate: Array) -> Any:
    """Return sensor_msgs/Imu, as CDR; a quantity that is NaN is said to be absent."""
    messages = _headed(t, _IMU)
    doubles = messages["doubles"]
    doubles[:, 3], doubles[:, 4] = 1.0, -1.0  # no orientation
    for first, values in ((_RATE, rate), (_FORCE, force)):
        there = np.asarray(np.isfinite(values).all(axis=1))
        doubles[:, first : first + 3] = np.where(there[:, None], values, 0.0)
        doubles[:, first + 3] = np.where(there, 0.0, -1.0)
    return messages


def _temperatures(t: Array, celsius: Array) -> Any:
    """Return sensor_msgs/Temperature, as CDR; a variance of zero says that it is unknown."""
    messages = _headed(t, _TEMPERATURE)
    messages["doubles"][:, 0] = celsius
    return messages
