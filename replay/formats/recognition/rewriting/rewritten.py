"""Text whose lines hold readings, but not as cells: it is copied into cells, line by line.

`ax: 0.1 ay: 0.2` and `ax=0.1,ay=0.2` have a name before each number, as sketches print them;
`[0.1, 0.2, 9.8]` is one cell of three numbers, as pandas writes arrays; `10:00:00.020 -> 0.1,0.2` has a
serial monitor's stamp; `0.1,0.2;` ends its row with another mark; `"1,234.5"` and `1 234,5` have marks
between thousands, as spreadsheets write them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from stillcal.replay.formats.recognition.header import delimiter_of, split_as
from stillcal.replay.formats.recognition.names.axes import find_axes
from stillcal.replay.formats.recognition.names.units import is_unit
from stillcal.replay.formats.recognition.rewriting.sentences import sentences
from stillcal.replay.formats.sources import Source
from stillcal.replay.formats.tables.cells import is_number
from stillcal.replay.formats.tables.dates import is_date
from stillcal.replay.formats.tables.plain import copied_by_lines, plain_text
from stillcal.replay.formats.tables.text import quoted_cells, text_head

_LOOKED_AT = 50
"""Lines by which it is seen whether a text is written so; what a board prints when it starts is shorter."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?nan|[-+]?inf"
_LABELLED = re.compile(rf"(?<!\d\d:\d\d)(?<!\b\d\d)\s*[:=]\s*({_NUMBER})(?![\w.:])", re.IGNORECASE)
_BETWEEN = re.compile(r"[\s,;|]+")
_STAMPED = re.compile(r"^\s*(\d\d:\d\d:\d\d[.,]\d+)\s+->\s*")
_LIST = re.compile(rf'"?[\[(]\s*((?:{_NUMBER})(?:(?:\s*,\s*|\s+)(?:{_NUMBER}))+)\s*[\])]"?', re.IGNORECASE)
_AXIS = re.compile(r"(.*?)\s*\b([xyz])(\s*\[.*\])?", re.IGNORECASE)
"""A name that ends with an axis, and its unit."""

_IN_A_LIST = re.compile(r"[\s,]+")
_GROUP_MARKS = ((",", r"\."), (r"\.", ","), ("['\u2019 ]|\xc2?\xa0|\xe2\x80\xaf|\u202f", "[.,]"))
"""Marks between thousands, with the decimal marks beside them; blanks that do not break, also as bytes."""

_LIKE_A_NUMBER = re.compile(r"(?!\s*\d+[-/.]\d\d?[-/.]\d)[^:]*\d\s*$")
"""A cell that may be a number with marks in it, and is neither a date nor a time of day."""

_FEWEST = 3
"""Numbers of a line: three axes."""

Rewrite = Callable[[str], str]


@dataclass(frozen=True, slots=True)
class Rewritten:
    """A text in cells. names: of its columns, where no line holds them. first: lines before its first row.

    said: what was passed over.
    """

    source: Source
    names: list[str] | None = None
    first: int = 0
    said: str = ""


def rewritten(source: Source) -> Rewritten:
    """Return a text in cells: itself, where it is so already. Raises TraceError where it cannot be copied."""
    plain = plain_text(source)
    head = [line.rstrip("\r") for line in text_head(plain).split("\n")]
    kinds = sentences(head)
    if kinds is not None:
        copy = copied_by_lines(plain, lambda line: kinds.kept(line.rstrip("\r")))
        return Rewritten(copy, kinds.names, said=kinds.said)
    steps: list[Rewrite] = []
    looked_at = [(_without_stamps, _LOOKED_AT), (_without_ends, _LOOKED_AT), (_without_groups, -1)]
    for find, until in looked_at:
        step = find(head[:until])
        if step is not None:
            steps.append(step)
            head = [step(line) for line in head]
    labelled = [(i, found[0]) for i, line in enumerate(head[:_LOOKED_AT]) if (found := _labelled(line))]
    alike = [(i, names) for i, names in labelled if names == labelled[-1][1]]
    first, names = alike[0] if len(alike) > 1 else (0, None)  # one line of them says how the board is set
    in_turn = _in_turn(labelled)
    if in_turn is not None:
        first, names = in_turn[0][0], _joined_names([kind for _, kind in in_turn])
        steps.append(_joined_lines([kind for _, kind in in_turn]))
    elif names is not None:
        steps.append(_cells_of_labelled)
    else:
        lists = _without_lists(head)
        steps += [lists] if lists else []
    if not steps:
        return Rewritten(plain)

    def line_in_cells(line: str) -> str:
        for step in steps:
            line = step(line)
        return line

    return Rewritten(copied_by_lines(plain, line_in_cells), names, first)


