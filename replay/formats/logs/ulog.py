"""PX4 ULog, through `pyulog` (PX4/pyulog, BSD-3).

Message fields as PX4-Autopilot defines them in msg/ (SensorAccel, SensorGyro, SensorAccelFifo,
SensorGyroFifo, VehicleImu, SensorCombined): SI units, body axes forward, right, down. Sensors that PX4 has
not corrected come first.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from io import BufferedReader, StringIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.columns import ColumnMap, SensorMap, TemperatureMap, TimeMap
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.logs.extras import library
from stillcal.replay.formats.recognition.log import BOTH, USABLE_HZ, Log, LoggedSensor, Part
from stillcal.replay.formats.sources import Source, unpacked_copy
from stillcal.replay.formats.tables.numbers import NumberTable, in_arrays

_TOPICS = [
    "sensor_accel",
    "sensor_gyro",
    "sensor_accel_fifo",
    "sensor_gyro_fifo",
    "vehicle_imu",
    "sensor_combined",
]

_NO_RELATIVE = 0x7FFFFFFF
"""sensor_combined's accelerometer_timestamp_relative without a sample: RELATIVE_TIMESTAMP_INVALID."""

_US = 1e-6
_MOST_BYTES = 4 << 30
"""pyulog holds all of a log's chosen topics in memory; an hour at 4 kHz of two sensors takes 1 GB."""

_MOST_SEEKS = 200_000
"""Seeks without getting further, beyond which a log is given up: the longest message has 65,535 bytes."""

Data = Mapping[str, Array]


class _Guarded(BufferedReader):
    """A file that ends a search for the next message which goes back and forth in one place for ever.

    pyulog 1.3.0 does so in a log that ends within a damaged message of its definitions. ended_within: whether
    the file ended where more of a message was wanted, of which pyulog says nothing.
    """

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file)  # type: ignore[arg-type]
        self._furthest, self._seeks = 0, 0
        self.ended_within = False

    def read(self, size: int | None = -1) -> bytes:
        """Read as a file does."""
        data = super().read(size)
        self.ended_within = self.ended_within or 0 < len(data) < (size or 0)
        return data

    def seek(self, offset: int, whence: int = 0) -> int:
        """Move as a file does. Raises RuntimeError where this leads nowhere any more."""
        here = self.tell()
        self._seeks = 0 if here > self._furthest else self._seeks + 1
        self._furthest = max(here, self._furthest)
        if self._seeks > _MOST_SEEKS:
            raise RuntimeError("no message is found any more")
        return super().seek(offset, whence)


def open_ulog(source: Source) -> Log:
    """Open a ULog file. Raises TraceError where it is damaged or no accelerometer was logged."""
    pyulog = library("pyulog", "ulog", source.path, "PX4 ULog")
    stored = unpacked_copy(source)
    if stored.size > _MOST_BYTES:
        what = f"{stored.size / (1 << 30):.3g} GiB are more than can be held in memory, as a ULog must be"
        raise TraceError(source.path, what, "split the log, or export its IMU topics as CSV (ulog2csv)")
    try:
        with redirect_stdout(StringIO()), stored.open() as file:  # it prints what a note says
            guarded = _Guarded(file)
            ulog = pyulog.ULog(guarded, _TOPICS, disable_str_exceptions=True)
            cut = guarded.ended_within
    except Exception as error:  # the library raises whatever its parsing meets
        what = f"the ULog is damaged ({type(error).__name__}: {error})"
        raise TraceError(source.path, what, "copy it from the vehicle again") from None
    topics = {(d.name, d.multi_id): d.data for d in ulog.data_list}
    read = _Reader(source, stored.size, topics)
    try:
        sensors = sorted(read.sensors(ulog.initial_parameters), key=lambda found: found[0] < USABLE_HZ)
    except (LookupError, TypeError, ValueError) as error:
        what = f"the ULog is damaged (the fields of a topic are not PX4's: {error})"
        raise TraceError(source.path, what, "copy it from the vehicle again") from None
    if not sensors:
        what = f"none of {', '.join(_TOPICS)} was logged"
        raise TraceError(source.path, what, "log sensor_accel and sensor_gyro (SDLOG_PROFILE, raw sensors)")
    notes = [f"{short_name(source.path)}: {line}" for line in _notes(ulog, cut=cut)]
    return Log(source.path, "PX4 ULog", [sensor for _, sensor in sensors], notes, source.local)


