"""Text tables, plain or gzipped, as blocks of numbers.

A block of whole lines is brought to one delimiter, the wanted cells are cut out of it and read as one flat
JSON array (cells.py): msgspec's number reader measured twice as fast as numpy.loadtxt and gives the same
bits. Only where that fails are the rows read one by one, to name the faulty one. Long files are read by
Arrow where that is installed (compiled.py). What columns mean is not known here.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.columns import ColumnMap
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.sources import UNREADABLE, Source, damaged, source_of, unpacked
from stillcal.replay.formats.tables.cells import (
    add_texts,
    blanks_to_commas,
    cell_ends,
    cut_out,
    holding,
    is_number,
    line_ends,
    read_numbers,
)
from stillcal.replay.formats.tables.chosen import MOST_TEXTS
from stillcal.replay.formats.tables.compiled import compiled_reader
from stillcal.replay.formats.tables.dates import Dates, NotADateError, is_date
from stillcal.replay.formats.tables.plain import plain_text
from stillcal.replay.formats.tables.table import EMPTY, OPENING_ROWS, Block

BLOCK_BYTES = 1 << 20
"""Bytes read at a time, so that memory stays flat however long the file is."""

_AT_ONCE = 4
"""Blocks given to Arrow at a time: measured 15 % faster than single ones, and as fast as more."""

_LONGEST_LINE = 1 << 24
"""Bytes in which no line ends, beyond which a file is not text."""

_MARK_OF_COMMENT = re.compile(r"^\s*(?:#+|%+|//)\s*")
_NO_TEXT = re.compile(rb"[\0-\x08\x0e-\x1f\x7f-\x9f\xfe\xff]")
"""Bytes that text in Latin-1, in which older Windows programs write units, does not have, or hardly ever."""

_BLANKS = "space"
_TEXT_REMEDY = "give the recording as plain text in UTF-8 (or gzip of it)"
_ROW_REMEDY = "correct or delete that row"
_DATE_REMEDY = 'call the column "time", or set unit = "date" in a column map (docs/formats.md)'
_CUT_REMEDY = "the recording was cut short: delete its last line, or copy it again"


class NoRowsError(TraceError):
    """A table has a header and no rows."""


class TextTable:
    """A table in a text file. Opening reads its head only; `blocks` reads it through.

    Its attributes are those of a Table. Raises TraceError.
    """

    def __init__(self, source: Source | Path, column_map: ColumnMap) -> None:
        self._source = plain_text(source if isinstance(source, Source) else source_of(source))
        self.path = path = self._source.path
        self.size_bytes = self._source.size
        self.skipped_rows = 0
        self.bytes_read = 0
        self._dates: int | None = None
        self._clock: Dates | None = None
        self._map = column_map
        head = text_head(self._source)
        lines = head.split("\n")
        self._skip = column_map.skip_lines + column_map.header + column_map.lines_after_header
        self._above = _LinesAbove([line.strip() for line in lines[: self._skip]])
        header = uncommented(lines[min(column_map.skip_lines, len(lines) - 1)])
        self.delimiter = _delimiter(header, column_map.delimiter)
        self.names = self._header(lines) if column_map.header else None
        rows = [line for line in lines[self._skip :] if line.strip()]
        if not rows:
            what = "the file holds a header only" if self.names else "the file is empty"
            kind = NoRowsError if self.names else TraceError
            raise kind(path, what, "give a recording with samples", self._skip or None)
        self.first_row = self._cells(rows[0])
        self.opening = [self._cells(row) for row in rows[:OPENING_ROWS]]
        if self.names is not None:
            self.names = _as_wide_as(self.first_row, self.names)
        self.decimal = _decimal(self.opening, "auto" if self.delimiter == "," else column_map.decimal)
        self.header_line: int | None = column_map.skip_lines + 1
        self.width = len(self.names) if self.names is not None else len(self.first_row)

    def blocks(self, places: Sequence[int], key: Sequence[tuple[int, str]] = ()) -> Iterator[Block]:
        """Yield the columns at `places`, a block of lines at a time, in the file's order.

        key: (place, text) pairs; rows that differ are left out and counted in `left_out`. Raises
        TraceError naming file and line for a row that is not numbers or not whole.
        """
        self.skipped_rows = 0
        self._above.begin()
        self._clock = None if self._dates is None else Dates(self.first_row[self._dates].encode())
        plain = not key and self._dates not in places
        compiled = compiled_reader(self.size_bytes, self.width) if plain else None
        size = BLOCK_BYTES if compiled is None else _AT_ONCE * BLOCK_BYTES
        for data, first_line, count, unfinished in self._line_blocks(size):
            text = self._normal(data)
            again = self._above.are_in(data)
            values = None if compiled is None or again else compiled(text, count, places)
            if values is not None:
                yield Block(values, np.arange(first_line, first_line + len(values)))
                continue
            ends = None if again else cell_ends(text, self.width)
            lines = np.arange(first_line, first_line + (0 if ends is None else len(ends)))
            if ends is None:
                text, lines = self._walked(data, first_line, unfinished, key)
                ends = cell_ends(text, self.width)
            if ends is None:
                continue  # blank lines only
            rows = holding(text, ends, key)
            self.skipped_rows += int(np.count_nonzero(~rows))
            yield Block(self._numbers(text, ends, rows, lines, places), lines[rows])

    def texts(self, place: int) -> list[str] | None:
        """Return the different texts of a column; None where it holds more than MOST_TEXTS."""
        known: list[str] = []
        for data, *_ in self._line_blocks(BLOCK_BYTES):
            text = self._normal(data)
            ends = cell_ends(text, self.width)
            if ends is not None:
                add_texts(text, ends, place, known, MOST_TEXTS)
            else:
                rows = map(self._cells, data.decode("utf-8", "backslashreplace").split("\n"))
                known = list(dict.fromkeys([*known, *(row[place] for row in rows if len(row) > place)]))
            if len(known) > MOST_TEXTS:
                return None
        return known

    @property
    def notes(self) -> list[str]:
        """What the latest reading passed over, a line each."""
        return self._above.notes

    def read_dates(self, place: int) -> None:
        """Read the column at `place` as dates, s since 1970."""
        self._dates = place

    def _header(self, lines: list[str]) -> list[str]:
        if len(lines) <= self._map.skip_lines or not lines[self._map.skip_lines].strip():
            raise TraceError(self.path, "the file has no header", "name the columns in its first line", 1)
        return [name.strip() for name in self._cells(uncommented(lines[self._map.skip_lines]))]

    def _cells(self, line: str) -> list[str]:
        return line.split() if self.delimiter == _BLANKS else quoted_cells(line, self.delimiter)

    def _line_blocks(self, size: int) -> Iterator[tuple[bytes, int, int, bool]]:
        """Yield (whole lines, number of the first, how many, whether the last one lacks its line end)."""
        line, tail = 1, b""
        with self._source.open() as file:
            stream = unpacked(file)
            for _ in range(self._skip):
                stream.readline()
                line += 1
            while data := self._read(stream, size):
                self.bytes_read = file.tell()
                cut = data.rfind(b"\n") + 1
                if not cut:
                    tail += data
                    if len(tail) > _LONGEST_LINE:
                        raise TraceError(self.path, "a line does not end", _TEXT_REMEDY, line)
                    continue
                text, tail = b"".join((tail, memoryview(data)[:cut])), data[cut:]
                text = text.removeprefix(codecs.BOM_UTF8) if line == 1 else text
                count = line_ends(text)
                yield text, line, count, False
                line += count
            if tail:
                yield tail + b"\n", line, 1, True

    def _read(self, stream: BinaryIO, size: int) -> bytes:
        try:
            return stream.read(size)
        except UNREADABLE as error:
            raise damaged(self.path, error) from None
        except OSError as error:
            raise TraceError(self.path, f"cannot be read ({error.strerror})", "copy it again") from None

    def _normal(self, text: bytes) -> bytes:
        """Return `text` with commas between cells, decimal points, bare line ends and no quotes."""
        if b"\r" in text:
            text = text.replace(b"\r\n", b"\n")
        if b'"' in text:
            text = text.replace(b'"', b"")
        if self.delimiter == ",":
            return text
        text = text.replace(b",", self._for_comma.encode())
        return blanks_to_commas(text) if self.delimiter == _BLANKS else text.replace(self._mark, b",")

    @property
    def _for_comma(self) -> str:
        """What replaces a comma within a cell: a blank, which no number has, where it is no decimal mark."""
        return "." if self.decimal == "," else " "

    @property
    def _mark(self) -> bytes:
        return self.delimiter.encode()

    def _walked(
        self, text: bytes, first_line: int, unfinished: bool, key: Sequence[tuple[int, str]] = ()
    ) -> tuple[bytes, NDArray[np.int64]]:
        """Return `text` without blank lines, repeated headers and quoted delimiters, and its rows' lines.

        A row without the key's texts may have any number of cells, and is left out where it has others.
        """
        rows = text.decode("utf-8", "backslashreplace").split("\n")[:-1]
        rows_kept, lines = [], []
        for number, row in enumerate(rows, first_line):
            if not row.strip() or self._above.passed_over(row.strip(), number):
                continue
            cells = self._cells(row)
            if len(cells) != self.width and not _has(cells, key):
                self.skipped_rows += 1
                continue
            if len(cells) != self.width:
                cut = unfinished and number == first_line + len(rows) - 1
                what = f"{len(cells)} cells instead of {self.width}"
                raise TraceError(self.path, what, _CUT_REMEDY if cut else _ROW_REMEDY, number)
            rows_kept.append(",".join(cell.replace(",", self._for_comma) for cell in cells) + "\n")
            lines.append(number)
        return "".join(rows_kept).encode(), np.array(lines, dtype=np.int64)

    def _numbers(
        self,
        text: bytes,
        ends: NDArray[np.intp],
        rows: NDArray[np.bool_],
        lines: NDArray[np.int64],
        places: Sequence[int],
    ) -> Array:
        """Return the cells at `places` of the chosen rows, (n, k). Raises TraceError naming a faulty row."""
        if self._dates in places:
            return self._dated(text, ends, rows, lines, places)
        columns = sorted(set(places))
        flat, filled = cut_out(text, ends, rows, columns)
        values = read_numbers(flat) if flat else np.empty(0)
        if values is None:
            raise self._accused(flat, filled, lines[rows], columns)
        table = np.full(filled.shape, EMPTY)
        table[filled] = values
        return table[:, np.searchsorted(columns, places)]

    def _dated(
        self,
        text: bytes,
        ends: NDArray[np.intp],
        rows: NDArray[np.bool_],
        lines: NDArray[np.int64],
        places: Sequence[int],
    ) -> Array:
        """Return the cells at `places` as _numbers does, one column of them dates."""
        others = [place for place in places if place != self._dates]
        numbers = iter(self._numbers(text, ends, rows, lines, others).T if others else ())
        flat, filled = cut_out(text, ends, rows, [p for p in places if p == self._dates][:1])
        seconds = self._seconds(flat, filled[:, 0], lines[rows])
        return np.column_stack([seconds if place == self._dates else next(numbers) for place in places])

    def _seconds(self, flat: bytes, filled: NDArray[np.bool_], lines: NDArray[np.int64]) -> Array:
        """Return a column of dates as s since 1970, (n,). Raises TraceError naming a faulty row."""
        name = self.column_name(self._dates or 0)
        if not filled.all():
            raise TraceError(self.path, f"{name} is empty", _ROW_REMEDY, int(lines[int(filled.argmin())]))
        cells = flat.split(b",") if flat else []
        assert self._clock is not None, "dates are read by blocks"
        try:
            return self._clock.seconds(cells)
        except NotADateError as error:
            said = cells[error.index].decode("utf-8", "backslashreplace").strip()[:40]
            what = f"{name} holds {said!r}, which is not a date"
            raise TraceError(self.path, what, _ROW_REMEDY, int(lines[error.index])) from None

    def _accused(
        self, flat: bytes, filled: NDArray[np.bool_], lines: NDArray[np.int64], columns: Sequence[int]
    ) -> TraceError:
        """Return the error that names the first cell that is not a number."""
        for i, cell in zip(np.flatnonzero(filled).tolist(), flat.split(b","), strict=True):
            if not is_number(cell):
                text = cell.decode("utf-8", "backslashreplace").strip()[:40]
                what = f"{self.column_name(columns[i % len(columns)])} holds {text!r}, which is not a number"
                remedy = _DATE_REMEDY if is_date(cell) else _ROW_REMEDY
                return TraceError(self.path, what, remedy, int(lines[i // len(columns)]))
        return TraceError(self.path, "not a table of numbers", _TEXT_REMEDY, int(lines[0]))

    def column_name(self, place: int) -> str:
        """Return how to call the column at `place` in a message."""
        return f"column {self.names[place]!r}" if self.names is not None else f"column {place}"


def quoted_cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line, of which some may be quoted, without the quotes."""
    try:
        return next(csv.reader([line.replace("\r", " ")], delimiter=delimiter), [])
    except csv.Error:
        return [line]


