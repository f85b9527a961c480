"""A table of JSON records: its columns are the records' fields, those within others by their paths.

`{"t": 1.5, "acc": {"x": 0.1}, "gyr": [0, 1, 2]}` has the columns t, acc.x, gyr[0], gyr[1] and gyr[2]. Of a
record that holds a list of records, each of these is a row, with the fields around them. Fields that a
record lacks, and null, are empty cells.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.tables.chosen import MOST_TEXTS
from stillcal.replay.formats.tables.dates import Dates, NotADateError
from stillcal.replay.formats.tables.json_records import Records
from stillcal.replay.formats.tables.numbers import side_by_side
from stillcal.replay.formats.tables.table import EMPTY, OPENING_ROWS, Block

FieldPath = tuple[str | int, ...]
"""Keys and places that lead to a value in a record."""

MOST_FIELDS = 1000
_MOST_IN_A_LIST = 16
_DEEPEST = 5
_REMEDY = "correct or delete that record"


class JsonTable:
    """A table of JSON records. Opening reads its first block; `blocks` reads it through.

    records: reads them from their start. notes: where that says what it passes over. Its attributes are a
    Table's; names are None if records are lists. Raises TraceError.
    """

    def __init__(
        self,
        path: Path,
        records: Callable[[], Iterator[Records]],
        size_bytes: int,
        notes: list[str] | None = None,
    ) -> None:
        self._records = records
        self.path = path
        self.size_bytes = size_bytes
        self.bytes_read = self.skipped_rows = 0
        self.header_line: int | None = None
        self.notes = [] if notes is None else notes
        self._dates: int | None = None
        first = next(records(), None)
        if first is None:
            raise TraceError(self.path, "the file holds no records", "give a recording with samples")
        self._unusable(first)
        self._within = next((key for record in first.values for key in _record_lists(record)), None)
        rows, _ = self._rows(first)
        shown = _first_values(rows)
        self._paths = list(shown)
        self.first_row = [str(value) for value in shown.values()]
        listed = isinstance(rows[0], list) if rows else False
        self.names: list[str] | None = None if listed else [_called(path) for path in self._paths]
        self.width = len(self._paths)
        columns = [_values(rows[:OPENING_ROWS], path) for path in self._paths]
        self.opening = [["" if v is None else str(v) for v in row] for row in zip(*columns, strict=True)]

    def blocks(self, places: Sequence[int], key: Sequence[tuple[int, str]] = ()) -> Iterator[Block]:
        """Yield the fields at `places`, of the records that have the key's texts. Raises TraceError."""
        self.skipped_rows = 0
        clock = None if self._dates is None else Dates(self.first_row[self._dates].encode())
        for read, all_lines in self._read():
            chosen = self._having(read, key)
            self.skipped_rows += len(read) - len(chosen)
            rows, lines = [read[i] for i in chosen], all_lines[chosen]
            columns = [
                self._date_column(clock, rows, lines)
                if clock is not None and place == self._dates
                else self._column(place, rows, lines)
                for place in places
            ]
            yield Block(side_by_side(columns) if columns else np.empty((len(rows), 0)), lines)

    def texts(self, place: int) -> list[str] | None:
        """Return the texts or whole numbers of a field; None where one is neither, or beyond MOST_TEXTS."""
        known: dict[str, None] = {}
        for rows, _ in self._read():
            values = [value for value in _values(rows, self._paths[place]) if value is not None]
            if not all(isinstance(value, str | int) for value in values):
                return None
            known |= dict.fromkeys(map(str, values))
            if len(known) > MOST_TEXTS:
                return None
        return list(known)

    def read_dates(self, place: int) -> None:
        """Read the field at `place` as dates, s since 1970."""
        self._dates = place

    def column_name(self, place: int) -> str:
        """Return how to call the field at `place` in a message."""
        return f"field {_called(self._paths[place])!r}"

    def _read(self) -> Iterator[tuple[list[Any], NDArray[np.int64]]]:
        for block in self._records():
            self._unusable(block)
            self.bytes_read = block.bytes_read
            yield self._rows(block)

    def _rows(self, block: Records) -> tuple[list[Any], NDArray[np.int64]]:
        """Return the rows that records hold, one each unless they hold lists of them, and their lines."""
        key = self._within
        if key is None:
            return block.values, block.lines
        inner = [record.get(key) or [] for record in block.values]
        around = ({k: v for k, v in record.items() if k != key} for record in block.values)
        rows = [
            outer | (item if isinstance(item, dict) else {})
            for outer, items in zip(around, inner, strict=True)
            for item in items
        ]
        return rows, np.repeat(block.lines, [len(items) for items in inner])

    def _unusable(self, block: Records) -> None:
        """Raise TraceError where a record is neither an object nor a list like the first."""
        kind = type(block.values[0])
        if kind in (dict, list) and all(type(record) is kind for record in block.values):
            return
        bad = next((i for i, record in enumerate(block.values) if type(record) is not dict), 0)
        raise TraceError(self.path, "is no JSON object with fields", _REMEDY, int(block.lines[bad]))

    def _having(self, rows: list[Any], key: Sequence[tuple[int, str]]) -> list[int]:
        """Return the places of the rows that have the key's texts."""
        chosen = list(range(len(rows)))
        for place, text in key:
            values = _values(rows, self._paths[place])
            chosen = [i for i in chosen if str(values[i]) == text]
        return chosen

    def _column(self, place: int, rows: list[Any], lines: NDArray[np.int64]) -> Array:
        """Return a field of the rows as numbers (n,). Raises TraceError naming the line of another value."""
        values = _values(rows, self._paths[place])
        filled = [EMPTY if value is None or value == "" else value for value in values]
        try:
            return np.array(filled, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            for value, line in zip(filled, lines.tolist(), strict=True):
                if not _is_number(value):
                    what = f"{self.column_name(place)} holds {str(value)[:40]!r}, which is not a number"
                    raise TraceError(self.path, what, _REMEDY, line) from None
            raise

    def _date_column(self, clock: Dates, rows: list[Any], lines: NDArray[np.int64]) -> Array:
        """Return the field of dates as s since 1970, (n,). Raises TraceError."""
        cells = [str(value) for value in _values(rows, self._paths[self._dates or 0])]
        try:
            return clock.seconds([cell.encode() for cell in cells])
        except NotADateError as error:
            what = (
                f"{self.column_name(self._dates or 0)} holds {cells[error.index][:40]!r}, which is not a date"
            )
            raise TraceError(self.path, what, _REMEDY, int(lines[error.index])) from None


def _first_values(rows: Sequence[Any]) -> dict[FieldPath, Any]:
    """Return the fields of rows in the order in which they come up, each with its first value."""
    found: dict[FieldPath, Any] = {}
    for row in rows:
        for path, value in _fields(row):
            found.setdefault(path, value)
        if len(found) > MOST_FIELDS:
            break
    return found


def _fields(value: Any, path: FieldPath = ()) -> Iterator[tuple[FieldPath, Any]]:
    """Yield the numbers and texts within a value by their paths."""
    if isinstance(value, dict) and len(path) < _DEEPEST:
        for key, inner in value.items():
            yield from _fields(inner, (*path, key))
    elif isinstance(value, list) and len(path) < _DEEPEST and len(value) <= _MOST_IN_A_LIST:
        for place, inner in enumerate(value):
            yield from _fields(inner, (*path, place))
    elif isinstance(value, int | float | str) and not isinstance(value, bool):
        yield path, value


def _record_lists(record: Any) -> Iterator[str]:
    """Yield the fields of a record that hold lists of records."""
    for key, value in record.items() if isinstance(record, dict) else ():
        if isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
            yield key


def _values(rows: Sequence[Any], path: FieldPath) -> list[Any]:
    """Return a field of all rows, None where one has none."""
    values = list(rows)
    for key in path:
        try:
            values = [value[key] for value in values]
        except (KeyError, IndexError, TypeError):
            values = [_item(value, key) for value in values]
    return values


def _item(value: Any, key: str | int) -> Any:
    if isinstance(value, dict):
        return value.get(key)
    return value[key] if isinstance(value, list) and isinstance(key, int) and key < len(value) else None


def _called(path: FieldPath) -> str:
    """Return a path as a name: acc.x, gyr[0]."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path).removeprefix(".")


def _is_number(value: Any) -> bool:
    try:
        float(value)
    except (TypeError, ValueError, OverflowError):
        return False
    return True
