"""Text tables, plain or gzipped, as blocks of numbers: fast where rows are clean, exact where they are not.

A block of whole lines is read as one flat JSON array (msgspec's number reader measured about twice as
fast as numpy's); where that refuses, numpy.loadtxt reads the wanted columns; where that refuses too,
the lines are walked one by one to name the guilty one. What columns mean is not known here.
"""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import msgspec
import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.samples import Array
from stillcal.replay.formats.columns import ColumnMap
from stillcal.replay.formats.errors import TraceError

EMPTY = float(np.finfo(np.float64).min)
"""Stands for an empty cell in a block of numbers: a value no sensor has."""

BLOCK_BYTES = 1 << 20
_NEWLINE = 10
_BLANKS = "space"
_numbers = msgspec.json.Decoder(list[float])
_TEXT_REMEDY = "give the recording as plain text in UTF-8 (or gzip of it)"
_CUT_REMEDY = "the recording was cut short: delete its last line, or copy it again"


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Rows of numbers.

    values: (n, k), the wanted columns in the order asked for. lines: (n,), their line numbers in the
    file from 1. has_empty: whether some cell holds EMPTY.
    """

    values: Array
    lines: NDArray[np.int64]
    has_empty: bool = False


class TextTable:
    """A table in a text file. Opening reads its head only; `blocks` reads it through.

    names: the header's, None without one. width: cells in a row. bytes_read: of the file as stored, by
    the latest reading. left_out: rows left out by it. Raises TraceError.
    """

    def __init__(self, path: Path, column_map: ColumnMap) -> None:
        self.path = path
        self.left_out = 0
        self.bytes_read = 0
        self._map = column_map
        head = _read_head(path)
        lines = head.split("\n")
        self._skip = column_map.skip_lines + column_map.header
        self.delimiter = _delimiter(lines[min(column_map.skip_lines, len(lines) - 1)], column_map.delimiter)
        self.names = self._header(lines) if column_map.header else None
        rows = [line for line in lines[self._skip :] if line.strip()]
        if not rows:
            what = "the file holds a header only" if self.names else "the file is empty"
            raise TraceError(path, what, "give a recording with samples", self._skip or None)
        self.first_row = self._cells(rows[0])
        self.header_line = column_map.skip_lines + 1
        self.width = len(self.names) if self.names is not None else len(self.first_row)

    def blocks(
        self, places: Sequence[int], key: Sequence[tuple[int, str]] = (), size: int = BLOCK_BYTES
    ) -> Iterator[Block]:
        """Yield the columns at `places`, a block of lines at a time, in the file's order.

        key: (place, text) pairs; rows that differ are left out and counted in `left_out`. Raises
        TraceError naming file and line for a row that is not numbers or not whole.
        """
        quick = True
        self.left_out = 0
        for read, first_line, unfinished in self._line_blocks(size):
            text, lines = self._regular(read, first_line, unfinished)
            if key:
                text, lines = self._selected(text, lines, key)
            if not text:
                continue
            values = self._json(text) if quick else None
            if values is not None:
                yield Block(values[:, list(places)], lines)
                continue
            quick = False
            yield self._plain(text, lines, places)

    def _header(self, lines: list[str]) -> list[str]:
        if len(lines) <= self._map.skip_lines or not lines[self._map.skip_lines].strip():
            raise TraceError(self.path, "the file has no header", "name the columns in its first line", 1)
        return [name.strip() for name in self._cells(lines[self._map.skip_lines])]

    def _cells(self, line: str) -> list[str]:
        if self.delimiter == _BLANKS:
            return line.split()
        return next(csv.reader([line.rstrip("\r")], delimiter=self.delimiter), [])

    def _line_blocks(self, size: int) -> Iterator[tuple[bytes, int, bool]]:
        """Yield (whole lines, number of the first, whether the last one lacks its line end)."""
        line, tail = 1, b""
        with self.path.open("rb") as file:
            stream = _unpacked(file)
            for _ in range(self._skip):
                stream.readline()
                line += 1
            while read := self._read(stream, size):
                self.bytes_read = file.tell()
                cut = read.rfind(b"\n") + 1
                if not cut:
                    tail += read
                    continue
                text, tail = tail + read[:cut], read[cut:]
                yield text, line, False
                line += text.count(b"\n")
            if tail:
                yield tail + b"\n", line, True

    def _read(self, stream: io.BufferedIOBase | BinaryIO, size: int) -> bytes:
        try:
            return stream.read(size)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise _bad_gzip(self.path, error) from None
        except OSError as error:
            raise TraceError(self.path, f"cannot be read ({error.strerror})", "copy it again") from None

    def _regular(self, text: bytes, first_line: int, unfinished: bool) -> tuple[bytes, NDArray[np.int64]]:
        """Return `text` with blank lines taken out, every row as wide as the header, and line numbers."""
        if self._map.decimal == ",":
            text = text.replace(b",", b".")
        rows = _even_rows(text, self.delimiter, self.width)
        if rows is not None:
            return text, np.arange(first_line, first_line + rows, dtype=np.int64)
        return self._walked(text, first_line, unfinished)

    def _walked(self, text: bytes, first_line: int, unfinished: bool) -> tuple[bytes, NDArray[np.int64]]:
        rows = text.decode("utf-8", "backslashreplace").split("\n")[:-1]
        kept = [(first_line + i, row) for i, row in enumerate(rows) if row.strip()]
        for number, row in kept:
            found = len(self._cells(row))
            if found != self.width:
                last = unfinished and number == first_line + len(rows) - 1
                remedy = _CUT_REMEDY if last else "correct or delete that row"
                raise TraceError(self.path, f"{found} cells where {self.width} are due", remedy, number)
        joined = "".join(row + "\n" for _, row in kept)
        return joined.encode(), np.array([number for number, _ in kept], dtype=np.int64)

    def _selected(
        self, text: bytes, lines: NDArray[np.int64], key: Sequence[tuple[int, str]]
    ) -> tuple[bytes, NDArray[np.int64]]:
        """Keep the lines whose cells at the key's places hold the key's texts."""
        rows = text.splitlines(keepends=True)
        split = b"" if self.delimiter == _BLANKS else self.delimiter.encode()
        wanted = [(place, value.encode()) for place, value in key]
        kept = [
            i
            for i, row in enumerate(rows)
            if all((row.split(split or None)[place]).strip() == value for place, value in wanted)
        ]
        self.left_out += len(rows) - len(kept)
        if len(kept) == len(rows):
            return text, lines
        return b"".join(rows[i] for i in kept), lines[kept]

    def _json(self, text: bytes) -> Array | None:
        """Read all cells as JSON numbers; None where one is not."""
        if self.delimiter == _BLANKS:
            flat = b",".join(text.split())
        else:
            flat = text[:-1].replace(b"\n", b",")
            if self.delimiter != ",":
                flat = flat.replace(self.delimiter.encode(), b",")
        try:
            cells = _numbers.decode(b"[" + flat + b"]")
        except msgspec.DecodeError:
            return None
        return np.array(cells, dtype=np.float64).reshape(-1, self.width)

    def _plain(self, text: bytes, lines: NDArray[np.int64], places: Sequence[int]) -> Block:
        """Read the wanted cells with numpy, empty ones as EMPTY."""
        filled = text if self.delimiter == _BLANKS else _filled(text, self.delimiter)
        try:
            values = np.loadtxt(
                io.BytesIO(filled),
                delimiter=None if self.delimiter == _BLANKS else self.delimiter,
                comments=None,
                usecols=list(places),
                quotechar='"',
                ndmin=2,
            )
        except ValueError as error:
            raise self._accused(text, lines, places, str(error)) from None
        return Block(values, lines, has_empty=filled is not text and bool((values == EMPTY).any()))

    def _accused(self, text: bytes, lines: NDArray[np.int64], places: Sequence[int], why: str) -> TraceError:
        """Return the error that names the first row that is not numbers."""
        rows = text.decode("utf-8", "backslashreplace").split("\n")
        for number, row in zip(lines.tolist(), rows, strict=False):
            cells = self._cells(row)
            for place in places:
                cell = cells[place].strip()
                if cell and not _is_number(cell):
                    what = f"{self.column_name(place)} holds {cell[:40]!r}, which is not a number"
                    return TraceError(self.path, what, "correct or delete that row", number)
        return TraceError(self.path, f"not a table of numbers ({why})", _TEXT_REMEDY, int(lines[0]))

    def column_name(self, place: int) -> str:
        """Return how to call the column at `place` in a message."""
        return f"column {self.names[place]!r}" if self.names is not None else f"column {place}"


def _even_rows(text: bytes, delimiter: str, width: int) -> int | None:
    """Return the number of rows where every one has `width` cells (none of them blank), else None."""
    characters = np.frombuffer(text, dtype=np.uint8)
    line_end = characters == _NEWLINE
    if delimiter == _BLANKS:
        blank = characters <= ord(" ")
        begins = np.count_nonzero(~blank[:1]) + np.cumsum(blank[:-1] & ~blank[1:])
        words = np.diff(np.append(begins, begins[-1:])[np.flatnonzero(line_end) - 1], prepend=0)
        return words.size if (words == width).all() else None
    ends = line_end[(characters == ord(delimiter)) | line_end]
    if width < 2 or ends.size % width:
        return None
    rows = ends.reshape(-1, width)
    return len(rows) if rows[:, -1].all() and not rows[:, :-1].any() else None


def _unpacked(file: BinaryIO) -> io.BufferedIOBase | BinaryIO:
    """Return a reader of what `file` holds, unzipped where it is gzip."""
    zipped = file.read(2) == b"\x1f\x8b"
    file.seek(0)
    return gzip.GzipFile(fileobj=file) if zipped else file


def _read_head(path: Path, size: int = 1 << 16) -> str:
    """Return the first characters of a text file. Raises TraceError where it is none."""
    if path.is_dir():
        raise TraceError(path, "is a folder", "name a file in it")
    try:
        with path.open("rb") as file:
            head = _unpacked(file).read(size)
    except FileNotFoundError:
        raise TraceError(path, "no such file", "check the path") from None
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise _bad_gzip(path, error) from None
    except OSError as error:
        raise TraceError(path, f"cannot be opened ({error.strerror})", "check its permissions") from None
    if not head.strip():
        raise TraceError(path, "the file is empty", "give a recording with samples")
    return _decoded(path, head)


def _bad_gzip(path: Path, error: Exception) -> TraceError:
    return TraceError(path, f"gzip data cut short or damaged ({error})", "copy the recording again")


def _decoded(path: Path, head: bytes) -> str:
    if b"\0" in head:
        raise TraceError(path, "is not a text file", _TEXT_REMEDY)
    whole = head[: head.rfind(b"\n") + 1] or head
    try:
        return whole.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = head.count(b"\n", 0, error.start) + 1
        raise TraceError(path, f"byte 0x{head[error.start]:02x} is not UTF-8", _TEXT_REMEDY, row) from None


def _delimiter(line: str, delimiter: str) -> str:
    """Return the delimiter to split `line` by; "auto" takes the one of , ; tab that stands in it most."""
    return max((",", ";", "\t"), key=line.count) if delimiter == "auto" else delimiter


def _filled(text: bytes, delimiter: str) -> bytes:
    """Return `text` with EMPTY written into empty cells; the same object where there are none."""
    mark = re.escape(delimiter.encode())
    pattern = rb"(?:(?<=\n)|(?<=" + mark + rb")|^)[ ]*(?=" + mark + rb"|\r?\n)"
    filled = re.sub(pattern, repr(EMPTY).encode(), text)
    return text if len(filled) == len(text) else filled


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell
