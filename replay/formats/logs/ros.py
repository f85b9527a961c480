"""ROS 1 and ROS 2 bags, through `rosbags` (Ternaris, Apache-2.0), and lone MCAP files, through `mcap` (MIT).

Every topic of type sensor_msgs/Imu is a sensor: SI units, acceleration with gravity (REP 145). A covariance
that begins with -1 says that the message has no such quantity (sensor_msgs/Imu.msg); a topic of accelerations
alone is paired with one of rates alone, as depth cameras publish them.
"""

from __future__ import annotations

import os
import struct
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.columns import ColumnMap, SensorMap, TemperatureMap, TimeMap
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.logs.extras import library
from stillcal.replay.formats.recognition import magic
from stillcal.replay.formats.recognition.log import BOTH, USABLE_HZ, Log, LoggedSensor, Part
from stillcal.replay.formats.recognition.settling.units import rate_unit_shown
from stillcal.replay.formats.sources import Source, unpacked_copy
from stillcal.replay.formats.tables.numbers import NumberTable

FOLDER_INDEX = "metadata.yaml"
"""A file that makes its folder a ROS 2 bag."""

IMU, TEMPERATURE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/Temperature"
_ENDINGS = {magic.ROS1: ".bag", magic.ROS2: ".db3"}
_DOUBLES = 37
"""Orientation, rate and acceleration, a covariance after each, end an Imu message: 4 + 9 + 3 + 9 + 3 + 9."""

_RATE, _FORCE = 4 + 9, 4 + 9 + 3 + 9
_BLOCK = 4096
_PROBED = 200
_NEAR_ONE = 0.3
"""g: a driver that publishes g against REP 145 shows gravity as one, with bias, scale and motion."""

_SHOWN = 3
"""Spans of some seconds that must show rates to be in deg/s, against REP 145."""

_NS = 1e-9
_MCAP_HEAD = struct.Struct("<BQ")
_FARTHEST = 1 << 62
"""Bytes: no file is so long."""

_MCAP_MAGIC = b"\x89MCAP0\r\n"
"""Begins a file, and ends one that was completed."""

_NAMES = ["stamp", "logged", "gx", "gy", "gz", "ax", "ay", "az", "temperature"]
_MOST_TEMPERATURES = 1_000_000
_RAW = "_raw"
"""How the name of a topic ends whose values nothing was done to (imu/data_raw, REP 145)."""

_ZSTD = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True, slots=True)
class _Stored:
    """Messages of one topic as stored. layout: "ros1" or "cdr"."""

    topic: str
    type: str
    layout: str
    count: int


@dataclass(frozen=True, slots=True)
class _Topic:
    """A topic of Imu messages and what its first messages hold."""

    name: str
    count: int
    rate_hz: float
    has_force: bool
    has_rate: bool
    stamped: bool
    in_g: bool


Message = tuple[int, bytes]
"""When it was logged, ns, and its bytes."""


def open_ros(source: Source, kind: str) -> Log:
    """Open a bag that is one file. Raises TraceError where it is damaged or holds no Imu messages."""
    container: _Container
    if kind == magic.MCAP:
        library("mcap", "mcap", source.path, kind)
        container = _Mcap(unpacked_copy(source))
    else:
        library("rosbags", "ros", source.path, kind)
        container = _Rosbag(*_ending_in(unpacked_copy(source), _ENDINGS[kind]))
    return _Bag(source.path, container, kind, source.size, source.local).log()


def open_ros_folder(folder: Path) -> Log:
    """Open a ROS 2 bag that is a folder with FOLDER_INDEX. Raises TraceError as open_ros."""
    library("rosbags", "ros", folder, magic.ROS2)
    size = sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
    return _Bag(folder, _Rosbag(folder, None), magic.ROS2, size, folder).log()