def _without_stamps(lines: Sequence[str]) -> Rewrite | None:
    """Return what makes a serial monitor's stamp a cell; None where no line has one."""
    stamped = next((line for line in lines if _STAMPED.match(line)), None)
    if stamped is None:
        return None
    rest = _STAMPED.sub("", stamped)
    mark = next((mark for mark in (";", "\t", ",") if mark in rest), " ")
    return lambda line: _STAMPED.sub(rf"\g<1>{mark}", line)


def _without_ends(lines: Sequence[str]) -> Rewrite | None:
    """Return what takes off a semicolon that ends rows of cells with commas; None where none does."""
    filled = [line for line in lines if line.strip()]
    ended = filled and all(line.rstrip().endswith(";") and line.count(";") == 1 for line in filled)
    return (lambda line: line.rstrip().removesuffix(";")) if ended else None


def _without_groups(lines: Sequence[str]) -> Rewrite | None:
    """Return what takes out the marks between thousands; None where no cell has any.

    A mark stands between thousands where all numbers that have it have it there, and it cannot be the decimal
    mark: a number of the same column has that one, or a number has it twice. A comma that also stands between
    cells is no decimal mark, so that there any column shows which one is.
    """
    filled = list(filter(str.strip, lines))
    delimiter = delimiter_of(filled[-1]) if filled else " "
    if delimiter == " ":
        return None
    text = "\n".join(filled)
    first = _columns_of_numbers([quoted_cells(line, delimiter) for line in filled[:_LOOKED_AT]])
    marks = [
        (mark, decimal)
        for mark, decimal in _GROUP_MARKS
        if re.search(mark, text) and (mark != delimiter or '"' in text) and _groups(mark, decimal, first)
    ]
    if not marks:
        return None  # seen from the first lines: to look at all of them takes longest of the recognition
    columns = _columns_of_numbers([quoted_cells(line, delimiter) for line in filled])
    for mark, decimal in marks:
        there = any(re.search(mark, cell) for column in columns for cell in column)
        if there and _groups(mark, decimal, columns) and _is_shown(mark, decimal, columns, delimiter):
            return partial(_without_marks, delimiter, re.compile(mark), _grouped(mark, decimal))
    return None


def _grouped(mark: str, decimal: str) -> re.Pattern[str]:
    """Return what a number looks like that has a mark between its thousands."""
    return re.compile(rf"[-+]?[1-9]\d{{0,2}}((?:{mark})\d{{3}})+(?:(?:{decimal})\d+)?")


def _groups(mark: str, decimal: str, columns: Sequence[Sequence[str]]) -> bool:
    """Whether all numbers in columns that have a mark have it between thousands."""
    grouped = _grouped(mark, decimal)
    return all(grouped.fullmatch(cell) for column in columns for cell in column if re.search(mark, cell))


def _is_shown(mark: str, decimal: str, columns: Sequence[Sequence[str]], delimiter: str) -> bool:
    """Whether numbers in columns show that a mark cannot be the decimal one; decimal: what is that then."""
    marked = [column for column in columns if any(re.search(mark, cell) for cell in column)]
    twice = any(len(re.findall(mark, cell)) > 1 for column in marked for cell in column)
    beside = columns if mark == delimiter else marked
    return (
        twice
        or len(mark) > 2
        or any(re.search(rf"\d{decimal}\d", cell) for column in beside for cell in column)
    )


