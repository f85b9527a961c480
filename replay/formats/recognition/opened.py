"""Opens a recording of any known format: recognises it by its content and finds the sensors in it."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeAlias

from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import input_name, is_read_once, short_name
from stillcal.replay.formats.claims import Claims, written_by_stillcal
from stillcal.replay.formats.columns import ColumnMap, load_map
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.logs.arrays import mapped, open_arrays
from stillcal.replay.formats.logs.axivity import open_axivity
from stillcal.replay.formats.logs.betaflight import open_betaflight
from stillcal.replay.formats.logs.dataflash import open_dataflash
from stillcal.replay.formats.logs.gnss_logger import open_gnss_logger
from stillcal.replay.formats.logs.json_log import json_tables
from stillcal.replay.formats.logs.ros import FOLDER_INDEX, open_ros, open_ros_folder
from stillcal.replay.formats.logs.sample_folder import sample_folder, sample_members
from stillcal.replay.formats.logs.ulog import open_ulog
from stillcal.replay.formats.recognition import magic
from stillcal.replay.formats.recognition.log import GyroscopeAloneError, Log, LoggedSensor
from stillcal.replay.formats.recognition.names.axes import find_axes
from stillcal.replay.formats.recognition.names.containers import called_otherwise, named_after, qualified
from stillcal.replay.formats.recognition.names.kinds import is_own, rates_alone, without_gravity
from stillcal.replay.formats.recognition.names.vocabulary import OWN
from stillcal.replay.formats.recognition.pairs import rates_file
from stillcal.replay.formats.recognition.phone_export import members_of_folder, members_of_zip, phone_export
from stillcal.replay.formats.recognition.row_sensors import refuse_devices_in_turn, sensors_of_rows
from stillcal.replay.formats.recognition.settle import OneSensor, settled, settled_apart
from stillcal.replay.formats.recognition.settling.units import measures_gravity
from stillcal.replay.formats.recognition.text_formats import (
    BETAFLIGHT,
    GNSS_LOGGER,
    REST,
    SENSOR_LOGGER,
    UNKNOWN,
    TextFormat,
    text_format,
)
from stillcal.replay.formats.shipped import located
from stillcal.replay.formats.sources import Source, source_of
from stillcal.replay.formats.stream import SampleFile
from stillcal.replay.formats.tables.echoed import Echoed
from stillcal.replay.formats.tables.json_table import JsonTable
from stillcal.replay.formats.tables.layout import missing
from stillcal.replay.formats.tables.plain import plain_text
from stillcal.replay.formats.tables.table import Table
from stillcal.replay.formats.tables.text import NoRowsError, TextTable, has_rows

AUTO = "auto"
"""The format of a recording whose content is to decide, as None is."""

Format: TypeAlias = str | Path | ColumnMap | None
"""A format's name or a column map's path, a column map, or None: recognised by content."""

Reader = Callable[[Source, ColumnMap | None, Source | None], Log]
"""Opens a recording by a given column map, or by what is in it; the last argument is the gyroscope's file."""


def kept(path: Path | str) -> Path | Source:
    """Return where a recording can be read more than once: a pipe's bytes, read to their end, else its path.

    Raises TraceError where there is no such sample, or the pipe gives nothing that is read.
    """
    return source_of(path, magic.kind_of) if is_read_once(path) else located(path)


def open_log(path: Path | str | Source, format: Format = None, gyro: Path | None = None) -> Log:
    """Recognise a recording; format: as `open_trace` takes it. Raises TraceError."""
    if str(format) == REST:
        where = path.path if isinstance(path, Source) else input_name(path)
        raise _without_samples(where)
    format = None if str(format) == AUTO else format
    found = path if isinstance(path, Source) else kept(path)
    column_map = format if format is None or isinstance(format, ColumnMap) else load_map(format)
    if isinstance(found, Path) and found.is_dir():
        _refuse_gyro(gyro, found, "a folder")
        if (found / FOLDER_INDEX).is_file():
            return open_ros_folder(found)
        log = sample_folder(found) if column_map is None else None
        return log or _archive(found, members_of_folder(found), column_map)
    source = found if isinstance(found, Source) else source_of(found)
    kind = magic.kind_of(source)
    if kind not in _TABLES:
        _refuse_gyro(gyro, source.path, kind)
    other = None if gyro is None else source_of(gyro)
    if other is not None and source.path.exists() and other.path.resolve() == source.path.resolve():
        raise TraceError(
            other.path, "is the recording itself", "leave --gyro out where it holds both sensors"
        )
    log = _log(source, column_map, other)
    return (
        replace(log, notes=[f"{short_name(source.path)}: {source.said}", *log.notes]) if source.said else log
    )


