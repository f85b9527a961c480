"""Where the header of a text table is: many loggers write comments or facts about themselves before it."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence

from stillcal.replay.formats.recognition.names.axes import find_axes
from stillcal.replay.formats.recognition.names.stamps import find_stamps
from stillcal.replay.formats.recognition.names.units import is_unit
from stillcal.replay.formats.tables.cells import is_number
from stillcal.replay.formats.tables.dates import is_date
from stillcal.replay.formats.tables.text import quoted_cells, uncommented

DELIMITERS = (";", "\t", "|", ",")
"""What may stand between cells, besides blanks; a comma may also be a decimal mark."""

_FEWEST = 4
"""Numbers in a row: a time and three axes. Half of its cells may be texts."""

_FEWEST_CELLS = 3
"""Numbers in a row without a time: three axes. It has no other cells."""

_RATE = re.compile(
    r"(?:rate|freq\w*|fs|odr|sampl\w*|\bat)\b[^0-9\n]{0,20}(\d+(?:\.\d+)?)\s*Hz", re.IGNORECASE
)
_OF_A_FILTER = re.compile(r"cut-?off|bandwidth|low-?pass|lpf", re.IGNORECASE)


def delimiter_of(row: str) -> str:
    """Return what stands between the cells of a row of numbers, a blank where nothing else does."""
    several = (mark for mark in DELIMITERS if row.count(mark) >= _FEWEST - 1 or _splits(row, mark))
    return next(several, " ")


def _splits(row: str, mark: str) -> bool:
    """Whether a mark splits a row into three numbers."""
    cells = row.split(mark)
    return len(cells) == _FEWEST_CELLS and all(_is_filled_number(cell.strip()) for cell in cells)


def stated_rate(lines: Sequence[str]) -> float | None:
    """Return the rate, Hz, that lines before a table say it was sampled at; None where they say several."""
    rates = {float(r) for line in lines if not _OF_A_FILTER.search(line) for r in _RATE.findall(line)}
    return rates.pop() if len(rates) == 1 and min(rates) > 0 else None


def unnamed_place(lines: Sequence[str]) -> int:
    """Return how many lines stand before a table without a header, 0 where one of them may be its header.

    Where they say its rate, none of them that names no axes is one.
    """
    first = first_row(lines) or 0
    before = [line for line in lines[:first] if line.strip()]
    named = any(find_axes(split_as(lines[first], uncommented(line))) for line in before)
    stated = len(before) > 1 and stated_rate(before) is not None
    return (
        0
        if named or not (stated or not any(_may_be_header(lines[first], line) for line in before))
        else first
    )


def described_place(lines: Sequence[str]) -> int:
    """Return how many lines stand before a table of which several describe rows of a kind each; else 0."""
    first = first_row(lines) or 0
    axes = (find_axes(split_as(lines[first], uncommented(line))) for line in lines[:first] if line.strip())
    return first if sum(map(bool, axes)) > 1 else 0


def _may_be_header(row: str, line: str) -> bool:
    """Whether a line may name the columns of a row, though it names no axes that are known."""
    plain = uncommented(line)
    names, delimiter = split_as(row, plain), delimiter_of(row)
    comment = plain != line or (line.startswith(";") and delimiter != ";")
    if _width(names) == _width(cells_of(row)):
        return not comment or bool(find_stamps(names))
    return not comment and delimiter != " " and line.count(delimiter) > 1


def cells_of(row: str) -> list[str]:
    """Return the cells of a row of numbers."""
    delimiter = delimiter_of(row)
    return row.split() if delimiter == " " else row.split(delimiter)


def header_place(lines: Sequence[str]) -> tuple[int, int]:
    """Return how many lines stand before the header, and how many between it and the numbers.

    Of the lines before the numbers that have their count of cells, the header is the one that names axes,
    else the last. What follows it and has a number is a row, though it may be a faulty one. (0, 0) where no
    line is one.
    """
    first = first_row(lines) or 0
    before = [i for i in range(first) if lines[i].strip()]
    if len(before) < 2:
        return (before[0] if before else 0), 0
    width = _width(cells_of(lines[first]))
    names = {i: split_as(lines[first], uncommented(lines[i])) for i in before}
    fitting = [i for i in before if _width(names[i]) == width]
    if not fitting:
        return 0, 0
    header = next((i for i in fitting if find_axes(names[i])), fitting[-1])
    rows = (i for i in fitting if i > header and any(map(_is_filled_number, names[i])))
    return header, next(rows, first) - header - 1


def names_in_parts(lines: Sequence[str]) -> tuple[int, list[str]] | None:
    """Return where a header begins whose names are in parts, and the names; None where it is none.

    The sensors may stand in a line above the axes, each over the first of its columns or over all, or in a
    column before each x, y, z. The header ends where the rows begin.
    """
    first = first_row(lines) or 0
    count = len(cells_of(lines[first])) if first else 0
    split = {i: split_as(lines[first], uncommented(lines[i])) for i in range(first) if lines[i].strip()}
    fitting = {i: cells for i, cells in split.items() if len(cells) == count}
    if not fitting or any(map(find_axes, fitting.values())):
        return None
    top, *below = fitting.values()
    units = [[f"[{cell}]" if is_unit(cell) else cell for cell in cells] for cells in below]
    above = _filled(top) if below else top
    names = [" ".join(filter(None, cells)) for cells in zip(above, *units, strict=True)]
    names = names if below else _after_titles(names)
    return (next(iter(fitting)), names) if find_axes(names) else None


def _filled(cells: Sequence[str]) -> list[str]:
    """Return cells, an empty one as the one before it."""
    found: list[str] = []
    for cell in cells:
        found.append(cell or (found[-1] if found else ""))
    return found


def _after_titles(names: Sequence[str]) -> list[str]:
    """Return names, those of axes that come again with the name before them that is no axis."""
    title, found = "", list[str]()
    for name in names:
        is_axis = name.lower() in {"x", "y", "z"} and list(names).count(name) > 1
        title = title if is_axis else name
        found.append(f"{title}.{name}" if is_axis else name)
    return found


def looks_like_a_table(lines: Sequence[str]) -> bool:
    """Whether lines of text hold a row of numbers, or a header that names a sensor's axes."""
    names = ([cell.strip().strip('"') for cell in re.split(r"[;,|\t ]", uncommented(line))] for line in lines)
    return first_row(lines) is not None or any(map(find_axes, names))


