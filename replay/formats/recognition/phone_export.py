"""Folders and zip archives as phone apps export them: phyphox and Sensor Logger, a file for each sensor.

Sensor Logger writes calibrated and uncalibrated values of one sensor side by side. The uncalibrated ones are
read; the difference of the two is the bias that the phone's own system takes off, and a note says it.
"""

from __future__ import annotations

import csv
import struct
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import BinaryIO

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.columns import ColumnMap, load_map
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.log import Log, LoggedSensor, Part
from stillcal.replay.formats.recognition.text_formats import TextFormat, text_format
from stillcal.replay.formats.sources import Source, cannot_open, damaged, source_of
from stillcal.replay.formats.tables.text import TextTable, has_rows

MOST_MEMBERS, MOST_INDEX_BYTES = 20_000, 16 << 20
"""Files of an archive, and bytes of its index, that are looked at: an archive of millions is no recording."""

_DEVICE_BYTES = 1 << 16
_BIAS_SAMPLES = 20_000
_UNCALIBRATED = ("AccelerometerUncalibrated", "GyroscopeUncalibrated")
_CALIBRATED = ("TotalAcceleration", "Gyroscope")
_PHYPHOX = ("Accelerometer.csv", "Raw Data.csv")
_PHYPHOX_FORMATS = ("phyphox", "phyphox_ios")
_PHYPHOX_WITHOUT_GRAVITY = ("Linear Acceleration.csv", "Linear Accelerometer.csv")
"""Of an experiment that the user put together, on Android and on iOS."""

EXPORTED_FILES = (*_PHYPHOX, f"{_UNCALIBRATED[0]}.csv", f"{_CALIBRATED[0]}.csv")
"""Files by which a folder is seen to be one export."""


def members_of_folder(folder: Path) -> dict[str, Source]:
    """Return the files of a folder, and of the folders in it, by their path in it. Raises TraceError."""
    found: dict[str, Source] = {}
    try:
        for path in sorted(folder.rglob("*")):
            inside = path.relative_to(folder)
            if path.is_file() and not any(part.startswith((".", "__MACOSX")) for part in inside.parts):
                found[inside.as_posix()] = source_of(path)
            if len(found) > MOST_MEMBERS:
                raise TraceError(folder, f"holds more than {MOST_MEMBERS} files", "name one of them")
    except OSError as error:
        raise cannot_open(folder, error) from None
    return found


def members_of_zip(archive: Source) -> dict[str, Source]:
    """Return the files of a zip archive by their path in it; nothing is unpacked yet. Raises TraceError."""
    try:
        with archive.open() as file:
            _refuse_long_index(archive, file)
        opened = zipfile.ZipFile(archive.open())
    except zipfile.BadZipFile as error:
        raise damaged(archive.path, error) from None
    except OSError as error:
        raise cannot_open(archive.path, error) from None
    except (NotImplementedError, ValueError, struct.error) as error:  # a version of zip that is not known
        raise TraceError(
            archive.path, f"cannot be unpacked ({error})", "unpack it and give the folder"
        ) from None
    found = {}
    for info in opened.infolist():
        parts = PurePosixPath(info.filename).parts
        hidden = any(part.startswith((".", "__MACOSX")) for part in parts)
        if info.filename and not info.is_dir() and not hidden:
            found[info.filename] = _member(archive, opened, info)
    return found


def _member(archive: Source, opened: zipfile.ZipFile, info: zipfile.ZipInfo) -> Source:
    def opener() -> BinaryIO:
        return opened.open(info)  # type: ignore[return-value]

    return Source(archive.path / info.filename, info.file_size, opener, None, opened)


def _refuse_long_index(archive: Source, file: BinaryIO) -> None:
    """Raise TraceError where the archive's index would fill the memory (APPNOTE.TXT 4.3.16)."""
    tail = max(0, archive.size - 65_557)
    file.seek(tail)
    end = file.read(65_557)
    at = end.rfind(b"PK\x05\x06")
    if at < 0 or len(end) < at + 22:
        raise zipfile.BadZipFile("no end of its index")
    count, size = struct.unpack("<HI", end[at + 10 : at + 16])
    if count > MOST_MEMBERS or size > MOST_INDEX_BYTES:
        raise TraceError(archive.path, f"an archive of {count} files or more", "unpack it and name a file")


