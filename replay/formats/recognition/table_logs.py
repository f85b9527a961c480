"""Logs that are tables: text, JSON records and printed messages, by what their columns are called."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec

from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.claims import written_by_stillcal
from stillcal.replay.formats.columns import ColumnMap, TimeMap, load_map
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.logs.arrays import mapped, open_arrays
from stillcal.replay.formats.logs.betaflight import open_betaflight
from stillcal.replay.formats.logs.gnss_logger import open_gnss_logger
from stillcal.replay.formats.logs.json_log import json_tables
from stillcal.replay.formats.recognition import magic
from stillcal.replay.formats.recognition.by_map import by_map
from stillcal.replay.formats.recognition.log import GyroscopeAloneError, Log, LoggedSensor
from stillcal.replay.formats.recognition.names.axes import find_axes
from stillcal.replay.formats.recognition.names.containers import (
    bare_axes,
    called_otherwise,
    named_after,
    qualified,
)
from stillcal.replay.formats.recognition.names.kinds import is_own, rates_alone, without_gravity
from stillcal.replay.formats.recognition.names.vocabulary import OWN
from stillcal.replay.formats.recognition.pairs import rates_file
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
from stillcal.replay.formats.recognition.unnamed import names_of_axes
from stillcal.replay.formats.sources import Source, source_of
from stillcal.replay.formats.tables.echoed import Echoed
from stillcal.replay.formats.tables.json_table import JsonTable
from stillcal.replay.formats.tables.layout import missing
from stillcal.replay.formats.tables.plain import plain_text
from stillcal.replay.formats.tables.table import Table
from stillcal.replay.formats.tables.text import NoRowsError, TextTable


def text_log(
    source: Source, column_map: ColumnMap | None, gyro: Source | None, rate_hz: float | None = None
) -> Log:
    """Return the log of a text table, by the given map or the one that its first lines ask for.

    rate_hz: of a table without time stamps.
    """
    if column_map is not None:
        return by_map(source, TextFormat("", column_map), gyro, [])
    form = _at(text_format(source), rate_hz)
    source = form.source or source
    if form.name == GNSS_LOGGER:
        return open_gnss_logger(source)
    if form.name == BETAFLIGHT:
        return open_betaflight(source, form.column_map)
    if form.name == REST:
        raise without_samples(source.path)
    sensors = []
    if form.name in (UNKNOWN, *SENSOR_LOGGER):
        sensors = sensors_of_rows(partial(_named_table, source, form), form.cut, form.rate_hz)
    if sensors:
        return Log(source.path, "text table", sensors, beside=source.local)
    if form.name in SENSOR_LOGGER and called_otherwise(_container(source), "accelerometer"):
        form = replace(form, name=UNKNOWN)  # the app's files of other quantities have the same columns
    if form.name == UNKNOWN:
        log = _by_names(source, form, gyro)
        first = [f"{short_name(source.path)}: {form.said}"] if form.said else []
        return replace(log, notes=[*first, *log.notes])
    if form.name == "csv":
        refuse_devices_in_turn(TextTable(source, form.column_map))
    said = f" ({form.said})" if form.said else ""
    notes = [] if form.name == "csv" else [f"{short_name(source.path)}: read as {form.name}{said}"]
    return by_map(source, form, gyro, notes)


def _at(form: TextFormat, rate_hz: float | None) -> TextFormat:
    """Return a text table with the rate that it was said to have without time stamps."""
    if rate_hz is None:
        return form
    column_map = form.column_map
    if column_map.time.rate_hz is not None:
        column_map = msgspec.structs.replace(column_map, time=TimeMap(rate_hz=rate_hz))
    return replace(form, column_map=column_map, rate_hz=rate_hz, said="")


def _by_names(source: Source, form: TextFormat, gyro: Source | None) -> Log:
    """Return the log of a text table of unknown make. Raises TraceError."""
    if rates_alone(qualified(_axes_without_header(source, form) or [], _container(source))):
        raise GyroscopeAloneError(source.path)
    table = _text_table(source, form)
    log = _log_by_names(source, OneSensor(table, form.cut, form.rate_hz), "text table", gyro)
    if log is not None:
        return log
    if table.names is not None and not OWN & set(table.names):
        raise missing(table, [])
    return by_map(source, form, gyro, [])


def json_log(
    source: Source, column_map: ColumnMap | None, gyro: Source | None, rate_hz: float | None = None
) -> Log:
    """Return the log of JSON records, or of the arrays in one JSON object. Raises TraceError."""
    if source.local is not None and written_by_stillcal(source.local):
        what = "is a calibration, a store or a diagnosis that stillcal wrote, not a recording"
        raise TraceError(source.path, what, "give the recording that it was made from")
    tables = json_tables(source)
    if not tables:
        return open_arrays(source, magic.JSON, column_map)
    return _records_log(source, magic.JSON, tables, column_map, gyro, rate_hz=rate_hz)


def echo_log(
    source: Source, column_map: ColumnMap | None, gyro: Source | None, rate_hz: float | None = None
) -> Log:
    """Return the log of messages that ROS printed. Raises TraceError."""
    return _records_log(source, magic.ECHO, _echo_tables(source), column_map, gyro, rate_hz=rate_hz)


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
    *,
    rate_hz: float | None,
) -> Log:
    """Return the log of tables of records, by the fields that hold them. Raises TraceError."""
    base = column_map or load_map("csv")
    own = [
        OneSensor(_qualified(opened(), _container(source, name)), base, rate_hz)
        for name, opened in tables.items()
    ]
    if len(own) > 1 and column_map is None:
        sensors = settled_apart(own)
        if not sensors:
            what = f"no accelerometer found in its lists of records: {', '.join(list(tables)[:8])}"
            remedy = "write one object for each sample, such as {time, acc_x, acc_y, acc_z}"
            raise TraceError(source.path, what, remedy)
        return Log(source.path, kind, sensors, beside=source.local)
    table, opened = own[0].table, next(iter(tables.values()))
    if column_map is not None or is_own(table.names or []):
        if column_map is None:
            refuse_devices_in_turn(opened())
        return Log(source.path, kind, mapped(table, base), beside=source.local)
    rows = sensors_of_rows(opened, base, rate_hz)
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
        remedy = "record the raw accelerometer, or gravity in columns of its own beside these"
        raise TraceError(source.path, what, remedy)
    if rates_alone(own.table.names or []):
        raise GyroscopeAloneError(source.path)
    if len(bare_axes(own.table.names or [])) == 3 and called_otherwise(_container(source), "accelerometer"):
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
    source = form.source or source
    form = replace(form, names=form.names or _axes_without_header(source, form))
    return OneSensor(_text_table(source, form), form.cut, form.rate_hz)


def _axes_without_header(source: Source, form: TextFormat) -> list[str] | None:
    """Return names for the columns of a text table of three axes without a header; None of another table."""
    if form.name != UNKNOWN or form.names is not None or form.column_map.header:
        return None
    return names_of_axes(TextTable(source, form.column_map).opening)


def _text_table(source: Source, form: TextFormat) -> Table:
    """Return a text table of unknown make, with what its file's name tells of its columns."""
    return _qualified(_named_table(source, form), _container(source))


def _named_table(source: Source, form: TextFormat) -> TextTable:
    """Return a text table with the names of its columns that more than its header tells."""
    table = TextTable(source, form.column_map)
    if form.names is not None:
        table.names, table.width = form.names, len(form.names)
        first = next((row for row in table.opening if len(row) == table.width), None)
        if first is None:
            what = f"none of the first rows has {table.width} cells, as many as there are names"
            raise TraceError(table.path, what, "correct the names, or give them in a column map")
        table.first_row = first
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


def without_samples(path: Path | str) -> TraceError:
    """Return the error of a rest table that was given where samples are needed."""
    remedy = "give samples; only the commands stillcal diagnose and stillcal replay take rest tables"
    return TraceError(path, "a rest table holds no samples", remedy)
