"""The rows of one sensor in a table that holds a row for each sensor and time, as a table of their own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

from stillcal.replay.formats.tables.table import Block, Table

MOST_TEXTS = 64
"""Different texts of a column beyond which it does not name sensors."""


class TableWithTexts(Table, Protocol):
    """A table some of whose columns hold texts."""

    def texts(self, place: int) -> list[str] | None:
        """Return the different texts of a column; None where it holds numbers, or more than MOST_TEXTS.

        Reads the table through. Raises TraceError where it cannot be read.
        """
        ...


class ChosenRows:
    """The rows of a table that hold a text at a place. names: how its columns are called here."""

    def __init__(self, table: Table, place: int, text: str, names: Sequence[str]) -> None:
        self._table = table
        self._key = [(place, text)]
        self.names: list[str] | None = list(names)
        self.first_row = table.first_row
        self.opening = table.opening
        self.width = table.width
        self.header_line = table.header_line
        self.size_bytes = table.size_bytes
        self.skipped_rows = 0  # the others are rows of other sensors

    @property
    def path(self) -> Path:
        """What messages call the table."""
        return self._table.path

    @property
    def bytes_read(self) -> int:
        """Bytes read by the latest reading."""
        return self._table.bytes_read

    @property
    def notes(self) -> list[str]:
        """What the latest reading passed over, a line each."""
        return self._table.notes

    def blocks(self, places: Sequence[int], key: Sequence[tuple[int, str]] = ()) -> Iterator[Block]:
        """Yield the columns at `places` of the sensor's rows, none of the blocks empty."""
        for block in self._table.blocks(places, [*self._key, *key]):
            if len(block.lines):
                yield block

    def read_dates(self, place: int) -> None:
        """Read the column at `place` as dates, s since 1970."""
        self._table.read_dates(place)

    def column_name(self, place: int) -> str:
        """Return how to call the column at `place` in a message."""
        return self._table.column_name(place)