def phone_export(path: Path, members: Mapping[str, Source]) -> Log | None:
    """Return what phyphox or Sensor Logger exported, None where it is neither. Raises TraceError."""
    _refuse_several(path, members)
    tables = {PurePosixPath(name).name: source for name, source in members.items() if _is_table(name)}
    sensor_logger = _sensor_logger(path, tables)
    if sensor_logger is not None:
        return sensor_logger
    for name in _PHYPHOX:
        if name in tables:
            form = text_format(tables[name])
            if form.name in _PHYPHOX_FORMATS:
                return _phyphox(path, tables, name, form.column_map)
            _refuse_without_gravity(tables[name])
    for name in _PHYPHOX_WITHOUT_GRAVITY:
        if name in tables and not set(tables) & set(_PHYPHOX):
            raise _without_gravity(tables[name], name.removesuffix(".csv"))
    return None


def _refuse_several(path: Path, members: Mapping[str, Source]) -> None:
    """Raise TraceError where files of one sensor lie in several folders: each is an export of its own."""
    for sensor_file in (*(f"{stem}.csv" for stem in (*_UNCALIBRATED, *_CALIBRATED)), *_PHYPHOX):
        folders = [str(p.parent) for p in map(PurePosixPath, members) if p.name == sensor_file]
        if len(folders) > 1:
            listed = ", ".join(folders[:8]) + (", ..." if len(folders) > 8 else "")
            remedy = "give one of them" if path.is_dir() else "unpack it and give one of them"
            raise TraceError(path, f"holds {len(folders)} exports, in {listed}", remedy)


def _is_table(name: str) -> bool:
    return name.endswith((".csv", ".csv.gz"))


def _refuse_without_gravity(source: Source) -> None:
    first = source.head(4096).split(b"\n")[0].decode("utf-8", "replace")
    if "Linear Acceleration x" in first:
        raise _without_gravity(source, "Linear Acceleration")


def _without_gravity(source: Source, called: str) -> TraceError:
    what = f"phyphox took gravity out of these values ({called})"
    return TraceError(source.path, what, 'record with "Acceleration (with g)"')


def _phyphox(path: Path, tables: dict[str, Source], name: str, column_map: ColumnMap) -> Log:
    alone = msgspec.structs.replace(column_map, repeats="keep")
    parts = [Part(TextTable(tables[name], alone), alone, [Sensor.ACCELEROMETER])]
    notes = [f"{short_name(path)}: {line}" for line in _without_samples(tables)]
    if "Gyroscope.csv" in tables:
        parts.append(Part(TextTable(tables["Gyroscope.csv"], alone), alone, [Sensor.GYROSCOPE]))
    elif column_map.gyroscope is not None:
        table = TextTable(tables[name], alone)
        if set(column_map.gyroscope.columns) <= set(table.names or []):
            parts = [Part(table, alone)]
    claims = _phyphox_claims(tables.get("device.csv"))
    about = "accelerometer, gyroscope" if len(parts) > 1 else "accelerometer"
    sensors = [LoggedSensor.of("phone", parts, about)]
    return Log(path, "phyphox", sensors, notes, beside=path, claims=claims)


def _without_samples(tables: dict[str, Source]) -> list[str]:
    """Take the gyroscope's files that hold a header only out of the tables, and say so, a line each."""
    empty = [f"{stem}.csv" for stem in (_UNCALIBRATED[1], _CALIBRATED[1])]
    empty = [name for name in empty if name in tables and not has_rows(tables[name])]
    for name in empty:
        del tables[name]
    return [f"{name} holds a header and no samples" for name in empty]


def _phyphox_claims(device: Source | None) -> Claims:
    """Return what meta/device.csv says of the sensors: range and resolution, as Android gives them."""
    if device is None:
        return Claims()
    text = device.head(_DEVICE_BYTES).decode("utf-8", "replace")
    mark = next((m for m in (";", "\t") if m in text.split("\n", 1)[0]), ",")
    rows = {row[0]: row[1] for row in csv.reader(text.splitlines(), delimiter=mark) if len(row) >= 2}
    claims = {"device": rows.get("deviceModel")}
    for ours, theirs in (("accel", "accelerometer"), ("gyro", "gyroscope")):
        for field, name in (("range", "Range"), ("lsb", "Resolution")):
            with suppress(ValueError, KeyError):
                value = float(rows[f"{theirs} {name}"])
                if 0 < value < 1e4:
                    claims[f"{ours}_{field}"] = value  # type: ignore[assignment]
    return msgspec.convert({k: v for k, v in claims.items() if v is not None}, Claims)


