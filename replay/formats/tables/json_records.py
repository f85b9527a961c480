"""JSON text as a stream of records: one object a line, objects one after another, or one array of them.

Memory stays flat: a block holds whole records only, and what is left begins the next block. Where a record
ends is found by the depth of brackets outside strings; what its fields mean is not known here.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any, BinaryIO

import msgspec
import numpy as np
from numpy.typing import NDArray

from stillcal.replay.formats.claims import NO_JSON
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.sources import UNREADABLE, Source, damaged, unpacked
from stillcal.replay.formats.tables.cells import line_ends

_PIECE = 1 << 20
_LONGEST_RECORD = 1 << 24
"""Bytes in which no record ends, beyond which these are no records of a sensor."""

_CUT_REMEDY = "the recording was cut short: delete its last line, or copy it again"
_REMEDY = "correct or delete that record"
_BLANKS = b" \t\r\n"
_BETWEEN = _BLANKS + b","
_ESCAPED = re.compile(rb"\\.", re.DOTALL)
_BOM = b"\xef\xbb\xbf"
_DEPTH_STEP = np.zeros(256, dtype=np.int64)
for _mark, _step in (("{", 1), ("[", 1), ("}", -1), ("]", -1)):
    _DEPTH_STEP[ord(_mark)] = _step
_IS_MARK = _DEPTH_STEP != 0
_IS_MARK[ord('"')] = True
_decoder = msgspec.json.Decoder(list[Any])


class Form(Enum):
    """How a JSON file holds its records; DOCUMENT: one object, which is read whole."""

    LINES = "JSON lines"
    OBJECTS = "JSON objects"
    ARRAY = "JSON array"
    DOCUMENT = "JSON"


@dataclass(frozen=True, slots=True)
class Records:
    """Whole records, the lines (n,), from 1, in which they begin, and how many bytes are read."""

    values: list[Any]
    lines: NDArray[np.int64]
    bytes_read: int


def form_of(source: Source) -> Form:
    """Return how a JSON file holds its records, by its beginning. Raises TraceError."""
    head = source.head().removeprefix(_BOM).lstrip(_BLANKS)
    if head.startswith(b"["):
        return Form.ARRAY
    ends = _ends(head)
    if not ends.size or not head[ends[0] + 1 :].strip(_BLANKS):
        return Form.DOCUMENT
    return Form.OBJECTS if b"\n" in head[: ends[0]] else Form.LINES


def read_document(source: Source, most_bytes: int) -> Any:
    """Return the one value of a JSON file. Raises TraceError where it is longer, damaged, or no JSON."""
    with source.open() as file:
        text = _read(source, unpacked(file), most_bytes + 1)
    if len(text) > most_bytes:
        what = f"is one JSON object of more than {most_bytes >> 20} MB"
        raise TraceError(source.path, what, "write one object a line (JSON lines), which is read in blocks")
    return _one(source, text.removeprefix(_BOM), 1)


def read_records(source: Source, form: Form) -> Iterator[Records]:
    """Yield the records of a file block by block. Raises TraceError naming the line of a faulty one."""
    with source.open() as file:
        stream = unpacked(file)
        blocks = _lines(source, stream) if form is Form.LINES else _pieces(source, stream, form)
        for texts, lines in blocks:
            try:
                values = _decoder.decode(b"[" + b",".join(texts) + b"]")
            except NO_JSON:
                values = [_one(source, text, int(line)) for text, line in zip(texts, lines, strict=True)]
            yield Records(values, lines, file.tell())


def _lines(source: Source, stream: BinaryIO) -> Iterator[tuple[list[bytes], NDArray[np.int64]]]:
    """Yield the lines that are not blank, a block of them at a time, with their numbers."""
    line, tail = 1, b""
    while True:
        data = _read(source, stream, _PIECE)
        tail += data
        _refuse_endless(source, len(tail) - len(data), line)
        *lines, tail = tail.split(b"\n") if data else (tail, b"")
        filled = [i for i, text in enumerate(lines) if text.strip(_BLANKS)]
        if filled:
            texts = [lines[i].removeprefix(_BOM) for i in filled]
            yield texts, np.array(filled, dtype=np.int64) + line
        line += len(lines)
        if not data:
            return


def _pieces(source: Source, stream: BinaryIO, form: Form) -> Iterator[tuple[list[bytes], NDArray[np.int64]]]:
    """Yield the texts of whole records, a block of them at a time, and the lines where they begin."""
    line, tail = 1, b""
    begun = form is not Form.ARRAY
    while data := _read(source, stream, _PIECE):
        tail += data
        if not begun:
            opening = tail.index(b"[") + 1
            line += line_ends(tail[:opening])
            tail, begun = tail[opening:], True
        ends = _ends(tail)
        if not ends.size:
            _refuse_endless(source, len(tail), line)
            continue
        starts = np.concatenate(([0], ends[:-1] + 1))
        texts = [tail[a : b + 1] for a, b in zip(starts.tolist(), ends.tolist(), strict=True)]
        blanks = [len(text) - len(text.lstrip(_BETWEEN)) for text in texts]
        newlines = np.flatnonzero(np.frombuffer(tail, dtype=np.uint8) == ord("\n"))
        lines = line + np.searchsorted(newlines, starts + blanks)
        yield [text.lstrip(_BETWEEN) for text in texts], lines
        cut = int(ends[-1]) + 1
        line += line_ends(tail[:cut])
        tail = tail[cut:]
    rest = tail.lstrip(_BETWEEN)
    if form is Form.ARRAY and rest[:1] == b"]":
        rest = rest[1:].strip(_BLANKS)
    elif form is Form.ARRAY:
        rest = rest or b"["
    if rest:
        what = "the JSON ends within a record, or its array is not closed"
        raise TraceError(source.path, what, "copy it again, or close the array with ]", line)


def _ends(text: bytes) -> NDArray[np.intp]:
    """Return where objects and arrays end that are within no other. text: begins within none."""
    if b"\\" in text:
        text = _ESCAPED.sub(b"__", text)
    characters = np.frombuffer(text, dtype=np.uint8)
    marks = np.flatnonzero(_IS_MARK[characters])
    kinds = characters[marks]
    outside = np.cumsum(kinds == ord('"'), dtype=np.int64) % 2 == 0
    steps = np.where(outside, _DEPTH_STEP[kinds], 0)
    depth = np.cumsum(steps, dtype=np.int64)
    return np.asarray(marks[(steps < 0) & (depth == 0) & (np.minimum.accumulate(depth) >= 0)])


def _one(source: Source, text: bytes, line: int) -> Any:
    """Return one value, which may hold NaN as Python writes it. Raises TraceError where it is no JSON."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        said, at, cut = type(error).__name__, 0, False
        if isinstance(error, json.JSONDecodeError):
            said, at = error.msg, error.lineno - 1
            cut = error.pos >= len(text.rstrip()) or said.startswith("Unterminated")
        remedy = _CUT_REMEDY if cut else _REMEDY
        raise TraceError(source.path, f"is not JSON ({said})", remedy, line + at) from None


def _refuse_endless(source: Source, size: int, line: int) -> None:
    if size > _LONGEST_RECORD:
        what = f"a JSON record does not end within {_LONGEST_RECORD >> 20} MB"
        raise TraceError(source.path, what, "write one object for each sample", line)


def _read(source: Source, stream: BinaryIO, size: int) -> bytes:
    try:
        return stream.read(size)
    except UNREADABLE as error:
        raise damaged(source.path, error) from None
    except OSError as error:
        raise TraceError(source.path, f"cannot be read ({error.strerror})", "copy it again") from None
