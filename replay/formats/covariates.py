"""Further columns of a recording that may drive its sensors' errors: battery voltage, load, a motor."""

from __future__ import annotations

import csv
import gzip
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.time_series import TimeSeries
from stillcal.replay.formats.clock import seconds_per_unit
from stillcal.replay.formats.columns import TIME_UNITS, TimeMap, find_columns
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.tables.dates import Dates, NotADateError

TIME = "t"
OWN = (TIME, "ax", "ay", "az", "gx", "gy", "gz", "temperature", "t_arrival")
"""Columns that the recording itself is made of."""

BY_T = TimeMap(column=TIME)
"""The time of stillcal's own CSV: a column `t`, s."""

FIRST = 10_000
"""Rows by whose stamps the unit of time is told: a block of the samples' reader holds about as many."""


def read_covariates(path: Path, names: Sequence[str], time: TimeMap = BY_T) -> dict[str, TimeSeries]:
    """Return the named columns of a CSV recording, each over its time, s, without empty and nan cells.

    time: the column of the stamps and its unit, as the samples' reader has it. Raises TraceError where the
    file is no CSV with these columns, a column holds no numbers, or a cell of one that does is none.
    """
    try:
        with _opened(path) as lines:
            return _columns(path, csv.reader(lines), names, time)
    except (OSError, UnicodeDecodeError, csv.Error, EOFError) as error:
        raise TraceError(
            path, f"--covariate cannot read it as CSV ({error})", "give a CSV recording with that column"
        ) from error


def of_values(name: str, values: Any, stamps: Array) -> TimeSeries:
    """Return a covariate from memory, without what is not finite.

    values: (n,) at the recording's stamps (n,) s, or a pair of times (m,) s and values (m,). Raises
    TraceError where they are no numbers, of another length, or their times run backwards.
    """
    t, own = values if isinstance(values, tuple) and len(values) == 2 else (stamps, values)
    try:
        t, own = np.asarray(t, dtype=np.float64), np.asarray(own, dtype=np.float64)
    except (TypeError, ValueError):
        raise TraceError(name, "the covariate holds what is not a number", "give numbers") from None
    if t.ndim != 1 or own.shape != t.shape:
        what = f"the covariate has shape {own.shape} and its times {t.shape}"
        raise TraceError(name, what, "give a value for each sample, or a pair (t, values)")
    there = np.isfinite(t) & np.isfinite(own)
    if not there.any() or (np.diff(t[there]) < 0.0).any():
        what = "the covariate holds no numbers" if not there.any() else "the covariate's times run backwards"
        raise TraceError(name, what, "correct it")
    return TimeSeries(t[there], own[there])


def columns_there(path: Path, names: Sequence[str]) -> list[str]:
    """Return the names that a recording has as columns: none where it is no CSV."""
    if not path.is_file():
        return []
    try:
        with _opened(path) as lines:
            header = {cell.strip() for cell in next(csv.reader(lines), [])}
    except (OSError, UnicodeDecodeError, csv.Error, EOFError):
        return []
    return [name for name in names if name in header]


def _opened(path: Path) -> TextIO:
    return gzip.open(path, "rt", newline="") if path.suffix == ".gz" else path.open(newline="")


def _places(path: Path, header: list[str], names: Sequence[str], time: TimeMap) -> dict[str, int]:
    """Return where the named columns are, and those of time."""
    for name in names:
        if name in (*OWN, time.column):
            raise TraceError(path, f"{name!r} is a sensor's own column", "name a further one for --covariate")
    of_time = [c for c in (time.column, time.fraction) if c is not None]
    for column in (*of_time, *names):
        if find_columns([column], header, len(header)) is None:
            raise TraceError(path, f"it has no column {column!r}", f"it has {', '.join(header) or 'none'}", 1)
    return {str(c): (find_columns([c], header, len(header)) or [0])[0] for c in (*of_time, *names)}