def _width(cells: Sequence[str]) -> int:
    """Return how many cells a row has, an empty one behind the last delimiter not counted."""
    return len(cells) - (len(cells) > 1 and not cells[-1].strip())


def split_as(row: str, line: str) -> list[str]:
    """Return a line's cells, split as those of a row of numbers are."""
    delimiter = delimiter_of(row)
    if delimiter == " ":
        return line.split()
    cells = quoted_cells(line, delimiter) if '"' in line else line.split(delimiter)
    return [cell.strip().strip('"') for cell in cells]


def with_units(names: Sequence[str], units: Sequence[str]) -> list[str]:
    """Return names with the units that a line below the header gives them."""
    plain = [re.sub(r"[\[\]()]", "", unit).strip() for unit in units]
    return [f"{name} [{unit}]" if unit else name for name, unit in zip(names, plain, strict=True)]


def first_row(lines: Sequence[str]) -> int | None:
    """Return the place of the first line that is a row, None where none is.

    A row has four numbers at least, or three if the next line is such a row too.
    """
    numbers = itertools.chain(map(_numbers_of, lines), [0])
    rows = (
        place
        for place, (own, after) in enumerate(itertools.pairwise(numbers))
        if own >= _FEWEST or min(own, after) >= _FEWEST_CELLS
    )
    return next(rows, None)


def _numbers_of(line: str) -> int:
    """Return how many cells are numbers or dates: all that are filled, or four and half of them; else 0."""
    filled = [cell for cell in map(_bare, cells_of(line)) if cell]
    numbers = sum(map(_is_value, filled))
    return numbers if numbers == len(filled) or numbers >= max(_FEWEST, len(filled) / 2) else 0


def _bare(cell: str) -> bytes:
    return cell.strip().strip('"').encode()


def _is_value(cell: bytes) -> bool:
    return is_number(cell.replace(b",", b".")) or is_date(cell)


def _is_filled_number(cell: str) -> bool:
    return bool(cell) and is_number(cell.replace(",", ".").encode())
