"""Where the columns of a column map are in one file's table, and the errors for missing ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.formats.columns import Column, ColumnMap, find_columns
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.tables.table import Table

MAP_REMEDY = "rename the columns, or describe them in a column map given as --format (docs/formats.md)"


@dataclass(frozen=True, slots=True)
class Layout:
    """What to read of a table: `wanted`, places in the file's rows; all others are places in `wanted`.

    axes: three of each sensor, and three of gravity behind them where the log keeps it apart.
    """

    wanted: list[int]
    time: int | None
    fraction: int | None
    arrival: int | None
    temperature: int | None
    axes: dict[Sensor, slice]


def lay_out(table: Table, column_map: ColumnMap, sensors: Sequence[Sensor]) -> Layout:
    """Find the columns of `sensors`. Raises TraceError where one that must be there is missing."""
    places_to_read: list[int] = []

    def single(column: Column | None) -> int | None:
        places = None if column is None else find_columns([column], table.names, table.width)
        places_to_read.extend(places or [])
        return len(places_to_read) - 1 if places else None

    time = single(column_map.time.column)
    if time is None and column_map.time.column is not None:
        raise missing(table, [column_map.time.column])
    fraction = single(column_map.time.fraction)
    if fraction is None and column_map.time.fraction is not None:
        raise missing(table, [column_map.time.fraction])
    arrival = single(column_map.time.arrival)
    temperature = single(column_map.temperature.column if column_map.temperature else None)
    axes: dict[Sensor, slice] = {}
    for sensor in sensors:
        sensor_map = column_map.sensor(sensor)
        places = find_columns(sensor_map.read, table.names, table.width)
        if places is not None:
            axes[sensor] = slice(len(places_to_read), len(places_to_read) + len(places))
            places_to_read.extend(places)
        elif len(sensors) == 1 or not _may_be_missing(table, column_map, sensor):
            raise missing(table, sensor_map.read)
    return Layout(places_to_read, time, fraction, arrival, temperature, axes)


def _may_be_missing(table: Table, column_map: ColumnMap, sensor: Sensor) -> bool:
    """Whether a sensor may be absent: it is optional and none of its columns is there."""
    sensor_map = column_map.sensor(sensor)
    some = any(find_columns([column], table.names, table.width) for column in sensor_map.read)
    return sensor_map.optional and not some


def selection(
    table: Table, column_map: ColumnMap, selected: Sequence[str] | None = None
) -> list[tuple[int, str]]:
    """Return (place, text) of the cells that a row must have to be read; empty where all rows are read.

    The texts are the map's own, else `selected`, else those of the file's first row.
    """
    select = column_map.select
    if select is None:
        return []
    places = find_columns(select.columns, table.names, table.width)
    if places is None:
        raise missing(table, select.columns)
    if not table.first_row:
        raise TraceError(table.path, "rows cannot be selected in a file of numbers", "leave out [select]")
    values = select.values or selected or [table.first_row[place].strip() for place in places]
    return list(zip(places, values, strict=True))


def missing(table: Table, columns: Sequence[Column]) -> TraceError:
    """Return the error that names the missing columns and the columns that the file has.

    columns: that were looked for; none where an accelerometer was looked for by its names.
    """
    absent = [c for c in columns if find_columns([c], table.names, table.width) is None]
    what = (
        f"no column {', '.join(repr(c) for c in absent)}" if absent else "no accelerometer found by its names"
    )
    if table.names is None:
        return TraceError(table.path, f"{what} in rows of {table.width} cells", MAP_REMEDY, table.header_line)
    if all(map(_is_float, table.names)):
        remedy = "name the columns in its first line, or count them in a column map (docs/formats.md)"
        return TraceError(table.path, f"{what}: the first line is not a header", remedy, table.header_line)
    header = ", ".join(table.names)
    what = f"{what}; the header has: {header if len(header) <= 120 else header[:117] + '...'}"
    return TraceError(table.path, what, _other_delimiter(table) or MAP_REMEDY, table.header_line)


def _is_float(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _other_delimiter(table: Table) -> str | None:
    """Return the remedy for a header that another character splits."""
    names = table.names or []
    for mark, name in ((";", ";"), ("\t", "\\t"), (",", ",")):
        if len(names) <= 2 and any(mark in cell for cell in names):
            separator = f'set delimiter = "{name}" in a column map'
            return f"its cells seem to be separated by another character; {separator}"
    return None