class _Clock:
    """The stamps of a table's rows, s, from their cells. places: of the columns, by name."""

    def __init__(self, path: Path, time: TimeMap, places: Mapping[str, int]) -> None:
        self._path, self._time = path, time
        self._column = None if time.column is None else places[str(time.column)]
        self._fraction = None if time.fraction is None else places[str(time.fraction)]
        self._dates: Dates | None = None
        self._first: list[float] = []
        self._rows = 0

    def see(self, row: int, cells: Sequence[str]) -> float:
        """Take the next row, whose line is number `row`; return its stamp in the unit of the table."""
        self._rows += 1
        if self._column is None:
            return self._rows - 1.0
        cell = cells[self._column].strip() if self._column < len(cells) else ""
        stamp = self._date(row, cell) if self._time.unit == "date" else self._stamp(row, cell)
        if self._fraction is not None:
            stamp += self._stamp(row, cells[self._fraction]) * TIME_UNITS[self._time.fraction_unit]
        if len(self._first) < FIRST:
            self._first.append(stamp)
        return stamp

    def unit(self) -> float:
        """Return the length of the unit, s. Raises TraceError where the stamps do not tell it."""
        if self._column is None:
            return 1.0 / (self._time.rate_hz or 1.0)
        found = seconds_per_unit(self._time.unit, np.array(self._first), self._time.rate_hz)
        if found is None:
            what = "the time column's unit cannot be told from its steps"
            raise TraceError(self._path, what, "say its unit in a column map (docs/formats.md)")
        return found

    def _stamp(self, row: int, cell: str) -> float:
        value = _number(cell)
        if value is None:
            what = f"{self._time.column} is {cell.strip()!r}, no finite number"
            raise TraceError(self._path, what, "mend or remove the row", row)
        return value

    def _date(self, row: int, cell: str) -> float:
        self._dates = self._dates or Dates(cell.encode())
        try:
            return float(self._dates.seconds([cell.encode()])[0])
        except NotADateError:
            what = f"{self._time.column} is {cell!r}, no date"
            raise TraceError(self._path, what, "mend or remove the row", row) from None


def _columns(path: Path, rows: Any, names: Sequence[str], time: TimeMap) -> dict[str, TimeSeries]:
    at = _places(path, [cell.strip() for cell in next(rows, [])], names, time)
    clock = _Clock(path, time, at)
    t: dict[str, list[float]] = {name: [] for name in names}
    values: dict[str, list[float]] = {name: [] for name in names}
    wrong: dict[str, tuple[int, str]] = {}
    for cells in filter(None, rows):
        stamp = clock.see(rows.line_num, cells)
        for name in names:
            cell = cells[at[name]].strip() if at[name] < len(cells) else ""
            if not _filled(cell):
                continue
            value = _number(cell)
            if value is None:
                wrong.setdefault(name, (rows.line_num, cell))
                continue
            t[name].append(stamp)
            values[name].append(value)
    for name in names:
        if not values[name]:
            raise TraceError(path, f"the column {name!r} holds no numbers", _which_do(path))
        if name in wrong:
            row, cell = wrong[name]
            raise TraceError(path, f"{name} is {cell!r}, no finite number", "mend or remove the row", row)
    unit = clock.unit()
    return {name: TimeSeries(np.array(t[name]) * unit, np.array(values[name])) for name in names}


def _which_do(path: Path) -> str:
    """Name the further columns that hold nothing but numbers."""
    with _opened(path) as lines:
        rows = csv.reader(lines)
        header = [cell.strip() for cell in next(rows, [])]
        numbers: set[str] = set()
        words: set[str] = set()
        for cells in rows:
            for name, cell in zip(header, map(str.strip, cells), strict=False):
                if _filled(cell):
                    (words if _number(cell) is None else numbers).add(name)
    further = [name for name in header if name in numbers - words and name not in OWN]
    return f"columns that do: {', '.join(further)}" if further else "no further column of the file does"


def _filled(cell: str) -> bool:
    """Whether a cell holds anything: `nan` stands for nothing, as an empty one does."""
    return cell.lower() not in ("", "nan")


def _number(cell: str) -> float | None:
    """Return the finite number in a cell, or None."""
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if np.isfinite(value) else None