def _has(cells: Sequence[str], key: Sequence[tuple[int, str]]) -> bool:
    """Whether the cells of a row have the key's texts."""
    return all(place < len(cells) and cells[place] == text for place, text in key)


class _LinesAbove:
    """The lines above the first row: where logs were joined they stand between rows again. So do comments."""

    def __init__(self, lines: Sequence[str]) -> None:
        self._lines = frozenset(filter(None, lines))
        ends = [line for line in lines if line]
        self._marks = {line.encode() for line in (*ends[:1], *ends[-1:])}
        self.begin()

    def begin(self) -> None:
        """Forget what was met: the table is read from its start."""
        self._met = 0
        self._first_met = 0
        self._comments = 0

    def are_in(self, data: bytes) -> bool:
        """Whether some of them may be among the lines of `data`."""
        # Most tables have no # at all, and one byte is found some fifty times as fast as two.
        comments = b"#" in data and (b"\n#" in data or data.startswith(b"#"))
        return comments or any(mark in data for mark in self._marks)

    def passed_over(self, line: str, number: int) -> bool:
        """Whether a line is one of them; if so, it is counted."""
        if line.startswith("#") and line not in self._lines:
            self._comments += 1
            return True
        if line.removeprefix("\ufeff") not in self._lines:
            return False
        self._first_met = self._first_met or number
        self._met += 1
        return True

    @property
    def notes(self) -> list[str]:
        """What is to be said of it, a line each."""
        comments = f"lines that begin with # between the rows, passed over: {self._comments}"
        lines = "1 line repeats" if self._met == 1 else f"{self._met} lines repeat"
        said = f"{lines} the header and what stands above it (first line {self._first_met}): passed over"
        return [said] * bool(self._met) + [comments] * bool(self._comments)