def _without_samples(path: Path | str) -> TraceError:
    """Return the error of a rest table that was given where samples are needed."""
    remedy = "give samples; only the commands stillcal diagnose and stillcal replay take rest tables"
    return TraceError(path, "a rest table holds no samples", remedy)


def _refuse_gyro(gyro: Path | None, path: Path, kind: str) -> None:
    """Raise TraceError where a gyroscope's own file is given for what holds all its sensors itself."""
    if gyro is not None:
        raise TraceError(
            path, f"is {kind}, which no gyroscope's file of its own goes with", "leave --gyro out"
        )


def is_rest_table(found: Path | Source, format: Format = None) -> bool:
    """Whether a file or a pipe's bytes are a rest table: so named, or recognised. Raises TraceError."""
    if format is not None and str(format) != AUTO:
        return str(format) == REST
    if isinstance(found, Path) and not found.is_file():
        return False
    source = found if isinstance(found, Source) else source_of(found)
    return magic.kind_of(source) == magic.TEXT and text_format(source).name == REST


def _log(source: Source, column_map: ColumnMap | None, gyro: Source | None) -> Log:
    return READERS[magic.kind_of(source)](source, column_map, gyro)


def _arrays(kind: str) -> Reader:
    """Return the reader of files of named arrays."""
    return lambda source, column_map, _: open_arrays(source, kind, column_map)


def _self_described(kind: str, opened: Callable[[Source], Log]) -> Reader:
    """Return the reader of logs that say themselves what is in them, and take no column map."""

    def read(source: Source, column_map: ColumnMap | None, _: Source | None) -> Log:
        if column_map is not None:
            what = f"is {kind}, which says itself what is in it"
            raise TraceError(source.path, what, "leave --format out")
        return opened(source)

    return read


def _one_array(source: Source, _column_map: ColumnMap | None, _gyro: Source | None) -> Log:
    """Refuse an array without a name. Raises TraceError."""
    what = f"is {magic.NPY}, which is not read"
    raise TraceError(source.path, what, "save the arrays as .npz, or export CSV")


def _zip_log(source: Source, column_map: ColumnMap | None, _: Source | None) -> Log:
    """Return what a zip archive holds, which may be NumPy's arrays. Raises TraceError."""
    members = members_of_zip(source)
    if members and all(name.endswith(".npy") for name in members):
        return open_arrays(source, magic.ZIP, column_map)
    return _archive(source.path, members, column_map)


def _archive(path: Path, members: dict[str, Source], column_map: ColumnMap | None) -> Log:
    """Return what a folder or a zip archive holds. Raises TraceError where it is no recording, or several."""
    if "[Content_Types].xml" in members:
        raise TraceError(path, "is an Office document (Excel?)", "export the recording as CSV")
    export = phone_export(path, members) or sample_members(path, members)
    if export is not None:
        return export
    found, alone, empty = _opened(members, column_map)
    if len(found) == 1:
        ((name, log),) = found.items()
        used = {name}
        if len(alone) == 1 and column_map is None and magic.kind_of(members[name]) in _TABLES:
            log = _log(members[name], None, next(iter(alone.values())))
            used |= alone.keys()
        others = [member for member in members if member not in used]
        name = " with ".join([name, *sorted(used - {name})])
        log = replace(log, notes=[*(f"{short_name(path)}: {line}" for line in empty), *log.notes])
        said = [f"{short_name(path)}: {name} is read; passed over: {_first_of(others)}"] if others else []
        return replace(log, notes=[*said, *log.notes])
    if not found and len(alone) == 1:
        raise GyroscopeAloneError(path / next(iter(alone)))
    names = _first_of(list(found or members))
    if not found:
        what = f"holds no recording that is known ({names or 'it is empty'})"
        raise TraceError(path, what, "give an export of phyphox or Sensor Logger, or name a file in it")
    remedy = "give one of them" if path.is_dir() else "unpack it and give one of them"
    raise TraceError(path, f"holds {len(found)} recordings: {names}", remedy)


