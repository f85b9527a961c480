"""What a table is to the reader of samples: named columns of numbers, given block by block."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array

EMPTY = -9.87654321e22
"""Stands for an empty cell in a block of numbers: no sensor's value, and quick to read (few digits)."""


OPENING_ROWS = 200
"""Rows by whose texts it is seen what columns without names are, and whether rows are of several devices."""


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Rows of numbers: values (n, k), the wanted columns as asked for; lines (n,), their numbers from 1."""

    values: Array
    lines: NDArray[np.int64]


class Table(Protocol):
    """A table that is read from its start as often as wanted.

    names: of the columns, None without a header. width: cells in a row.
    header_line: the line of the names, None where no line holds them. first_row: its cells as text, empty
    where the cells are no text; opening: those of its first OPENING_ROWS rows. size_bytes: as stored.
    skipped_rows: left out by the latest reading.
    """

    names: list[str] | None
    width: int
    header_line: int | None
    first_row: list[str]
    opening: list[list[str]]
    size_bytes: int
    skipped_rows: int

    @property
    def path(self) -> Path:
        """What messages call it."""
        ...

    @property
    def bytes_read(self) -> int:
        """Bytes read by the latest reading."""
        ...

    @property
    def notes(self) -> list[str]:
        """What else the latest reading passed over, a line each."""
        ...

    def blocks(self, places: Sequence[int], key: Sequence[tuple[int, str]] = ()) -> Iterator[Block]:
        """Yield the columns at `places` in the table's order, of the rows that have the key's texts."""
        ...

    def read_dates(self, place: int) -> None:
        """Read the column at `place` as dates, s since 1970. Raises TraceError where the table holds none."""
        ...

    def column_name(self, place: int) -> str:
        """Return how to call the column at `place` in a message."""
        ...
