"""Tables whose cells are numbers already: arrays in a file, or the messages of one topic of a log."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.tables.table import EMPTY, OPENING_ROWS, Block

BLOCK_ROWS = 32768
"""Rows given at a time, so that memory stays flat."""

Rows = Callable[[Sequence[int]], Iterator[tuple[Array, float]]]
"""Given the places of columns, yields (values (n, k), share of the file read so far)."""


class NumberTable:
    """A table of numbers; NaN stands for an empty cell.

    path: what messages call it. names: the columns. rows: reads it from its start. size_bytes: as stored.
    words: by their columns' names, the texts of which a column holds the places.
    """

    def __init__(
        self,
        path: Path,
        names: Sequence[str],
        rows: Rows,
        size_bytes: int,
        words: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        self.path = path
        self._words = {list(names).index(name): list(texts) for name, texts in (words or {}).items()}
        self.names: list[str] | None = list(names)
        self.width = len(names)
        self.header_line: int | None = None
        self.first_row: list[str] = []
        self.opening: list[list[str]] = []
        self.size_bytes = size_bytes
        self.bytes_read = 0
        self.skipped_rows = 0
        self.notes: list[str] = []
        self._rows = rows
        if self._words:
            self.opening = self._as_texts()
            self.first_row = next(iter(self.opening), [])

    def blocks(self, places: Sequence[int], key: Sequence[tuple[int, str]] = ()) -> Iterator[Block]:
        """Yield the columns at `places` block by block; rows are numbered from 1."""
        wanted = [(place, self._words[place].index(text)) for place, text in key]
        line = 1
        for read, share in self._read([*places, *(place for place, _ in wanted)]):
            self.bytes_read = int(share * self.size_bytes)
            lines = np.arange(line, line + len(read))
            line += len(read)
            values = read[:, : len(places)]
            if wanted:
                chosen = (read[:, len(places) :] == [code for _, code in wanted]).all(axis=1)
                values, lines = values[chosen], lines[chosen]
            whole = not values.size or not np.isnan(values.min())  # the least is NaN where one is
            yield Block(values if whole else np.where(np.isnan(values), EMPTY, values), lines)

    def texts(self, place: int) -> list[str] | None:
        """Return the different texts of a column; None where it holds numbers."""
        return self._words.get(place)

    def _as_texts(self) -> list[list[str]]:
        """Return the first rows as cells of text."""
        values, _ = next(self._read(range(self.width)), (np.empty((0, self.width)), 0.0))
        words = [self._words.get(place) for place in range(self.width)]
        return [
            [
                "" if np.isnan(value) else f"{value:.17g}" if texts is None else texts[int(value)]
                for value, texts in zip(row, words, strict=True)
            ]
            for row in values[:OPENING_ROWS].tolist()
        ]

    def read_dates(self, place: int) -> None:
        """Refuse: these tables hold numbers only."""
        what = f"{self.column_name(place)} holds numbers, no dates"
        raise TraceError(self.path, what, "give their unit: s, ms, us or ns")

    def _read(self, places: Sequence[int]) -> Iterator[tuple[Array, float]]:
        """Read the rows; what a library raises on damage becomes a TraceError."""
        try:
            yield from self._rows(places)
        except (TraceError, GeneratorExit):
            raise
        except Exception as error:  # the libraries raise whatever their parsing meets
            said = " ".join(str(error).split())[:120] or type(error).__name__
            raise TraceError(self.path, f"is damaged ({said})", "copy or write it again") from None

    def column_name(self, place: int) -> str:
        """Return how to call the column at `place` in a message."""
        return f"column {self.names[place]!r}" if self.names else f"column {place}"


def as_floats(values: ArrayLike) -> Array:
    """Return numbers as 64-bit floats; damaged ones become NaN or infinite without a warning."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(values, dtype=np.float64)


def side_by_side(columns: Sequence[Array]) -> Array:
    """Return columns (n,) as a table (n, k) in which each of them lies unbroken in memory.

    What is done column by column is then done up to ten times as fast as where rows lie unbroken.
    """
    return np.stack(columns).T


def of_arrow(column: Any, null: float = np.nan) -> Array:
    """Return an Arrow array of numbers as 64-bit floats, `null` where it has none.

    Not by Arrow's own `to_numpy` or `fill_null`: these import pandas where it is installed, half a second of
    work.
    """
    if not column.null_count:
        return as_floats(np.from_dlpack(column))
    column = column.cast("float64")
    known, values = column.buffers()
    whole, part = divmod(column.offset, 8)
    there = np.frombuffer(known, dtype=np.uint8, offset=whole)
    there = np.unpackbits(there, count=part + len(column), bitorder="little")[part:]
    numbers = np.frombuffer(values, count=len(column), offset=8 * column.offset)
    return np.where(there.view(np.bool_), numbers, null)


def in_arrays(path: Path, columns: dict[str, Array], size_bytes: int) -> NumberTable:
    """Return the table of columns (n,) that are in memory, all of one length."""
    names = list(columns)
    length = min((len(column) for column in columns.values()), default=0)

    def rows(places: Sequence[int]) -> Iterator[tuple[Array, float]]:
        for first in range(0, length, BLOCK_ROWS):
            last = min(first + BLOCK_ROWS, length)
            block = [as_floats(columns[names[place]][first:last]) for place in places]
            yield side_by_side(block), last / length

    return NumberTable(path, names, rows, size_bytes)
