"""Where the header of a text table is: many loggers write comments or facts about themselves before it."""

from __future__ import annotations

from collections.abc import Sequence

from stillcal.replay.formats.tables.cells import is_date, is_number
from stillcal.replay.formats.tables.text import uncommented

DELIMITERS = (";", "\t", "|", ",")
"""What may stand between cells, besides blanks; a comma may also be a decimal mark."""

_FEWEST = 4
"""Numbers in a row: a time and three axes."""


def delimiter_of(row: str) -> str:
    """Return what stands between the cells of a row of numbers, a blank where nothing else does."""
    several = (mark for mark in DELIMITERS if row.count(mark) >= _FEWEST - 1)
    return next(several, " ")


def cells_of(row: str) -> list[str]:
    """Return the cells of a row of numbers."""
    delimiter = delimiter_of(row)
    return row.split() if delimiter == " " else row.split(delimiter)


def lines_before_header(lines: Sequence[str]) -> int:
    """Return how many lines stand before the header: the last line before the numbers begin, if it fits them.

    0 where the first line is the header, and where no line is one.
    """
    first = next((i for i, line in enumerate(lines) if _is_row(line)), 0)
    before = [i for i in range(first) if lines[i].strip()]
    if len(before) < 2:
        return 0
    delimiter = delimiter_of(lines[first])
    header = uncommented(lines[before[-1]])
    width = len(header.split() if delimiter == " " else header.split(delimiter))
    return before[-1] if width == len(cells_of(lines[first])) else 0


def _is_row(line: str) -> bool:
    """Whether at least four cells of a line, and half of them, are numbers; dates and empty cells count."""
    cells = [cell.strip().strip('"').encode() for cell in cells_of(line)]
    numbers = sum(is_number(cell.replace(b",", b".")) or is_date(cell) for cell in cells)
    return numbers >= max(_FEWEST, len(cells) / 2)
