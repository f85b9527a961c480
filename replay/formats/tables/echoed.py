"""Messages as `rostopic echo` and `ros2 topic echo` print them, YAML with a line `---` between, as records.

Only what they print is read: a key and its number or text in a line, or a key with what stands further to the
right below it. Lists, which hold covariances, are passed over, also where they go on in further lines.

Left out and counted are lines that are no fields, since the tools print warnings among the messages ("A
message was lost!!!"), and messages without all of the numbers that most messages have: the last one where
printing was stopped, or one that a warning was printed into.
"""

from __future__ import annotations

import codecs
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np

from stillcal.replay.formats.sources import UNREADABLE, Source, damaged, unpacked
from stillcal.replay.formats.tables.json_records import Records

_BLOCK_MESSAGES = 1024
_END = "---"
_ITEM = "- "
_LIST_GOES_ON = (",", "]")
"""How a further line of a list ends."""

_FIELD = re.compile(r"([a-z]\w*):(?:\s+(.*))?")
"""A field as ROS names them: small letters and no blanks, unlike "WARNING:" and "total count:"."""


@dataclass(slots=True)
class _Message:
    """line: its first, from 1. lines: of them. ended: whether `---` is behind it."""

    line: int
    lines: int = 0
    ended: bool = False
    fields: dict[str, Any] = field(default_factory=dict)


class Echoed:
    """The messages of a file. notes: what the latest reading left out, a line each, complete after it."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self.notes: list[str] = []

    def records(self) -> Iterator[Records]:
        """Yield the whole messages block by block. Raises TraceError where the file cannot be unpacked."""
        self.notes.clear()
        no_fields: list[int] = []
        not_whole: list[int] = []
        usual: frozenset[str] = frozenset()
        with self._source.open() as file:
            messages = self._messages(unpacked(file), no_fields)
            while block := list(islice(messages, _BLOCK_MESSAGES)):
                numbers = [frozenset(_numbers(message.fields)) for message in block]
                usual = usual or Counter(numbers).most_common(1)[0][0]
                whole = [m for m, own in zip(block, numbers, strict=True) if own >= usual]
                left_out = [m for m, own in zip(block, numbers, strict=True) if not own >= usual]
                if left_out and not left_out[-1].ended:
                    cut = left_out.pop().lines
                    self.notes.append(f"ends within a message: its {_some(cut, 'line')} left out")
                not_whole += [message.line for message in left_out]
                if whole:
                    lines = np.array([message.line for message in whole], dtype=np.int64)
                    yield Records([message.fields for message in whole], lines, file.tell())
        for places, what, fault in (
            (no_fields, "line", "no part of a message"),
            (not_whole, "message", "not whole"),
        ):
            if places:
                said = f"{_some(len(places), what)} {fault} (first in line {places[0]}): left out"
                self.notes.append(said)

    def _messages(self, lines: Iterator[bytes], no_fields: list[int]) -> Iterator[_Message]:
        """Yield each message. no_fields: gets the numbers of the lines that are no part of any.

        A last line without its line end may lack a part of its number, and is not read.
        """
        message = _Message(1)
        open_fields = [(-1, message.fields)]
        text, cut = "", False
        try:
            for number, line in enumerate(lines, 1):
                text = line.removeprefix(codecs.BOM_UTF8).strip().decode("utf-8", "replace")
                if text == _END:
                    message.ended = True
                    if message.fields:
                        yield message
                    message = _Message(number + 1)
                    open_fields = [(-1, message.fields)]
                elif text:
                    message.lines += 1
                    cut = not line.endswith(b"\n")
                    indent = len(line) - len(line.lstrip())
                    if not cut and not _add(open_fields, indent, text):
                        no_fields.append(number)
        except UNREADABLE as error:
            raise damaged(self._source.path, error) from None
        if message.fields or cut:
            yield message


def _some(count: int, what: str) -> str:
    return f"{count} {what} is" if count == 1 else f"{count} {what}s are"


def _add(open_fields: list[tuple[int, dict[str, Any]]], indent: int, text: str) -> bool:
    """Add the field of a line to the last of the fields that are open and stand further to the left.

    open_fields: each with its indent. Returns False where the line is no part of a message.
    """
    found = _FIELD.fullmatch(text)
    if found is None:
        return text.startswith(_ITEM) or text.endswith(_LIST_GOES_ON)
    key, value = found[1], found[2] or ""
    while open_fields[-1][0] >= indent:
        open_fields.pop()
    if value.startswith((_ITEM, "[")):
        return True
    held: float | str | dict[str, Any] = _scalar(value) if value else {}
    open_fields[-1][1][key] = held
    if isinstance(held, dict):
        open_fields.append((indent, held))
    return True


def _numbers(fields: dict[str, Any], within: str = "") -> Iterator[str]:
    """Yield the paths of the numbers in a message."""
    for key, value in fields.items():
        if isinstance(value, float):
            yield f"{within}.{key}"
        elif isinstance(value, dict):
            yield from _numbers(value, f"{within}.{key}")


def _scalar(value: str) -> float | str:
    try:
        return float(value.lower().replace(".nan", "nan").replace(".inf", "inf"))  # YAML: .nan, -.inf
    except ValueError:
        return value.strip("'\"")