def _columns_of_numbers(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return the numbers of each column in rows that have three or more; dates and times of day are none."""
    numbers = [{i: c.strip() for i, c in enumerate(row) if _LIKE_A_NUMBER.match(c)} for row in rows]
    columns: dict[int, list[str]] = {}
    for row in numbers:
        for place, cell in row.items() if len(row) >= _FEWEST else ():
            columns.setdefault(place, []).append(cell)
    return list(columns.values())


def _without_marks(delimiter: str, mark: re.Pattern[str], grouped: re.Pattern[str], line: str) -> str:
    cells = (mark.sub("", c) if grouped.fullmatch(c.strip()) else c for c in quoted_cells(line, delimiter))
    return delimiter.join(f'"{cell}"' if delimiter in cell else cell for cell in cells)


def _labelled(line: str) -> tuple[list[str], list[str]] | None:
    """Return the names and the numbers of a line that labels each of its numbers, None of another line.

    A unit behind a number belongs to its name; where one word stands between two numbers, it is the name of
    the second. Numbers and dates before the first name are times.
    """
    parts = _LABELLED.split(line)
    labels, numbers = parts[0::2], parts[1::2]
    if len(numbers) < _FEWEST:
        return None
    words = [[word.removesuffix(":") for word in _BETWEEN.split(label) if word] for label in labels]
    before = [word for word in words[0] if is_date(word.encode()) or is_number(word.encode())]
    names = [" ".join(words[0][len(before) :])]
    for place, between in enumerate(words[1:], 1):
        unit = between.pop(0) if len(between) > (place < len(numbers)) and is_unit(between[0]) else None
        names[-1] += f" [{unit}]" if unit else ""
        names.append(" ".join(between))
    if names.pop() or not all(names):
        return None
    return ["time"] * len(before[:1]) + _titled(names), before[:1] + numbers


def _titled(names: Sequence[str]) -> list[str]:
    """Return names, those of axes alone with what the first axis is called: `Accel X`, `Y`, `Z`.

    A unit behind the third is that of all three.
    """
    found: list[str] = []
    title = ""
    for name in names:
        axis = _AXIS.fullmatch(name)
        title = title if axis and not axis[1] else axis[1] if axis else ""
        found.append(f"{title} {name}" if title and axis and not axis[1] else name)
        if len(found) >= _FEWEST and axis and axis[3] and not axis[1]:
            found[-_FEWEST:-1] = [before + axis[3] for before in found[-_FEWEST:-1]]
    return found


def _in_turn(labelled: Sequence[tuple[int, list[str]]]) -> list[tuple[int, list[str]]] | None:
    """Return the kinds of lines that make one reading, with the first place of each; None of one kind."""
    kinds: list[tuple[int, list[str]]] = []
    for place, names in labelled:
        if all(names != other for _, other in kinds):
            kinds.append((place, names))
    order = [names for _, names in kinds]
    turns = [names == order[i % len(order)] for i, (_, names) in enumerate(labelled)]
    return kinds if len(kinds) > 1 and len(labelled) >= 2 * len(kinds) and all(turns) else None


def _joined_names(kinds: Sequence[list[str]]) -> list[str]:
    """Return the names of readings that stand in several lines; the time is that of the first line."""
    first, *others = kinds
    return [*first, *(name for names in others for name in names if name != "time")]


def _joined_lines(kinds: Sequence[list[str]]) -> Rewrite:
    """Return what joins the lines of a reading, as cells in the place of the last; others are emptied."""
    waiting: list[list[str]] = []

    def joined(line: str) -> str:
        found = _labelled(line)
        if found is None:
            return ""
        names, numbers = found
        if names == kinds[0]:
            waiting.clear()
        if len(waiting) >= len(kinds) or names != kinds[len(waiting)]:
            return line
        waiting.append(numbers[1:] if waiting and names[0] == "time" else numbers)
        return ",".join(cell for cells in waiting for cell in cells) if len(waiting) == len(kinds) else ""

    return joined


def _cells_of_labelled(line: str) -> str:
    found = _labelled(line)
    return line if found is None else ",".join(found[1])


def _without_lists(lines: Sequence[str]) -> Rewrite | None:
    """Return what makes cells of lists; None where no cell is one, or the names tell the axes without."""
    place = next((i for i, line in enumerate(lines[:_LOOKED_AT]) if _LIST.search(line)), None)
    if place is None or place == 0:
        return None
    sizes = [len(_IN_A_LIST.split(found[1])) for found in _LIST.finditer(lines[place])]
    row = _LIST.sub("\a", lines[place])
    mark = max((";", "\t", ","), key=row.count)
    header = lines[place - 1]
    names, cells = split_as(mark * _FEWEST, header), row.split(mark)
    if len(names) != len(cells) or find_axes(names):
        return None
    of_lists = iter(sizes)
    longer = [
        f"{name}[{i}]" if size else name
        for name, size in zip(
            names, (next(of_lists) if cell.strip() == "\a" else 0 for cell in cells), strict=True
        )
        for i in range(size or 1)
    ]
    headers = {header.encode(encoding, "replace").decode("latin-1") for encoding in ("utf-8", "latin-1")}
    new_header = mark.join(longer).encode().decode("latin-1")

    def in_cells(line: str) -> str:
        if line.rstrip("\r") in headers:
            return new_header
        return _LIST.sub(lambda found: mark.join(_IN_A_LIST.split(found[1].strip())), line)

    return in_cells
