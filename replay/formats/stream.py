"""One file of a recording as samples in SI units, block by block, for the sensors that it holds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from stillcal.calib_core.samples import Array, Samples, Sensor, frozen
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.clock import Clock, Rows, seconds_per_unit
from stillcal.replay.formats.columns import TIME_UNITS, Column, ColumnMap, SensorMap, find_columns
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.text import EMPTY, TextTable

Run = dict[Sensor, Samples]
"""Samples of the same stretch of file, by sensor."""


class SampleFile:
    """Reads one file through a column map. Opening checks that the columns are there; raises TraceError."""

    def __init__(self, path: Path, column_map: ColumnMap, sensors: Sequence[Sensor], claims: Claims) -> None:
        self.path = path
        self._map = column_map
        self._claims = claims
        self._table = TextTable(path, column_map)
        self._clock = Clock(path, column_map)
        self._scale: float | None = None
        self._missing = 0
        self._time = self._optional(column_map.time.column)
        if self._time is None and column_map.time.column is not None:
            raise self._no_column([column_map.time.column])
        self._arrival = self._optional(column_map.time.arrival)
        self._temperature = self._optional(column_map.temperature.column if column_map.temperature else None)
        self._axes = {sensor: places for sensor in sensors if (places := self._axes_of(sensor))}
        self._last_temperature = self._last_delay = np.nan

    @property
    def sensors(self) -> list[Sensor]:
        """The sensors whose columns the file has."""
        return list(self._axes)

    @property
    def bytes_read(self) -> int:
        """Bytes of the file read so far."""
        return self._table.count.value

    @property
    def notes(self) -> list[str]:
        """What was tolerated so far, one line each."""
        said = self._clock.notes()
        if self._table.left_out:
            chosen = ", ".join(text for _, text in self._key())
            said.append(f"{self.path.name}: {self._table.left_out} rows not of {chosen} were left out")
        if self._missing:
            said.append(f"{self.path.name}: {self._missing} rows had empty cells for a sensor")
        return said

    def runs(self) -> Iterator[Run]:
        """Yield the file's samples in time order. Raises TraceError at the first row that cannot be used."""
        self._clock = Clock(self.path, self._map)
        self._last_temperature = self._last_delay = np.nan
        self._missing = 0
        places = self._places()
        row = 0
        for block in self._table.blocks(places, self._key()):
            self._check_finite(block.values, block.lines, places)
            t = self._stamps(block.values, row)
            row += len(t)
            yield self._run(self._clock.ordered(Rows(t, block.values, block.lines)))
        held = self._clock.rest()
        if held is not None:
            yield self._run(held)

    # Columns

    def _optional(self, column: Column | None) -> int | None:
        found = None if column is None else find_columns([column], self._table.names, self._table.width)
        return found[0] if found else None

    def _axes_of(self, sensor: Sensor) -> list[int] | None:
        sensor_map = self._sensor_map(sensor)
        found = find_columns(sensor_map.columns, self._table.names, self._table.width)
        if found is None and not sensor_map.optional:
            raise self._no_column(sensor_map.columns)
        return found

    def _sensor_map(self, sensor: Sensor) -> SensorMap:
        chosen = self._map.accelerometer if sensor is Sensor.ACCELEROMETER else self._map.gyroscope
        assert chosen is not None
        return chosen

    def _no_column(self, wanted: Sequence[Column]) -> TraceError:
        table = self._table
        missing = [c for c in wanted if find_columns([c], table.names, table.width) is None]
        what = f"no column {', '.join(repr(c) for c in missing)}"
        if table.names is None:
            return TraceError(self.path, f"{what} in rows of {table.width} cells", _MAP_REMEDY, 1)
        seen = ", ".join(table.names)[:120]
        return TraceError(self.path, f"{what}; the header has: {seen}", _MAP_REMEDY, self._map.skip_lines + 1)

    def _places(self) -> list[int]:
        single = [p for p in (self._time, self._arrival, self._temperature) if p is not None]
        return [*single, *(p for axes in self._axes.values() for p in axes)]

    def _key(self) -> list[tuple[int, str]]:
        select = self._map.select
        if select is None:
            return []
        places = find_columns(select.columns, self._table.names, self._table.width)
        if places is None:
            raise self._no_column(select.columns)
        values = select.values or [self._table.first_row[place].strip() for place in places]
        return list(zip(places, values, strict=True))

    def _column(self, values: Array, place: int | None) -> Array | None:
        return None if place is None else values[:, self._places().index(place)]

    # Values

    def _check_finite(self, values: Array, lines: np.ndarray, places: Sequence[int]) -> None:
        bad = ~np.isfinite(values)
        if not bad.any():
            return
        if self._temperature is not None:  # "nan" is a common way to write that nothing was measured
            column = self._places().index(self._temperature)
            unknown = np.isnan(values[:, column])
            values[unknown, column] = EMPTY
            bad[unknown, column] = False
        if bad.any():
            row, column = np.argwhere(bad)[0]
            name = self._table.column_name(places[column])
            what = f"{name} holds {values[row, column]}, which is not a finite number"
            raise TraceError(self.path, what, "correct or delete that row", int(lines[row]))

    def _stamps(self, values: Array, first_row: int) -> Array:
        time = self._map.time
        if self._time is None:
            return (first_row + np.arange(len(values))) / (time.rate_hz or 1.0)
        stamps = values[:, 0]
        if self._scale is None:
            self._scale = seconds_per_unit(time.unit, stamps, time.rate_hz)
        if self._scale is None:
            raise TraceError(self.path, "the unit of the time column cannot be told", _MAP_REMEDY, None)
        return stamps if self._scale == 1.0 else stamps * self._scale

    def _run(self, rows: Rows) -> Run:
        temperature, arrival = self._temperatures(rows), self._arrivals(rows)
        run = {}
        for sensor, axes in self._axes.items():
            first = self._places().index(axes[0])
            xyz = rows.values[:, first : first + 3]
            run[sensor] = Samples(sensor, frozen(rows.t), frozen(self._si(sensor, xyz)), temperature, arrival)
        return run

    def _si(self, sensor: Sensor, xyz: Array) -> Array:
        sensor_map = self._sensor_map(sensor)
        unit, zero = self._claims.counts(sensor)
        factor = (sensor_map.si_per_unit if unit is None else np.asarray(unit)) * np.array(sensor_map.signs)
        offset = np.asarray(sensor_map.zero if zero is None else zero)
        return (xyz - offset) * factor if np.any(offset) or np.any(factor != 1) else xyz

    def _temperatures(self, rows: Rows) -> Array | None:
        column, temperature_map = self._column(rows.values, self._temperature), self._map.temperature
        if column is None or temperature_map is None:
            return None
        factor, offset = temperature_map.celsius()
        filled = _carried(column, self._last_temperature)
        if filled is None:
            return None
        self._last_temperature = float(filled[-1]) if len(filled) else self._last_temperature
        return frozen(filled if (factor, offset) == (1.0, 0.0) else filled * factor + offset)

    def _arrivals(self, rows: Rows) -> Array | None:
        column = self._column(rows.values, self._arrival)
        if column is None:
            return None
        seconds = column * TIME_UNITS[self._map.time.arrival_unit]
        if not (column == EMPTY).any():
            return frozen(seconds)
        delay = _carried(np.where(column == EMPTY, EMPTY, seconds - rows.t), self._last_delay)
        if delay is None:
            return None
        self._last_delay = float(delay[-1])
        return frozen(rows.t + delay)


_MAP_REMEDY = "name the columns so, or say which is which in a column map given as --format (docs/formats.md)"


def _carried(column: Array, last: float) -> Array | None:
    """Fill EMPTY cells with the value before, leading ones with the first that follows; None if all are."""
    known = column != EMPTY
    if known.all():
        return column
    if not known.any():
        return None if np.isnan(last) else np.full(column.shape, last)
    before = np.maximum.accumulate(np.where(known, np.arange(column.size), -1))
    start = column[int(known.argmax())] if np.isnan(last) else last
    return np.where(before >= 0, column[before], start)