def has_rows(source: Source) -> bool:
    """Whether a text table with a header in its first line has rows below it. Raises TraceError."""
    lines = text_head(plain_text(source)).split("\n")
    return any(line.strip() for line in lines[1:])


def _as_wide_as(first_row: Sequence[str], names: list[str]) -> list[str]:
    """Return names for rows that end with a delimiter where the header does not, or the other way round."""
    more = len(first_row) - len(names)
    if more == 1 and not first_row[-1].strip():
        return [*names, ""]
    return names[:-1] if more == -1 and not names[-1] else names


def uncommented(line: str) -> str:
    """Return a line without the mark of a comment (# % //), which some logs put before their header."""
    return _MARK_OF_COMMENT.sub("", line)


def text_head(source: Source) -> str:
    """Return the first characters of a text file. Raises TraceError where it is empty or no text."""
    text = _decoded(source.path, source.head())
    if not text.strip():
        raise TraceError(source.path, "the file is empty", "give a recording with samples")
    return text


def _decoded(path: Path, head: bytes) -> str:
    if b"\0" in head:
        raise TraceError(path, "is not a text file", _TEXT_REMEDY)
    whole = head[: head.rfind(b"\n") + 1] or head
    try:
        return whole.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if not _NO_TEXT.search(whole):
            return whole.decode("latin-1")
        row = head.count(b"\n", 0, error.start) + 1
        raise TraceError(path, f"byte 0x{head[error.start]:02x} is not UTF-8", _TEXT_REMEDY, row) from None


def _decimal(rows: Sequence[Sequence[str]], decimal: str) -> str:
    """Return the decimal mark, found in the cells of rows where it is "auto"."""
    if decimal != "auto":
        return decimal
    with_comma = (cell.replace(",", ".").encode() for row in rows for cell in row if "," in cell)
    return "," if any(is_number(cell) or is_date(cell) for cell in with_comma) else "."


def _delimiter(line: str, delimiter: str) -> str:
    """Return the delimiter to split `line` by; "auto" takes the one of , ; tab that stands in it most."""
    return max((",", ";", "\t"), key=line.count) if delimiter == "auto" else delimiter
