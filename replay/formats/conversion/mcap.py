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
from stillcal.calib_core.streams import ros_messages as ros
from stillcal.calib_core.streams.limits import within
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.logs.extras import library
from stillcal.replay.formats.writer import TraceWriter


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
        imu = self._writer.register_schema(ros.IMU, "ros2msg", ros.IMU_SCHEMA.encode())
        names = ["/imu"] if self._shared else ["/imu/accelerometer", "/imu/gyroscope"]
        self._topics = [self._writer.register_channel(name, "cdr", imu) for name in names]
        if self._temperature:
            schema = self._writer.register_schema(ros.TEMPERATURE, "ros2msg", ros.TEMPERATURE_SCHEMA.encode())
            self._thermometer = self._writer.register_channel("/imu/temperature", "cdr", schema)
        self._last_temperature = np.nan

    def _append(self, rows: Array) -> None:
        if not len(rows):
            return
        if rows[0, 0] < 0 or rows[-1, 0] >= ros.LATEST_S or not within("t", float(rows[-1, 0])):
            what = f"time stamps from {rows[0, 0]:.6g} to {rows[-1, 0]:.6g} s do not fit into ROS messages"
            raise TraceError(self.path, what, "write .csv or .parquet")
        arrival = rows[:, self.columns.index("t_arrival")] if self._arrival else rows[:, 0]
        logged = ros.nanoseconds(np.where(np.isfinite(arrival) & (arrival >= 0), arrival, rows[:, 0]))
        force = rows[:, 1:4]
        rate = rows[:, 4:7] if self._gyroscope else np.full_like(force, np.nan)
        parts = [(force, rate)] if self._shared else [(force, rate * np.nan), (force * np.nan, rate)]
        for channel, (own_force, own_rate) in zip(self._topics, parts, strict=True):
            there = np.isfinite(own_force).all(axis=1) | np.isfinite(own_rate).all(axis=1)
            self._send(channel, ros.imu(rows[there, 0], own_force[there], own_rate[there]), logged[there])
        if self._temperature:
            self._send_temperatures(rows[:, 0], rows[:, self.columns.index("temperature")], logged)

    def _send_temperatures(self, t: Array, celsius: Array, logged: Array) -> None:
        known = np.isfinite(celsius)
        t, celsius, logged = t[known], celsius[known], logged[known]
        before = np.concatenate([[self._last_temperature], celsius[:-1]])
        changed: NDArray[np.bool_] = celsius != before
        if celsius.size:
            self._last_temperature = float(celsius[-1])
        self._send(self._thermometer, ros.temperatures(t[changed], celsius[changed]), logged[changed])

    def _send(self, channel: int, messages: Any, logged: Array) -> None:
        size = messages.dtype.itemsize
        content = messages.tobytes()
        for i, when in enumerate(logged.tolist()):
            self._writer.add_message(channel, when, content[i * size : (i + 1) * size], when)

    def _end(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
