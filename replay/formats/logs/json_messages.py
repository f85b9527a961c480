"""JSON messages that hold several samples and one stamp, as devices send them by radio.

`{"Timestamp": 40, "ArrayAcc": [{"x": 0.1, "y": 0.2, "z": 9.8}, ...]}`: the samples of a message are spread
evenly from its stamp to the next one's. Which of a message's samples its stamp means does not matter.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.formats.recognition.names.axes import find_axes
from stillcal.replay.formats.recognition.names.containers import qualified
from stillcal.replay.formats.recognition.names.stamps import find_stamps
from stillcal.replay.formats.tables.json_records import Records

Opened = Callable[[], Iterator[Records]]
Path = tuple[str, ...]
"""Keys that lead to a value in a message."""

_AXES = {"x", "y", "z"}
_DEEPEST = 4
_LOOKED_AT = 200
"""Messages by which it is seen which fields hold samples, and how long one takes."""

_LONGEST_STEP = 1.5
"""Relative to the usual one, a step from sample to sample is this long at most; else messages are lost."""


@dataclass(frozen=True, slots=True)
class _Lists:
    """Fields of one kind of message that hold as many samples each, and the field of their stamp.

    around: other fields, which all samples share. step: from sample to sample, in the stamp's unit.
    """

    fields: tuple[Path, ...]
    stamp: Path
    around: tuple[Path, ...]
    step: float


def one_by_one(opened: Opened) -> list[tuple[Opened, str]]:
    """Return what opens records of one sample each, of each kind of message, and what is said of it.

    One that is unchanged, with nothing said, where records hold one sample each already.
    """
    messages = (message for block in opened() for message in block.values)
    kinds = _kinds(list(islice(messages, _LOOKED_AT)))
    said = "several samples in a message ({}), spread evenly from its stamp to the next one's"
    return [
        (partial(_spread, opened, kind), said.format(", ".join(map(".".join, kind.fields)))) for kind in kinds
    ] or [(opened, "")]


def _kinds(messages: Sequence[Any]) -> list[_Lists]:
    """Return which fields of messages hold samples; none where no accelerometer is among them."""
    found: dict[tuple[Path, ...], tuple[Any, list[float], list[int]]] = {}
    sensors: set[Sensor] = set()
    for message in messages:
        for fields, count in _lists(message):
            stamp = _stamp(message, fields[0])
            if stamp is None:
                continue
            sensors |= {axes.sensor for axes in find_axes(_names(message, fields))}
            _, stamps, counts = found.setdefault(fields, (message, [], []))
            stamps.append(float(_at(message, stamp)))
            counts.append(count)
    if Sensor.ACCELEROMETER not in sensors:
        return []
    kinds = []
    for fields, (message, stamps, counts) in found.items():
        step = float(np.median(np.diff(stamps) / counts[:-1])) if len(stamps) > 1 else 0.0
        around = _shared(message)
        kinds.append(_Lists(fields, _stamp(message, fields[0]) or (), around, step))
    return kinds


def _shared(message: Any) -> tuple[Path, ...]:
    """Return the fields of a message that are no lists, and no times."""
    fields = {".".join(path): path for path, value in _inner(message) if isinstance(value, str | int | float)}
    times = {str(stamps.column) for stamps in find_stamps(list(fields))}
    return tuple(path for name, path in fields.items() if name not in times)


def _lists(message: Any) -> list[tuple[tuple[Path, ...], int]]:
    """Return the fields of a message that hold samples, those of one count together, and the count."""
    together: defaultdict[int, list[Path]] = defaultdict(list)
    for path, value in _inner(message):
        if isinstance(value, list) and len(value) > 1 and _holds_samples(value):
            together[len(value)].append(path)
    return [
        (tuple(fields), count) for count, fields in together.items() if find_axes(_names(message, fields))
    ]


def _holds_samples(values: list[Any]) -> bool:
    """Whether a list holds vectors, or an axis of them, and no times of its own."""
    if isinstance(values[0], dict):
        keys = {str(key).lower() for key in values[0]}
        return keys >= _AXES and not find_stamps(list(keys))
    if isinstance(values[0], list):
        return len(values[0]) == len(_AXES) and all(map(_is_number, values[0]))
    return _is_number(values[0])


def _names(message: Any, fields: Sequence[Path]) -> list[str]:
    """Return what the columns are called that lists of samples make."""
    names: list[str] = []
    for field in fields:
        called, first = ".".join(field), _at(message, field)[0]
        inner = first if isinstance(first, dict) else "xyz" if isinstance(first, list) else ()
        names += [f"{called}.{axis}" for axis in inner] or [called]
    return qualified(names, "")


def _stamp(message: Any, field: Path) -> Path | None:
    """Return the field of numbers that is the stamp of a list of samples: beside it, or around."""
    numbers = {".".join(path): path for path, value in _inner(message) if _is_number(value)}
    stamps = [numbers[str(stamps.column)] for stamps in find_stamps(list(numbers))]
    around = [path for path in stamps if path[:-1] == field[: len(path) - 1]]
    return max(around, key=len, default=None)


def _spread(opened: Opened, kind: _Lists) -> Iterator[Records]:
    """Yield records of one sample each. The last message takes as long as is usual."""
    waiting: tuple[Any, int] | None = None
    bytes_read = 0
    for block in opened():
        rows: list[tuple[Any, int]] = []
        bytes_read = block.bytes_read
        for message, line in zip(block.values, block.lines.tolist(), strict=True):
            if not _is_number(_at(message, kind.stamp)) or _at(message, kind.fields[0]) is None:
                continue
            if waiting is not None:
                rows += _samples(kind, *waiting, float(_at(message, kind.stamp)))
            waiting = (message, line)
        if rows:
            yield _records(rows, bytes_read)
    if waiting is not None:
        yield _records(_samples(kind, *waiting), bytes_read)


def _records(rows: Sequence[tuple[Any, int]], bytes_read: int) -> Records:
    return Records([row for row, _ in rows], np.array([line for _, line in rows], dtype=np.int64), bytes_read)


def _samples(kind: _Lists, message: Any, line: int, after: float | None = None) -> list[tuple[Any, int]]:
    """Return a message's samples as records with their line. after: the next message's stamp."""
    lists = [_at(message, field) or [] for field in kind.fields]
    count, stamp = max(map(len, lists)), float(_at(message, kind.stamp))
    step = kind.step
    if after is not None and count and 0 < after - stamp <= _LONGEST_STEP * kind.step * count:
        step = (after - stamp) / count
    rows = []
    for i in range(count):
        row: dict[str, Any] = {}
        for field in kind.around:
            _put(row, field, _at(message, field))
        _put(row, kind.stamp, stamp + i * step)
        for field, values in zip(kind.fields, lists, strict=True):
            if i < len(values):
                _put(row, field, values[i])
        rows.append((row, line))
    return rows


def _inner(value: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield what is within objects by its path; lists are not looked into."""
    if isinstance(value, dict) and len(path) < _DEEPEST:
        for key, inner in value.items():
            yield from _inner(inner, (*path, key))
    else:
        yield path, value


def _at(message: Any, path: Path) -> Any:
    for key in path:
        message = message.get(key) if isinstance(message, dict) else None
    return message


def _put(row: dict[str, Any], path: Path, value: Any) -> None:
    for key in path[:-1]:
        row = row.setdefault(key, {})
    row[path[-1]] = value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
