"""Messages as `rostopic echo` and `ros2 topic echo` print them, YAML with a line `---` between, as records.

Only what they print is read: a key and its number or text in a line, or a key with what stands further to the
right below it. Lists, which hold covariances, are passed over, also where they go on in further lines.
"""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.sources import UNREADABLE, Source, damaged, unpacked
from stillcal.replay.formats.tables.json_records import Records

_BLOCK_MESSAGES = 1024
_LISTS = ("- ", "[")
_LIST_GOES_ON = (",", "]")
"""How a further line of a list ends."""


def echoed_records(source: Source) -> Iterator[Records]:
    """Yield the messages of a file block by block. Raises TraceError naming the line that is none of YAML."""
    with source.open() as file:
        messages = _messages(source, unpacked(file))
        while block := list(islice(messages, _BLOCK_MESSAGES)):
            lines, values = zip(*block, strict=True)
            yield Records(list(values), np.array(lines, dtype=np.int64), file.tell())


def _messages(source: Source, lines: Iterator[bytes]) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield each message and the number of its first line."""
    message: dict[str, Any] = {}
    first, open_fields = 1, [(-1, message)]
    try:
        for number, line in enumerate(lines, 1):
            text = line.removeprefix(codecs.BOM_UTF8).strip()
            if text == b"---":
                if message:
                    yield first, message
                message = {}
                first, open_fields = number + 1, [(-1, message)]
            elif text:
                _add(open_fields, len(line) - len(line.lstrip()), text.decode("utf-8", "replace"))
    except ValueError:
        what = "neither a field of a message, as rostopic echo prints it, nor ---"
        raise TraceError(source.path, what, "correct or delete that message", number) from None
    except UNREADABLE as error:
        raise damaged(source.path, error) from None
    if message:
        yield first, message


def _add(open_fields: list[tuple[int, dict[str, Any]]], indent: int, text: str) -> None:
    """Add the field of a line to the last of the fields that are open and stand further to the left.

    open_fields: each with its indent. Raises ValueError where the line is no field.
    """
    key, colon, value = text.partition(":")
    if text.startswith(_LISTS) or (not colon and text.endswith(_LIST_GOES_ON)):
        return
    if not colon:
        raise ValueError
    while open_fields[-1][0] >= indent:
        open_fields.pop()
    value = value.strip()
    if value.startswith(_LISTS):
        return
    held: float | str | dict[str, Any] = _scalar(value) if value else {}
    open_fields[-1][1][key] = held
    if isinstance(held, dict):
        open_fields.append((indent, held))


def _scalar(value: str) -> float | str:
    try:
        return float(value.lower().replace(".nan", "nan").replace(".inf", "inf"))  # YAML: .nan, -.inf
    except ValueError:
        return value.strip("'\"")
