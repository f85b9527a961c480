"""ArduPilot DataFlash logs (.bin), which describe themselves: FMT messages say how others are laid out.

Layout by ArduPilot's libraries/AP_Logger (LogStructure.h and README.md): each message is 0xA3 0x95, its type,
then fields as the type's FMT lists them in one letter each. Damaged stretches are skipped and counted.
"""

from __future__ import annotations

import mmap
import struct
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.limits import READING
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.columns import ColumnMap, SensorMap, TemperatureMap, TimeMap
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.log import BOTH, Log, LoggedSensor, Part
from stillcal.replay.formats.sources import Source, unpacked_copy
from stillcal.replay.formats.tables.numbers import BLOCK_ROWS, NumberTable, as_floats, side_by_side

_HEAD = b"\xa3\x95"
_FMT = 128
_FMT_LAYOUT = struct.Struct("<BB4s16s64s")

_LETTERS = {
    **{"a": "64u1", "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "f": "<f4"},
    **{"d": "<f8", "n": "S4", "N": "S16", "Z": "S64", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4"},
    **{"L": "<i4", "M": "u1", "q": "<i8", "Q": "<u8", "g": "<f2"},
}
"""numpy types of the letters in a FMT message (LogStructure.h); c, C, e, E are hundredths."""

_BOTH_IN_ONE = {"IMU", "IMU2", "IMU3"}
_ACCELEROMETERS = {"ACC", "ACC1", "ACC2", "ACC3"}
_PARAMETERS, _TIMES = "PARM", ("TimeUS", "SampleUS")
_MOST_DAMAGE, _ENOUGH_DAMAGE = 0.5, 1 << 24
"""Share of a log that may be damaged, and bytes from which on the rest is not read: it is no such log."""


@dataclass(slots=True)
class _Type:
    """What a FMT message says of a message type: its name, length with header, and fields."""

    name: str
    length: int
    layout: np.dtype[Any]
    fields: list[str]


@dataclass(slots=True)
class _Scan:
    """What one reading of a log found: where messages of the wanted names stand, and parameters."""

    types: dict[int, _Type] = field(default_factory=dict)
    places: dict[int, array[int]] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    damaged: int = 0


def open_dataflash(source: Source) -> Log:
    """Open a DataFlash log. Raises TraceError where it is damaged, or no IMU was logged."""
    stored = unpacked_copy(source)
    assert stored.local is not None
    with stored.local.open("rb") as file:
        content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    scan = _scanned(content)
    if scan.damaged > _MOST_DAMAGE * len(content):
        what = "the log is damaged: more than half of what was read are no messages"
        raise TraceError(source.path, what, "download it from the vehicle again")
    reader = _Reader(source.path, content, scan)
    sensors = list(reader.sensors())
    if not sensors:
        there = ", ".join(sorted(t.name for t in scan.types.values() if t.name)[:20])
        what = f"no IMU messages were logged; the log knows {there or 'nothing'}"
        raise TraceError(source.path, what, "set LOG_BITMASK so that IMU is logged")
    notes = [f"{short_name(source.path)}: {line}" for line in corrections(scan.parameters)]
    if scan.damaged:
        notes.append(f"{short_name(source.path)}: {scan.damaged} bytes are damaged and were skipped")
    return Log(source.path, "ArduPilot DataFlash", sensors, notes, source.local)


def corrections(parameters: Mapping[str, Any]) -> Iterator[str]:
    """Say what ArduPilot has corrected already, by its parameters INS_*."""
    said = []
    for name, label in (("ACC", "accelerometer"), ("GYR", "gyroscope")):
        offsets = [parameters.get(f"INS_{name}OFFS_{axis}", 0.0) for axis in "XYZ"]
        if any(offsets):
            said.append(f"{label} (INS_{name}OFFS {' '.join(f'{float(o):.4g}' for o in offsets)})")
    hot = [n for n in (1, 2, 3) if parameters.get(f"INS_TCAL{n}_ENABLE", 0)]
    if hot:
        said.append(f"temperature (INS_TCAL of sensors {' '.join(map(str, hot))})")
    if said:
        yield f"ArduPilot has corrected these values already: {', '.join(said)}"


def _scanned(content: mmap.mmap) -> _Scan:
    """Walk through all messages once."""
    scan = _Scan()
    scan.types[_FMT] = _Type("FMT", 3 + _FMT_LAYOUT.size, np.dtype("V86"), [])
    lengths = [0] * 256
    lengths[_FMT] = scan.types[_FMT].length
    wanted: set[int] = set()
    at, end, parameter = 0, len(content), -1
    while at + 3 <= end:
        kind = content[at + 2]
        length = lengths[kind] if content[at : at + 2] == _HEAD else 0
        if not length or at + length > end:
            following = content.find(_HEAD, at + 1, at + _ENOUGH_DAMAGE)
            following = (
                min(at + _ENOUGH_DAMAGE, end) if following < 0 and at + _ENOUGH_DAMAGE < end else following
            )
            if following < 0 or (length and at + length > end):
                scan.damaged += end - at
                break
            scan.damaged += following - at
            at = following
            if scan.damaged > max(_ENOUGH_DAMAGE, at * _MOST_DAMAGE):
                scan.damaged = end
                break
            continue
        if kind == _FMT:
            made = _learn(scan, content, at)
            if made is not None:
                lengths[made] = scan.types[made].length
                name = scan.types[made].name
                parameter = made if name == _PARAMETERS else parameter
                if name in _BOTH_IN_ONE | _ACCELEROMETERS | _gyroscopes():
                    wanted.add(made)
                    scan.places.setdefault(made, array("Q"))
        elif kind in wanted:
            scan.places[kind].append(at)
        elif kind == parameter:
            row = np.frombuffer(content, scan.types[kind].layout, 1, at + 3)[0]
            _take_parameter(scan, row)
        at += length
    return scan


def _gyroscopes() -> set[str]:
    return {name.replace("ACC", "GYR") for name in _ACCELEROMETERS}


def _learn(scan: _Scan, content: mmap.mmap, at: int) -> int | None:
    """Take in a FMT message and return the type that it describes, None where it makes no sense."""
    kind, length, name, letters, columns = _FMT_LAYOUT.unpack_from(content, at + 3)
    texts = [part.split(b"\0")[0].decode("ascii", "replace") for part in (name, letters, columns)]
    fields = texts[2].split(",") if texts[2] else []
    named = len(set(fields)) == len(fields) == len(texts[1]) and all(fields)
    if not named or kind == _FMT:
        return None
    try:
        layout = np.dtype([(n, _LETTERS[c]) for n, c in zip(fields, texts[1], strict=True)])
    except KeyError:
        return None
    if layout.itemsize + 3 != length:
        return None
    scan.types[kind] = _Type(texts[0], length, layout, fields)
    return int(kind)


def _take_parameter(scan: _Scan, row: np.void) -> None:
    names = row.dtype.names or ()
    if "Name" in names and "Value" in names:
        scan.parameters[row["Name"].decode("ascii", "replace")] = float(row["Value"])


class _Reader:
    """Makes sensors of the messages of one log."""

    def __init__(self, path: Path, content: mmap.mmap, scan: _Scan) -> None:
        self._path, self._content, self._scan = path, content, scan

    def sensors(self) -> Iterator[LoggedSensor]:
        """Yield the inertial sensors: IMU messages by instance, then those logged at the sensor's rate."""
        for kind, instance, places in self._instances(_BOTH_IN_ONE):
            name = self._scan.types[kind].name
            part = Part(self._table(kind, places), _map_of_both(), BOTH)
            yield LoggedSensor.of(f"{name}{instance}", [part], f"{self._rate(kind, places):.3g} Hz")
        gyroscopes = {
            (self._scan.types[kind].name, instance): (kind, places)
            for kind, instance, places in self._instances(_gyroscopes())
        }
        for kind, instance, places in self._instances(_ACCELEROMETERS):
            name = self._scan.types[kind].name
            parts = [Part(self._table(kind, places), _map_of("Acc"), [Sensor.ACCELEROMETER])]
            other = gyroscopes.get((name.replace("ACC", "GYR"), instance))
            if other is not None:
                parts.append(Part(self._table(*other), _map_of("Gyr"), [Sensor.GYROSCOPE]))
            yield LoggedSensor.of(f"{name}{instance}", parts, f"{self._rate(kind, places):.3g} Hz")

    def _instances(self, names: set[str]) -> Iterator[tuple[int, str, NDArray[np.uint64]]]:
        """Yield (type, instance, places) of messages; instance "" where the type has no field I."""
        for kind, places in self._scan.places.items():
            found = self._scan.types[kind]
            if found.name not in names or len(places) < 2 or "TimeUS" not in found.fields:
                continue
            at = np.frombuffer(places, dtype=np.uint64)
            if "I" not in found.fields:
                yield kind, "", at
                continue
            instances = self._field(kind, at, "I").astype(np.int64)
            for instance in np.unique(instances):
                yield kind, str(instance), at[instances == instance]

    def _rate(self, kind: int, places: NDArray[np.uint64]) -> float:
        first, last = self._field(kind, places[[0, -1]], "TimeUS")
        return float((len(places) - 1) / max((last - first) * 1e-6, 1e-9))

    def _field(self, kind: int, places: NDArray[np.uint64], name: str) -> Array:
        """Return one field of the messages at `places`, (n,)."""
        found = self._scan.types[kind]
        offset = 3 + int(found.layout.fields[name][1])  # type: ignore[index]
        one = np.dtype(found.layout[name])
        bytes_ = np.frombuffer(self._content, dtype=np.uint8)
        cells = bytes_[places[:, None].astype(np.int64) + offset + np.arange(one.itemsize)]
        return as_floats(np.ascontiguousarray(cells).view(one).ravel())

    def _table(self, kind: int, places: NDArray[np.uint64]) -> NumberTable:
        names = [n for n in self._scan.types[kind].fields if self._scan.types[kind].layout[n].kind in "iuf"]

        def rows(wanted: Sequence[int]) -> Iterator[tuple[Array, float]]:
            for first in range(0, len(places), BLOCK_ROWS):
                part = places[first : first + BLOCK_ROWS]
                columns = []
                for place in wanted:
                    column = self._field(kind, part, names[place])
                    # Messages have no check sum: a reading that no sensor gives is damage.
                    wild = ~(np.abs(column) <= READING) & (names[place] not in _TIMES)
                    columns.append(np.where(wild, np.nan, column))
                yield side_by_side(columns), min(1.0, (first + BLOCK_ROWS) / len(places))

        return NumberTable(self._path, names, rows, len(self._content))


def _map_of_both() -> ColumnMap:
    return ColumnMap(
        time=TimeMap(column="TimeUS", unit="us"),
        accelerometer=SensorMap(columns=("AccX", "AccY", "AccZ"), unit="m/s^2"),
        gyroscope=SensorMap(columns=("GyrX", "GyrY", "GyrZ"), unit="rad/s"),
        temperature=TemperatureMap(column="T"),
        repeats="keep",
    )


def _map_of(start: str) -> ColumnMap:
    """Return the map of ACC or GYR messages, which hold the sensor's own time in SampleUS."""
    columns = (f"{start}X", f"{start}Y", f"{start}Z")
    return ColumnMap(
        time=TimeMap(column="SampleUS", unit="us"),
        accelerometer=SensorMap(columns=columns, unit="m/s^2"),
        gyroscope=SensorMap(columns=columns, unit="rad/s"),
        repeats="keep",
    )