def _notes(ulog: Any, *, cut: bool) -> Iterator[str]:
    if getattr(ulog, "file_corruption", False):
        yield "the log is damaged in places; what could be read is used"
    elif cut:
        yield "the log is cut short within a message; what is before it is used"
    if ulog.dropouts:
        lost = sum(d.duration for d in ulog.dropouts)
        yield f"the logger dropped data {len(ulog.dropouts)} times, {lost / 1000:.3g} s in all"


class _Reader:
    """Makes sensors of the topics of one log."""

    def __init__(self, source: Source, size: int, topics: Mapping[tuple[str, int], Data]) -> None:
        self._path, self._size, self._topics = source.path, size, topics

    def sensors(self, parameters: Mapping[str, Any]) -> Iterator[tuple[float, LoggedSensor]]:
        """Yield (rate Hz, sensor), uncorrected ones first."""
        for (topic, instance), data in self._topics.items():
            if topic == "sensor_accel" and len(data["timestamp"]) > 1:
                yield self._raw(instance, data)
        for (topic, instance), data in self._topics.items():
            if topic == "sensor_accel_fifo" and len(data["timestamp"]) > 1:
                yield self._fifo(instance, data)
        for (topic, instance), data in self._topics.items():
            if topic == "vehicle_imu" and len(data["timestamp"]) > 1:
                yield self._integrated(instance, data, parameters)
        for (topic, instance), data in self._topics.items():
            if topic == "sensor_combined" and len(data["timestamp"]) > 1:
                yield self._combined(instance, data, parameters)

    def _raw(self, instance: int, data: Data) -> tuple[float, LoggedSensor]:
        parts = [self._part(data, "xyz", Sensor.ACCELEROMETER)]
        gyroscope = self._topics.get(("sensor_gyro", instance))
        if gyroscope is not None and len(gyroscope["timestamp"]) > 1:
            parts.append(self._part(gyroscope, "xyz", Sensor.GYROSCOPE))
        return _named(f"sensor_accel{instance}", _rate(data), parts)

    def _fifo(self, instance: int, data: Data) -> tuple[float, LoggedSensor]:
        """Return the sensor of the chip's own buffer, which PX4 logs at the full rate if asked to."""
        accelerometer = _unpacked(data)
        parts = [self._part(accelerometer, "xyz", Sensor.ACCELEROMETER)]
        gyroscope = self._topics.get(("sensor_gyro_fifo", instance))
        if gyroscope is not None and len(gyroscope["timestamp"]) > 1:
            parts.append(self._part(_unpacked(gyroscope), "xyz", Sensor.GYROSCOPE))
        return _named(f"sensor_accel_fifo{instance}", _rate(accelerometer), parts)

    def _part(self, data: Data, axes: Sequence[str], sensor: Sensor) -> Part:
        """Return the part of one topic with the fields x, y, z, timestamp_sample and temperature."""
        stamps = data["timestamp_sample"] if np.any(data.get("timestamp_sample", 0)) else data["timestamp"]
        columns = {"t": stamps, **{axis: data[axis] for axis in axes}}
        if "temperature" in data:
            columns["temperature"] = data["temperature"]
        return Part(self._table(columns), _map(("x", "y", "z"), sensor), [sensor])

    def _integrated(
        self, instance: int, data: Data, parameters: Mapping[str, Any]
    ) -> tuple[float, LoggedSensor]:
        """Return the sensor of vehicle_imu: velocity and angle gained in a known time (us)."""
        columns = {"t": data["timestamp_sample"] if np.any(data["timestamp_sample"]) else data["timestamp"]}
        for ours, field in (("a", "delta_velocity"), ("g", "delta_angle")):
            passed = np.maximum(np.asarray(data[f"{field}_dt"], dtype=np.float64), 1.0)
            for i, axis in enumerate("xyz"):
                columns[ours + axis] = data[f"{field}[{i}]"] / (passed * _US)
        part = Part(self._table(columns), _map_of_both(), BOTH)
        said = _corrections(self._path, parameters, instance)
        return _named(f"vehicle_imu{instance}", _rate(data), [part], said)

    def _combined(
        self, instance: int, data: Data, parameters: Mapping[str, Any]
    ) -> tuple[float, LoggedSensor]:
        gyroscope = {"t": data["timestamp"], **_axes("g", data, "gyro_rad")}
        relative = np.asarray(data.get("accelerometer_timestamp_relative", 0), dtype=np.int64)
        relative = np.broadcast_to(relative, data["timestamp"].shape)
        valid = relative != _NO_RELATIVE
        stamps = data["timestamp"].astype(np.int64) + np.where(valid, relative, 0)
        force = _axes("a", data, "accelerometer_m_s2")
        if not relative.any():
            parts = [Part(self._table(gyroscope | force), _map_of_both(), BOTH)]
        else:
            own = {"t": stamps[valid], **{name: column[valid] for name, column in force.items()}}
            maps = (
                _map(("ax", "ay", "az"), Sensor.ACCELEROMETER),
                _map(("gx", "gy", "gz"), Sensor.GYROSCOPE),
            )
            parts = [
                Part(self._table(own), maps[0], [Sensor.ACCELEROMETER]),
                Part(self._table(gyroscope), maps[1], [Sensor.GYROSCOPE]),
            ]
        said = _corrections(self._path, parameters, 0)
        name = "sensor_combined" + (str(instance) if instance else "")
        return _named(name, _rate(data), parts, said)

    def _table(self, columns: Data) -> NumberTable:
        return in_arrays(self._path, dict(columns), self._size)