def _ending_in(stored: Source, ending: str) -> tuple[Path, Any]:
    """Return a path to the file that ends as `rosbags` expects, and what must live as long."""
    assert stored.local is not None
    if stored.local.suffix == ending:
        return stored.local, stored
    folder = tempfile.TemporaryDirectory(prefix="stillcal-")
    link = Path(folder.name) / f"recording{ending}"
    link.symlink_to(stored.local.resolve())
    return link, (stored, folder)


class _Container(Protocol):
    """A file or folder of messages."""

    @property
    def unfinished(self) -> bool:
        """Whether it breaks off."""
        ...

    def topics(self) -> list[_Stored]:
        """Return what is stored."""
        ...

    def messages(self, topic: str) -> Iterator[Message]:
        """Yield the messages of a topic as they were logged."""
        ...


class _Rosbag:
    """A bag read by `rosbags`. keep: what must live as long as it."""

    unfinished = False

    def __init__(self, path: Path, keep: Any) -> None:
        self._path, self._keep = path, keep
        self._one = path.suffix == ".bag"

    def _reader(self) -> Any:
        from rosbags.rosbag1 import Reader as Reader1  # noqa: PLC0415 - only where a bag is read
        from rosbags.rosbag2 import Reader as Reader2  # noqa: PLC0415 - the same

        return (Reader1 if self._one else Reader2)(self._path)

    def topics(self) -> list[_Stored]:
        """Return what is stored."""
        layout = "ros1" if self._one else "cdr"
        with self._reader() as reader:
            return [_Stored(c.topic, c.msgtype, layout, c.msgcount) for c in reader.connections]

    def messages(self, topic: str) -> Iterator[Message]:
        """Yield the messages of a topic as they were logged."""
        with self._reader() as reader:
            connections = [c for c in reader.connections if c.topic == topic]
            for _, logged, raw in reader.messages(connections):
                yield logged, bytes(raw)


class _Mcap:
    """A file read by `mcap`, which takes any profile; ROS 1 messages name their type without `msg`.

    One that ends without its index is read from its beginning up to its last whole chunk.
    """

    def __init__(self, stored: Source) -> None:
        self._stored = stored
        with stored.open() as file:
            file.seek(-len(_MCAP_MAGIC), os.SEEK_END)
            self._whole = file.read() == _MCAP_MAGIC

    @property
    def unfinished(self) -> bool:
        """Whether it breaks off."""
        return not self._whole

    def topics(self) -> list[_Stored]:
        """Return what is stored."""
        from mcap.reader import make_reader  # noqa: PLC0415 - only where MCAP is read

        if self.unfinished:
            counts = Counter((_type(s), c.topic, c.message_encoding) for s, c, _ in self._scanned())
            if not counts:
                raise ValueError("it breaks off before its first whole message")
            return [_Stored(topic, kind, layout, n) for (kind, topic, layout), n in counts.items()]
        with self._stored.open() as file:
            summary = make_reader(file).get_summary()
        if summary is None:
            raise ValueError("it has no summary")
        per_channel = summary.statistics.channel_message_counts if summary.statistics is not None else {}
        return [
            _Stored(
                c.topic, _type(summary.schemas.get(c.schema_id)), c.message_encoding, per_channel.get(c.id, 0)
            )
            for c in summary.channels.values()
        ]

    def messages(self, topic: str) -> Iterator[Message]:
        """Yield the messages of a topic in the order in which they were written."""
        from mcap.reader import make_reader  # noqa: PLC0415 - only where MCAP is read

        if self.unfinished:
            yield from ((m.log_time, m.data) for _, c, m in self._scanned() if c.topic == topic)
            return
        with self._stored.open() as file:
            for _, _, message in make_reader(file).iter_messages(topics=[topic], log_time_order=False):
                yield message.log_time, message.data

    def _scanned(self) -> Iterator[tuple[Any, Any, Any]]:
        """Yield the schema, channel and message of each message up to where the file breaks off."""
        from mcap import records  # noqa: PLC0415 - only where MCAP is read
        from mcap.exceptions import EndOfFile  # noqa: PLC0415 - the same
        from mcap.stream_reader import StreamReader  # noqa: PLC0415 - the same

        schemas: dict[int, Any] = {}
        channels: dict[int, Any] = {}
        with self._stored.open() as file, suppress(EndOfFile):
            for record in StreamReader(_Upto(file, _end_of_records(file))).records:  # type: ignore[arg-type]
                if isinstance(record, records.Schema):
                    schemas[record.id] = record
                elif isinstance(record, records.Channel):
                    channels[record.id] = record
                elif isinstance(record, records.Message):
                    channel = channels[record.channel_id]
                    yield schemas.get(channel.schema_id), channel, record