def _opened(
    members: dict[str, Source], column_map: ColumnMap | None
) -> tuple[dict[str, Log], dict[str, Source], list[str]]:
    """Return the recordings among files, those of a gyroscope alone, and what is said of empty ones.

    Those of an accelerometer that only gravity tells are left out where others name theirs.
    """
    found: dict[str, Log] = {}
    alone: dict[str, Source] = {}
    empty: list[str] = []
    for name, source in members.items():
        try:
            found[name] = _log(source, column_map, None)
        except GyroscopeAloneError:
            alone[name] = source
        except NoRowsError:
            empty.append(f"{name} holds a header and no samples")
        except TraceError:
            continue
    named = {name: log for name, log in found.items() if not log.by_gravity}
    return named or found, alone, empty


def _first_of(names: list[str]) -> str:
    return ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")


def _text_log(source: Source, column_map: ColumnMap | None, gyro: Source | None) -> Log:
    """Return the log of a text table, by the given map or the one that its first lines ask for."""
    if column_map is not None:
        return _mapped(source, TextFormat("", column_map), gyro, [])
    form = text_format(source)
    source = form.source or source
    if form.name == GNSS_LOGGER:
        return open_gnss_logger(source)
    if form.name == BETAFLIGHT:
        return open_betaflight(source, form.column_map)
    if form.name == REST:
        raise _without_samples(source.path)
    sensors = []
    if form.name in (UNKNOWN, *SENSOR_LOGGER):
        sensors = sensors_of_rows(partial(_named_table, source, form), form.cut, form.rate_hz)
    if sensors:
        return Log(source.path, "text table", sensors, beside=source.local)
    if form.name in SENSOR_LOGGER and called_otherwise(_container(source), "accelerometer"):
        form = replace(form, name=UNKNOWN)  # the app's files of other quantities have the same columns
    if form.name == UNKNOWN:
        return _by_names(source, form, gyro)
    if form.name == "csv":
        refuse_devices_in_turn(TextTable(source, form.column_map))
    said = f" ({form.said})" if form.said else ""
    notes = [] if form.name == "csv" else [f"{short_name(source.path)}: read as {form.name}{said}"]
    return _mapped(source, form, gyro, notes)


def _by_names(source: Source, form: TextFormat, gyro: Source | None) -> Log:
    """Return the log of a text table of unknown make. Raises TraceError."""
    table = _text_table(source, form)
    log = _log_by_names(source, OneSensor(table, form.cut, form.rate_hz), "text table", gyro)
    if log is not None:
        return log
    if table.names is not None and not OWN & set(table.names):
        raise missing(table, [])
    return _mapped(source, form, gyro, [])


def _json_log(source: Source, column_map: ColumnMap | None, gyro: Source | None) -> Log:
    """Return the log of JSON records, or of the arrays in one JSON object. Raises TraceError."""
    if source.local is not None and written_by_stillcal(source.local):
        what = "is a calibration, a store or a diagnosis that stillcal wrote, not a recording"
        raise TraceError(source.path, what, "give the recording that it was made from")
    tables = json_tables(source)
    if not tables:
        return open_arrays(source, magic.JSON, column_map)
    return _records_log(source, magic.JSON, tables, column_map, gyro)


def _echo_log(source: Source, column_map: ColumnMap | None, gyro: Source | None) -> Log:
    """Return the log of messages that ROS printed. Raises TraceError."""
    return _records_log(source, magic.ECHO, _echo_tables(source), column_map, gyro)


def _echo_tables(source: Source) -> dict[str, Callable[[], JsonTable]]:
    """Return what opens the table of messages that ROS printed, as json_tables does."""
    source = plain_text(source)

    def opened() -> JsonTable:
        messages = Echoed(source)
        return JsonTable(source.path, messages.records, source.size, messages.notes)

    return {"": opened}


_RECORDS = {magic.JSON: json_tables, magic.ECHO: _echo_tables}
"""What opens the tables of records of each kind."""