def _sensor_logger(path: Path, tables: dict[str, Source]) -> Log | None:
    forms: dict[str, TextFormat] = {}
    empty = (
        [f"{short_name(path)}: {line}" for line in _without_samples(tables)]
        if _is_sensor_logger(tables)
        else []
    )
    for stem in (*_UNCALIBRATED, *_CALIBRATED, "Accelerometer"):
        if f"{stem}.csv" in tables:
            form = text_format(tables[f"{stem}.csv"])
            if not form.name.startswith("sensorlogger"):
                return None
            forms[stem] = form
    sensors = []
    for name, pair in (("uncalibrated", _UNCALIBRATED), ("calibrated", _CALIBRATED)):
        if pair[0] in forms:
            rates = [stem for stem in (pair[1], *_other(pair[1])) if stem in forms][:1]
            sensors.append(_logged(name, tables, forms, pair[0], rates))
    if not sensors:
        if "Accelerometer" in forms:
            refused = tables["Accelerometer.csv"]
            why, remedy = load_map("sensorlogger").accelerometer.refuse["Accelerometer"]
            raise TraceError(refused.path, why, remedy)
        return None
    notes = empty + [
        note
        for pair in zip(_UNCALIBRATED, _CALIBRATED, strict=True)
        for note in _system_bias(path, tables, forms, *pair)
    ]
    return Log(path, "Sensor Logger", sensors, notes, beside=path)


def _is_sensor_logger(tables: dict[str, Source]) -> bool:
    return any(f"{stem}.csv" in tables for stem in (_UNCALIBRATED[0], _CALIBRATED[0]))


def _other(stem: str) -> tuple[str, ...]:
    return tuple(s for s in (_UNCALIBRATED[1], _CALIBRATED[1]) if s != stem)


def _logged(
    name: str, tables: dict[str, Source], forms: dict[str, TextFormat], accelerometer: str, rates: list[str]
) -> LoggedSensor:
    parts = [_part(tables, forms, accelerometer, Sensor.ACCELEROMETER)]
    parts += [_part(tables, forms, stem, Sensor.GYROSCOPE) for stem in rates]
    return LoggedSensor.of(name, parts, ", ".join([accelerometer, *rates]))


def _part(tables: dict[str, Source], forms: dict[str, TextFormat], stem: str, sensor: Sensor) -> Part:
    standard = stem != "AccelerometerUncalibrated"
    column_map = load_map("sensorlogger" if standard else forms[stem].name)
    column_map = msgspec.structs.replace(column_map, repeats="keep")
    return Part(TextTable(tables[f"{stem}.csv"], column_map), column_map, [sensor])


def _system_bias(
    path: Path, tables: dict[str, Source], forms: dict[str, TextFormat], raw: str, corrected: str
) -> Iterator[str]:
    """Say the bias that the phone's system takes off: the median of raw minus corrected at the same times."""
    if raw not in forms or corrected not in forms:
        return
    sensor = Sensor.GYROSCOPE if corrected == "Gyroscope" else Sensor.ACCELEROMETER
    (t, xyz), (t2, xyz2) = (_first_samples(_part(tables, forms, stem, sensor)) for stem in (raw, corrected))
    shared = (t >= t2[0]) & (t <= t2[-1]) if t2.size > 1 else np.zeros(t.size, dtype=bool)
    if np.count_nonzero(shared) < 10:
        return
    other = np.column_stack([np.interp(t[shared], t2, xyz2[:, i]) for i in range(3)])
    bias = np.median(xyz[shared] - other, axis=0)
    unit = "rad/s" if sensor is Sensor.GYROSCOPE else "m/s^2"
    values = " ".join(f"{b:.5g}" for b in bias)
    whence = f"{raw} minus {corrected}; raw values are read"
    yield f"{short_name(path)}: the phone's own {sensor} bias is {values} {unit} ({whence})"


def _first_samples(part: Part) -> tuple[Array, Array]:
    log = LoggedSensor.of("", [part]).files(Claims())
    run = next(iter(log[0].runs()), {})
    samples = next(iter(run.values()), None)
    if samples is None:
        return np.empty(0), np.empty((0, 3))
    return samples.t[:_BIAS_SAMPLES], samples.xyz[:_BIAS_SAMPLES]