def _end_of_records(file: BinaryIO) -> int:
    """Return where a file's records end, or zeros begin, as a disk leaves them after a crash; bytes."""
    at, head = len(_MCAP_MAGIC), b""
    while at < _FARTHEST:
        file.seek(at)
        head = file.read(_MCAP_HEAD.size)
        if len(head) < _MCAP_HEAD.size or not head[0]:
            break
        at += _MCAP_HEAD.size + _MCAP_HEAD.unpack(head)[1]
    file.seek(0)
    return at


class _Upto:
    """Reads a file up to a place."""

    def __init__(self, file: BinaryIO, end: int) -> None:
        self._file, self._left = file, end

    def read(self, size: int) -> bytes:
        """Read so many bytes at most."""
        data = self._file.read(min(size, self._left))
        self._left -= len(data)
        return data


def _type(schema: Any) -> str:
    """Return the type of a channel's messages, as ROS 2 spells it."""
    kind: str = schema.name if schema is not None else "unknown"
    return kind if "/msg/" in kind else kind.replace("/", "/msg/")


class _Bag:
    """Reads the Imu topics of one bag."""

    def __init__(self, path: Path, container: _Container, kind: str, size: int, beside: Path | None) -> None:
        self._path, self._container, self._kind = path, container, kind
        self._size, self._beside = size, beside

    def log(self) -> Log:
        """Return the bag's sensors, those of both kinds first."""
        topics = self._topics()
        self._thermometer = self._temperatures()
        force = [t for t in topics if t.has_force and not t.has_rate]
        rates = [t for t in topics if t.has_rate and not t.has_force]
        sensors = [self._sensor([t]) for t in topics if t.has_force and t.has_rate]
        for topic in force:
            partner = max(rates, key=lambda rate: _shared(rate.name, topic.name), default=None)
            sensors.append(self._sensor([topic, partner] if partner is not None else [topic]))
        if not sensors:
            what = f"the Imu topics {', '.join(t.name for t in topics) or 'of it'} hold no acceleration"
            raise TraceError(self._path, what, "record the topic of the accelerometer")
        cut = f"{short_name(self._path)}: its writer did not complete it; read up to where it breaks off"
        notes = [cut] if self._container.unfinished else []
        return Log(self._path, self._kind, sensors, notes, beside=self._beside)

    @contextmanager
    def _understood(self) -> Iterator[None]:
        """Turn what the libraries raise into a TraceError."""
        try:
            yield
        except (TraceError, GeneratorExit):
            raise
        except Exception as error:  # the libraries raise whatever their parsing meets
            said = " ".join(str(error).split())[:150] or type(error).__name__
            what = f"the {self._kind} is damaged or was not closed ({said})"
            remedy = "copy it again, or mend it: rosbag reindex, ros2 bag reindex, mcap recover"
            raise TraceError(self._path, what, remedy) from None

    def _topics(self) -> list[_Topic]:
        with self._understood():
            stored = self._container.topics()
            found = {s.topic: s.layout for s in stored if s.type == IMU and s.layout in ("ros1", "cdr")}
            if not found:
                there = sorted({f"{s.topic} ({s.type}, {s.layout})" for s in stored})
                listed = ", ".join(there[:8]) + (", ..." if len(there) > 8 else "")
                what = f"no topic of type sensor_msgs/Imu; there are: {listed or 'none'}"
                raise TraceError(self._path, what, "record the IMU's topic")
            counts: Counter[str] = Counter()
            for s in stored:
                counts[s.topic] += s.count
            probed = [self._probed(name, found[name], counts[name]) for name in sorted(found)]
            topics = [topic for topic in probed if topic is not None]
            return sorted(topics, key=lambda t: (t.rate_hz < USABLE_HZ, not t.name.endswith(_RAW)))

    def _probed(self, name: str, layout: str, count: int) -> _Topic | None:
        """Return a topic by its first messages, None without any. Raises TraceError on another layout."""
        rows = list(islice(self._container.messages(name), _PROBED))
        if not rows:
            return None
        self._refuse_other_layout(name, layout, rows[0][1])
        values, doubles = _decoded(rows), _doubles(rows)
        force = bool(values[:, 5:8].any()) and not (doubles[:, _FORCE + 3] == -1).all()
        rate = bool(values[:, 2:5].any()) and not (doubles[:, _RATE + 3] == -1).all()
        span = (values[-1, 1] - values[0, 1]) * _NS
        rate_hz = (len(rows) - 1) / span if span > 0 else 0.0
        with np.errstate(over="ignore", invalid="ignore"):  # a damaged file holds numbers of any size
            norm = float(np.median(np.linalg.norm(values[:, 5:8], axis=1)))
        in_g = force and abs(norm - 1) < _NEAR_ONE
        return _Topic(name, count, rate_hz, force, rate, bool(values[-1, 0] > 0), in_g)

    def _refuse_other_layout(self, topic: str, layout: str, raw: bytes) -> None:
        """Check that a message has the length that its layout gives it, with its frame's name."""
        length = int.from_bytes(raw[12:16], "little")  # of the frame's name; CDR aligns doubles after it
        ends = 16 + length + 8 * _DOUBLES
        aligned = 4 + -(-(12 + length) // 8) * 8 + 8 * _DOUBLES
        if len(raw) != (ends if layout == "ros1" else aligned) or (layout == "cdr" and raw[1] != 1):
            if raw.startswith(_ZSTD):
                what = f"the messages of {topic} are compressed one by one"
                raise TraceError(self._path, what, "give the bag's folder, whose metadata.yaml says so")
            what = f"the messages of {topic} are not laid out as little-endian sensor_msgs/Imu"
            raise TraceError(self._path, what, "export them as CSV")

    def _temperatures(self) -> tuple[Array, Array]:
        """Return the times, ns, and the values, degC, of the only topic of temperatures; else nothing."""
        with self._understood():
            topics = [s.topic for s in self._container.topics() if s.type == TEMPERATURE]
            if len(set(topics)) != 1:
                return np.empty(0), np.empty(0)
            rows = list(islice(self._container.messages(topics[0]), _MOST_TEMPERATURES))
            values = np.frombuffer(b"".join(raw[-16:] for _, raw in rows), "<f8").reshape(-1, 2)[:, 0]
            return _stamps(rows), values

    def _temperature_at(self, stamps: Array) -> Array:
        """Return the latest temperature at each of the stamps, ns; NaN before the first."""
        t, celsius = self._thermometer
        last = np.searchsorted(t, stamps, side="right") - 1
        if not t.size:
            return np.full(len(stamps), np.nan)
        return np.where(last >= 0, celsius[np.maximum(last, 0)], np.nan)

    def _sensor(self, topics: Sequence[_Topic]) -> LoggedSensor:
        warm = self._thermometer[0].size > 0
        parts = [
            Part(self._table(topic), _map(topic, warm=warm), sensors)
            for topic, sensors in zip(topics, _shares(topics), strict=True)
        ]
        with self._understood():
            unit, shown = rate_unit_shown(parts, _SHOWN) if any(t.has_rate for t in topics) else (None, "")
        if unit not in (None, "rad/s"):
            parts = [replace(part, column_map=_with_rates_in(part.column_map, unit)) for part in parts]
        about = f"{topics[0].rate_hz:.3g} Hz" + (f", with {topics[1].name}" if len(topics) > 1 else "")
        notes = [
            f"{short_name(self._path)}: {t.name} has no stamps of its own; the times of logging are used"
            for t in topics
            if not t.stamped
        ]
        if topics[0].in_g:
            notes.append(
                f"{short_name(self._path)}: {topics[0].name} is in g, by the size of gravity, not in m/s^2"
            )
        if unit not in (None, "rad/s"):
            said = f"rates of {topics[-1].name} are read in {unit} ({shown}), not in rad/s"
            notes.append(f"{short_name(self._path)}: {said}; mend the driver that published them")
        return LoggedSensor.of(topics[0].name, parts, about, notes)

    def _table(self, topic: _Topic) -> NumberTable:
        def rows(places: Sequence[int]) -> Iterator[tuple[Array, float]]:
            done = 0
            with self._understood():
                messages = self._container.messages(topic.name)
                while block := list(islice(messages, _BLOCK)):
                    done += len(block)
                    values = np.column_stack([_decoded(block), np.zeros(len(block))])
                    values[:, 8] = self._temperature_at(values[:, 0 if topic.stamped else 1])
                    yield values[:, list(places)], min(1.0, done / max(topic.count, 1))

        return NumberTable(self._path, _NAMES, rows, self._size)


def _shared(first: str, second: str) -> int:
    """Return with how many letters in common two names begin."""
    return next((i for i, (a, b) in enumerate(zip(first, second, strict=False)) if a != b), len(first))


def _doubles(rows: Sequence[Message]) -> Array:
    joined = b"".join(raw[-8 * _DOUBLES :] for _, raw in rows)
    return np.frombuffer(joined, "<f8").reshape(-1, _DOUBLES)


def _decoded(rows: Sequence[Message]) -> Array:
    """Return messages as (n, 8): own stamp and time of logging, ns, rate rad/s, acceleration m/s^2.

    Both encodings begin with four bytes, then the stamp's seconds and nanoseconds, and end with the doubles.
    """
    doubles = _doubles(rows)
    values = np.empty((len(rows), 8))
    values[:, 0] = _stamps(rows)
    values[:, 1] = [logged for logged, _ in rows]
    values[:, 2:5] = doubles[:, _RATE : _RATE + 3]
    values[:, 5:8] = doubles[:, _FORCE : _FORCE + 3]
    return values


def _stamps(rows: Sequence[Message]) -> Array:
    """Return the messages' own stamps, (n,) ns."""
    heads = np.frombuffer(b"".join(raw[4:12] for _, raw in rows), "<u4").reshape(-1, 2).astype(np.float64)
    return np.asarray(heads[:, 0] * 1e9 + heads[:, 1])


def _shares(topics: Sequence[_Topic]) -> list[tuple[Sensor, ...]]:
    if len(topics) > 1:
        return [(Sensor.ACCELEROMETER,), (Sensor.GYROSCOPE,)]
    return [BOTH if topics[0].has_rate else (Sensor.ACCELEROMETER,)]


def _with_rates_in(column_map: ColumnMap, unit: Any) -> ColumnMap:
    gyroscope = SensorMap(columns=("gx", "gy", "gz"), unit=unit)
    return msgspec.structs.replace(column_map, gyroscope=gyroscope)


def _map(topic: _Topic, *, warm: bool) -> ColumnMap:
    """Return the map of a topic; messages may have been logged a little out of the order of their stamps."""
    time = (
        TimeMap(column="stamp", unit="ns", arrival="logged", arrival_unit="ns")
        if topic.stamped
        else TimeMap(column="logged", unit="ns")
    )
    return ColumnMap(
        time=time,
        accelerometer=SensorMap(columns=("ax", "ay", "az"), unit="g" if topic.in_g else "m/s^2"),
        gyroscope=SensorMap(columns=("gx", "gy", "gz"), unit="rad/s"),
        temperature=TemperatureMap(column="temperature") if warm else None,
        reorder=64,
        repeats="keep",
    )
