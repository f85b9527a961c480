"""One file of a recording as samples in SI units, block by block, for the sensors that it holds.

Empty cells: a row whose three cells of a sensor are all empty has no sample of that sensor. A
temperature carries over to the rows after it (leading rows take the first that follows), so that
samples carry a temperature for every row or, before the first reading is known, none at all; an arrival
time missing is the stamp plus the delay of the row before.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.limits import STAMP_S, usable
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.clock import Clock, Rows, seconds_per_unit
from stillcal.replay.formats.columns import TIME_UNITS, ColumnMap, SensorMap
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.tables.layout import lay_out, selection
from stillcal.replay.formats.tables.numbers import NumberTable
from stillcal.replay.formats.tables.table import EMPTY, Table

CLOCKS_AGREE = 0.05
"""A relative difference of the sensor's and the host's clock above this is noted."""

Run = dict[Sensor, Samples]
"""Samples of the same stretch of file, by sensor."""


class SampleFile:
    """Reads one table through a column map. Opening checks that the columns are there; raises TraceError.

    selected: the cells by which rows are chosen, where the map chooses and another file's hold for this.
    """

    def __init__(
        self,
        table: Table,
        column_map: ColumnMap,
        sensors: Sequence[Sensor],
        claims: Claims,
        selected: Sequence[str] | None = None,
    ) -> None:
        self.path = table.path
        self._map = column_map
        self._claims = claims
        for sensor in sensors:
            _refuse_by_name(table.path, column_map.sensor(sensor))
        self._table = table
        self._layout = lay_out(self._table, column_map, sensors)
        self._key = selection(self._table, column_map, selected)
        if column_map.time.unit == "date" and self._layout.time is not None:
            table.read_dates(self._layout.wanted[self._layout.time])
        self._begin()

    def _begin(self) -> None:
        columns = np.arange(len(self._layout.wanted))
        readings = [columns[axes] for axes in self._layout.axes.values()]
        self._clock = Clock(self.path, self._map, np.concatenate([columns[:0], *readings]))
        self._origin: tuple[float, float] | None = None
        self._scale: float | None = None
        self._by_arrival = False
        self._temperature = self._delay = np.nan
        self._without_cells = 0
        self._spans = np.zeros(2)

    @property
    def selected(self) -> list[str]:
        """The cells by which rows are chosen; none where all are read."""
        return [text for _, text in self._key]

    @property
    def columns(self) -> list[str]:
        """The names of the table's columns; none where they have no names."""
        return list(self._table.names or [])

    @property
    def further_columns(self) -> list[str]:
        """The names of those that the samples are not made of."""
        return [name for i, name in enumerate(self.columns) if i not in self._layout.wanted]

    @property
    def sensors(self) -> list[Sensor]:
        """The sensors whose columns the file has."""
        return list(self._layout.axes)

    @property
    def has_temperature(self) -> bool:
        """Whether the file has a column of temperatures."""
        return self._layout.temperature is not None

    @property
    def has_arrival(self) -> bool:
        """Whether the file has a column of arrival times."""
        return self._layout.arrival is not None

    @property
    def size_bytes(self) -> int:
        """Bytes of the file as stored."""
        return self._table.size_bytes

    @property
    def bytes_read(self) -> int:
        """Bytes of the file read so far."""
        return self._table.bytes_read

    @property
    def delivered_twice(self) -> Array:
        """Stamps, s, of the rows left out so far that repeat stamp and readings of the one before."""
        return np.concatenate([np.empty(0), *self._clock.tally.twice])

    @property
    def notes(self) -> list[str]:
        """Irregularities tolerated and choices made so far, one line each."""
        lines = list(self._table.notes)
        if self._table.skipped_rows:
            chosen = " ".join(self.selected)
            lines.append(f"only the rows of {chosen} are read, {self._table.skipped_rows} others skipped")
        if self._by_arrival:
            lines.append(
                "the sensor's own time stamps are not usable as a clock; arrival times are used instead"
            )
        if self._without_cells:
            lines.append(f"{self._without_cells} rows have no sample of one sensor (empty cells)")
        own, arrival = self._spans
        if own and abs(arrival / own - 1) > CLOCKS_AGREE:
            lines.append(
                f"the sensor's clock advanced {own:.6g} s while arrival times advanced {arrival:.6g} s"
            )
        return [f"{short_name(self.path)}: {line}" for line in [*lines, *self._clock.notes()]]

    def runs(self) -> Iterator[Run]:
        """Yield the file's samples in time order. Raises TraceError at the first row that cannot be used."""
        self._begin()
        row = 0
        for block in self._table.blocks(self._layout.wanted, self._key):
            self._check_finite(block.values, block.lines)
            t = self._stamps(block.values, row)
            row += len(t)
            yield self._run(self._clock.ordered(Rows(t, block.values, block.lines)))
        held_back = self._clock.rest()
        if held_back is not None:
            yield self._run(held_back)

    def further(self, name: str) -> tuple[Array, Array]:
        """Return the stamps (n,), s, and the values (n,) of a further column; NaN where a cell is empty.

        Raises TraceError at the first cell that is no number.
        """
        at = self.columns.index(name)
        if isinstance(self._table, NumberTable) and self._table.texts(at) is not None:
            raise TraceError(self.path, f"the column {name!r} holds texts", "name a column of numbers")
        self._begin()
        stamps, values = [np.empty(0)], [np.empty(0)]
        places = [*self._layout.wanted, at]
        for block in self._table.blocks(places, self._key):
            stamps.append(self._stamps(block.values[:, :-1], sum(len(t) for t in stamps)))
            values.append(block.values[:, -1])
        column = np.concatenate(values)
        return np.concatenate(stamps), np.where(column == EMPTY, np.nan, column)

    def _check_finite(self, values: Array, lines: NDArray[np.int64]) -> None:
        """Raise TraceError for values that are not finite, and for empty cells that must have a number."""
        if not values.size:
            return
        low, high = float(values.min()), float(values.max())
        finite = low >= EMPTY and high < np.inf  # false with NaN
        if finite and (low > EMPTY or self._only_whole_samples_empty(values)):
            return
        bad = ~np.isfinite(values)
        temperature = self._layout.temperature
        if temperature is not None and bad[:, temperature].any():
            unknown = np.isnan(values[:, temperature])  # a common way to write that nothing was measured
            values[unknown, temperature] = EMPTY
            bad[unknown, temperature] = False
        for place in self._clock_columns():
            bad[:, place] |= values[:, place] == EMPTY
        for axes in self._layout.axes.values():
            none = np.isnan(values[:, axes]).all(axis=1)  # as MATLAB writes that there is none
            values[none, axes] = EMPTY
            bad[none, axes] = False
            empty = values[:, axes] == EMPTY
            bad[:, axes] |= empty & ~empty.all(axis=1, keepdims=True)
        if bad.any():
            row, column = (int(i) for i in np.argwhere(bad)[0])
            cell = values[row, column]
            holds = "is empty" if cell == EMPTY else f"holds {cell}, which is not a finite number"
            what = f"{self._table.column_name(self._layout.wanted[column])} {holds}"
            remedy = "correct or delete that row"
            if np.isnan(cell):
                remedy = f"{remedy}, or leave all cells of the sensor empty"
            raise TraceError(self.path, what, remedy, int(lines[row]))

    def _only_whole_samples_empty(self, values: Array) -> bool:
        """Whether of the cells that must have a number only all of a sensor are empty, in any row."""
        empty = values == EMPTY
        if empty[:, self._clock_columns()].any():
            return False
        by_sensor = [empty[:, axes].T for axes in self._layout.axes.values()]
        return all(np.array_equal(x, other) for x, *others in by_sensor for other in others)

    def _clock_columns(self) -> list[int]:
        return [p for p in (self._layout.time, self._layout.fraction) if p is not None]

    def _stamps(self, values: Array, first_row: int) -> Array:
        time = self._map.time
        if self._layout.time is None:
            return np.asarray((first_row + np.arange(len(values))) / (time.rate_hz or 1.0))
        if self._scale is None:
            self._scale = self._found_scale(values)
        place = self._layout.arrival if self._by_arrival else self._layout.time
        stamps = values[:, place]
        if self._layout.fraction is not None:
            return np.asarray(stamps + values[:, self._layout.fraction] * TIME_UNITS[time.fraction_unit])
        return stamps if self._scale == 1.0 else stamps * self._scale

    def _found_scale(self, values: Array) -> float:
        time = self._map.time
        scale = seconds_per_unit(time.unit, values[:, self._layout.time], time.rate_hz)
        if scale is None and self._layout.arrival is not None:
            self._by_arrival = True
            return TIME_UNITS[time.arrival_unit]
        if scale is None:
            what = "the time column's unit cannot be told from its steps"
            raise TraceError(self.path, what, "say its unit in a column map (docs/formats.md)")
        return scale

    def _run(self, rows: Rows) -> Run:
        temperature, arrival = self._temperatures(rows), self._arrivals(rows)
        run = {}
        for sensor, axes in self._layout.axes.items():
            columns = [rows.t, *rows.values[:, axes].T, temperature, arrival]
            lines = rows.lines
            there = np.flatnonzero(columns[1] != EMPTY)
            if there.size < len(rows):
                self._without_cells += len(rows) - there.size
                columns = [None if column is None else column.take(there) for column in columns]
                lines = lines[there]
            t, *read, temperatures, arrivals = columns
            xyz = np.stack(read[:3], axis=1)
            xyz = self._si(sensor, xyz + np.stack(read[3:], axis=1) if read[3:] else xyz)
            others = (None if c is None else frozen(c) for c in (temperatures, arrivals))
            samples = Samples(sensor, frozen(t), frozen(xyz), *others)
            self._check_limits(samples, lines)
            run[sensor] = samples
        return run

    def _check_limits(self, samples: Samples, lines: NDArray[np.int64]) -> None:
        """Raise TraceError for stamps and readings that no sensor gives. lines: (n,) of the samples."""
        t, xyz = samples.t, samples.xyz
        if not xyz.size or usable(t[[0, -1]], np.array([[xyz.min()] * 3, [xyz.max()] * 3])).all():
            return  # the stamps are in order
        wild = ~usable(t, xyz)
        if wild.any():
            i = int(wild.argmax())
            if abs(t[i]) > STAMP_S:
                what = f"the time stamp {t[i]:.6g} s is beyond any clock"
                remedy = 'give s, or set unit = "ns", "us" or "ms" in a column map (docs/formats.md)'
                raise TraceError(self.path, what, remedy, int(lines[i]))
            values = " ".join(f"{value:.4g}" for value in xyz[i])
            what = f"{values} at {t[i]:.6g} s is beyond any sensor's range"
            raise TraceError(self.path, what, "correct or delete that row", int(lines[i]))

    def _si(self, sensor: Sensor, xyz: Array) -> Array:
        sensor_map = self._map.sensor(sensor)
        unit, zero = self._claims.counts(sensor)
        factor = (sensor_map.si_per_unit if unit is None else np.asarray(unit)) * np.array(sensor_map.signs)
        offset = np.asarray(sensor_map.zero if zero is None else zero)
        return (xyz - offset) * factor if np.any(offset != 0) or np.any(factor != 1) else xyz

    def _temperatures(self, rows: Rows) -> Array | None:
        if self._layout.temperature is None or self._map.temperature is None:
            return None
        filled = filled_forward(rows.values[:, self._layout.temperature], self._temperature)
        if filled is None or not len(filled):
            return None
        self._temperature = float(filled[-1])
        factor, offset = self._map.temperature.celsius
        return frozen(filled if (factor, offset) == (1.0, 0.0) else filled * factor + offset)

    def _arrivals(self, rows: Rows) -> Array | None:
        if self._layout.arrival is None:
            return None
        column = rows.values[:, self._layout.arrival]
        unit = TIME_UNITS[self._map.time.arrival_unit]
        seconds = column if unit == 1.0 else column * unit
        empty = column == EMPTY
        if not empty.any():
            self._compare_clocks(rows.t, seconds)
            return frozen(seconds)
        delay = filled_forward(np.where(empty, EMPTY, seconds - rows.t), self._delay)
        if delay is None:
            return None
        self._delay = float(delay[-1])
        return frozen(np.where(empty, rows.t + delay, seconds))

    def _compare_clocks(self, t: Array, arrival: Array) -> None:
        if t.size:
            self._origin = self._origin or (float(t[0]), float(arrival[0]))
            self._spans = np.array([t[-1], arrival[-1]]) - self._origin


def _refuse_by_name(path: Path, sensor_map: SensorMap) -> None:
    stem = path.name.split(".")[0]
    if stem in sensor_map.refuse:
        what, remedy = sensor_map.refuse[stem]
        raise TraceError(path, what, remedy)


def filled_forward(column: Array, last: float) -> Array | None:
    """Fill EMPTY cells with the value before, leading ones with the first that follows; None if all are."""
    known = column != EMPTY
    if known.all():
        return column
    if not known.any():
        return None if np.isnan(last) else np.full(column.shape, last)
    before = np.maximum.accumulate(np.where(known, np.arange(column.size), -1))
    start = column[int(known.argmax())] if np.isnan(last) else last
    return np.asarray(np.where(before >= 0, column[before], start))