def _records_log(
    source: Source,
    kind: str,
    tables: dict[str, Callable[[], JsonTable]],
    column_map: ColumnMap | None,
    gyro: Source | None,
) -> Log:
    """Return the log of tables of records, by the fields that hold them. Raises TraceError."""
    base = column_map or load_map("csv")
    own = [OneSensor(_qualified(opened(), _container(source, name)), base) for name, opened in tables.items()]
    if len(own) > 1 and column_map is None:
        return Log(source.path, kind, settled_apart(own), beside=source.local)
    table, opened = own[0].table, next(iter(tables.values()))
    if column_map is not None or is_own(table.names or []):
        if column_map is None:
            refuse_devices_in_turn(opened())
        return Log(source.path, kind, mapped(table, base), beside=source.local)
    rows = sensors_of_rows(opened, base)
    if rows:
        return Log(source.path, kind, rows, beside=source.local)
    log = _log_by_names(source, own[0], kind, gyro)
    if log is None:
        raise missing(table, [])
    return log


def _container(source: Source, field: str = "") -> str:
    """Return what holds a table: a field of the file, or the file, called without its endings."""
    return field.rpartition("/")[2] or source.path.name.split(".")[0]


def _log_by_names(source: Source, own: OneSensor, kind: str, gyro: Source | None) -> Log | None:
    """Return the log of a table by its columns' names; None where they name no accelerometer.

    Raises TraceError where it cannot be read, or holds a gyroscope alone.
    """
    rates, said = _rates_of(source, gyro)
    named = settled(own.table, own.column_map, own.rate_hz, rates)
    sensors = named or _by_gravity(source, own, rates)
    if sensors:
        return Log(source.path, kind, sensors, said, beside=source.local, by_gravity=not named)
    free = without_gravity(own.table.names or [])
    if free:
        what = f"holds no acceleration with gravity, only {', '.join(free[:3])}"
        remedy = "record the raw accelerometer; where gravity has columns of its own, add them to these"
        raise TraceError(source.path, what, remedy)
    if rates_alone(own.table.names or []):
        raise GyroscopeAloneError(source.path)
    bare = {"x", "y", "z"} <= {name.strip().lower() for name in own.table.names or []}
    if bare and called_otherwise(_container(source), "accelerometer"):
        what = "is called after another quantity than acceleration, and nothing else says what x, y, z are"
        raise TraceError(source.path, what, "give the accelerometer's file")
    return None


def _by_gravity(source: Source, own: OneSensor, rates: OneSensor | None) -> list[LoggedSensor]:
    """Return the accelerometer that gravity shows columns x, y, z to be, where nothing names them."""
    table = copy(own.table)
    table.names = named_after(own.table.names or [], "accelerometer", _container(source))
    if table.names is None or not measures_gravity(table, find_axes(table.names)[0]):
        return []
    name = short_name(source.path)
    said = f"{name}: x, y, z are an accelerometer's by the size of gravity; nothing names them"
    found = settled(table, own.column_map, own.rate_hz, rates)
    return [replace(sensor, notes=(said, *sensor.notes)) for sensor in found]


def _one_sensor(source: Source) -> OneSensor:
    """Return the table of a file with what its name tells of its columns. Raises TraceError."""
    kind = magic.kind_of(source)
    if kind in _RECORDS:
        tables = _RECORDS[kind](source)
        if len(tables) != 1:
            raise TraceError(
                source.path, "holds no one list of JSON records", "write one object for each sample"
            )
        ((name, opened),) = tables.items()
        return OneSensor(_qualified(opened(), _container(source, name)), load_map("csv"))
    form = text_format(source)
    return OneSensor(_text_table(form.source or source, form), form.cut, form.rate_hz)


def _text_table(source: Source, form: TextFormat) -> Table:
    """Return a text table of unknown make, with what its file's name tells of its columns."""
    return _qualified(_named_table(source, form), _container(source))


def _named_table(source: Source, form: TextFormat) -> TextTable:
    """Return a text table with the names of its columns that more than its header tells."""
    table = TextTable(source, form.column_map)
    if form.names is not None:
        table.names, table.width = form.names, len(form.names)
        table.first_row = next(row for row in table.opening if len(row) == table.width)
    return table