def _unpacked(data: Data) -> dict[str, Array]:
    """Return the samples of a chip's buffer, one a row: timestamp in us, x, y, z in SI units.

    A message holds `samples` of them, `dt` us apart, in counts of `scale`. Its timestamp_sample is taken as
    the newest one's: it is when the buffer was read. Where messages come faster than their samples last, the
    samples stand closer, so that time never runs backwards.
    """
    room = sum(name.startswith("x[") for name in data)
    number = np.asarray(data["samples"], dtype=np.int64)[:, None]
    place = np.arange(room)
    newest = np.asarray(data["timestamp_sample"], dtype=np.float64)[:, None]
    since = np.diff(newest, axis=0, prepend=-np.inf)
    step = np.minimum(np.asarray(data["dt"], dtype=np.float64)[:, None], since / np.maximum(number, 1))
    there = np.broadcast_to(place, (len(number), room)) < number
    counts = {axis: np.column_stack([data[f"{axis}[{i}]"] for i in range(room)]) for axis in "xyz"}
    scale = np.asarray(data["scale"], dtype=np.float64)[:, None]
    return {
        "timestamp": (newest - (number - 1 - place) * step)[there],
        **{axis: (values * scale)[there] for axis, values in counts.items()},
    }


def _axes(ours: str, data: Data, field: str) -> dict[str, Array]:
    return {ours + axis: data[f"{field}[{i}]"] for i, axis in enumerate("xyz")}


def _map(columns: tuple[str, str, str], sensor: Sensor) -> ColumnMap:
    """Return the map of a topic of one sensor; a map always has an accelerometer, which is not asked for."""
    force = SensorMap(columns=columns, unit="m/s^2")
    rate = SensorMap(columns=columns, unit="rad/s") if sensor is Sensor.GYROSCOPE else None
    time, warm = TimeMap(column="t", unit="us"), TemperatureMap(column="temperature")
    return ColumnMap(time=time, accelerometer=force, gyroscope=rate, temperature=warm, repeats="keep")


def _map_of_both() -> ColumnMap:
    return ColumnMap(
        time=TimeMap(column="t", unit="us"),
        accelerometer=SensorMap(columns=("ax", "ay", "az"), unit="m/s^2"),
        gyroscope=SensorMap(columns=("gx", "gy", "gz"), unit="rad/s"),
        repeats="keep",
    )


def _named(
    name: str, rate: float, parts: Sequence[Part], notes: Sequence[str] = ()
) -> tuple[float, LoggedSensor]:
    gyroscope = len(parts) > 1 or len(parts[0].sensors) > 1
    about = f"accelerometer{', gyroscope' if gyroscope else ''}, {rate:.3g} Hz"
    return rate, LoggedSensor.of(name, parts, about, notes)


def _rate(data: Data) -> float:
    stamps = np.asarray(data["timestamp"], dtype=np.float64) * _US
    return float((len(stamps) - 1) / max(stamps[-1] - stamps[0], 1e-9))


def _corrections(path: Path, parameters: Mapping[str, Any], instance: int) -> list[str]:
    """Say what PX4 has corrected already: its calibration, and its temperature polynomials."""
    said = []
    for sensor, name in (("ACC", "accelerometer"), ("GYRO", "gyroscope")):
        offsets = [parameters.get(f"CAL_{sensor}{instance}_{axis}OFF", 0.0) for axis in "XYZ"]
        if any(offsets):
            said.append(f"{name} (CAL_{sensor}{instance}_*OFF {' '.join(f'{o:.4g}' for o in offsets)})")
    hot = [f"TC_{s}_ENABLE" for s in "AG" if parameters.get(f"TC_{s}_ENABLE", 0)]
    said += [f"temperature ({' '.join(hot)})"] if hot else []
    if not said:
        return []
    return [f"{short_name(path)}: PX4 has corrected these values already: {', '.join(said)}"]