def _qualified(table: Table, container: str) -> Table:
    """Return the table with what the name of its container tells of its columns."""
    if table.names is not None:
        table.names = qualified(table.names, container)
    return table


def _rates_of(source: Source, gyro: Source | None) -> tuple[OneSensor | None, list[str]]:
    """Return the gyroscope's own table: the given one, or the one beside; and what is to be said of it.

    Raises TraceError where the given one is of another format.
    """
    beside = rates_file(source.path) if source.local == source.path else None
    given = gyro or (None if beside is None else source_of(beside))
    if given is None:
        return None, []
    try:
        rates = _one_sensor(given)
    except NoRowsError:
        if gyro is not None:
            raise
        return None, [f"{short_name(given.path)}: holds a header and no samples; read without a gyroscope"]
    if gyro is not None:
        rates.table.names = named_after(rates.table.names or [], "gyroscope", "") or rates.table.names
    return (rates if gyro is not None or rates_alone(rates.table.names or []) else None), []


def _mapped(source: Source, form: TextFormat, gyro: Source | None, notes: list[str]) -> Log:
    """Return the log of one text table, or two, read through a known map."""
    path, column_map = source.path, form.column_map
    both = [Sensor.ACCELEROMETER] + ([Sensor.GYROSCOPE] if column_map.gyroscope else [])
    rules = column_map.gyroscope.other_file if column_map.gyroscope else ()
    if gyro is not None and column_map.gyroscope is None:
        raise TraceError(gyro.path, "the format has no gyroscope", "say its columns in a column map")
    beside = other_file(path, rules) if source.local == path and gyro is None else None
    other = gyro or (None if beside is None else source_of(beside))
    if other is not None and gyro is None and not has_rows(other):
        notes = [*notes, f"{short_name(other.path)}: holds a header and no samples; read without a gyroscope"]
        other, rules = None, ()
    if gyro is None and other is None:
        _refuse_gyroscope_file(source, rules)
    if gyro is None and rules and other is None:
        notes = [*notes, f"{short_name(path)}: no gyroscope file beside it (name it with --gyro)"]

    def files(claims: Claims) -> list[SampleFile]:
        sensors = both if gyro is None and not rules else [Sensor.ACCELEROMETER]
        first = SampleFile(TextTable(source, column_map), column_map, sensors, claims)
        if other is None:
            return [first]
        second = TextTable(other, column_map)
        return [first, SampleFile(second, column_map, [Sensor.GYROSCOPE], claims, first.selected)]

    return Log(path, form.name or "text table", [LoggedSensor("imu", files)], notes, beside=source.local)


def _refuse_gyroscope_file(source: Source, rules: tuple[tuple[str, str], ...]) -> None:
    """Raise TraceError where the file is the gyroscope's one of a pair, and the other lies beside it."""
    back = tuple((replacement, part) for part, replacement in rules)
    first = other_file(source.path, back) if source.local == source.path else None
    if first is not None:
        raise TraceError(source.path, "is the gyroscope's file of a pair", f"give {first.name}")


def other_file(path: Path, rules: tuple[tuple[str, str], ...]) -> Path | None:
    """Return the file beside `path` whose name the first fitting rule gives, None where there is none."""
    for part, replacement in rules:
        candidate = path.with_name(path.name.replace(part, replacement))
        if part in path.name and candidate.is_file():
            return candidate
    return None


_TABLES: dict[str, Reader] = {magic.TEXT: _text_log, magic.JSON: _json_log, magic.ECHO: _echo_log}
"""The tables that a gyroscope's own file may go with."""

_LOGS: dict[str, Callable[[Source], Log]] = {
    magic.AXIVITY: open_axivity,
    magic.DATAFLASH: open_dataflash,
    magic.ULOG: open_ulog,
    **{kind: partial(open_ros, kind=kind) for kind in (magic.ROS1, magic.ROS2, magic.MCAP)},
}

READERS: dict[str, Reader] = {
    **_TABLES,
    **{kind: _arrays(kind) for kind in (magic.PARQUET, magic.HDF5, magic.MATLAB)},
    **{kind: _self_described(kind, opened) for kind, opened in _LOGS.items()},
    magic.ZIP: _zip_log,
    magic.NPY: _one_array,
}
"""What opens a file of each kind that magic.kind_of tells apart."""
