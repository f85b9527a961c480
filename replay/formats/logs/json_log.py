"""JSON recordings: one object a line, an array of objects, or one object that holds lists.

Lines and arrays are read in blocks, however long they are. One object is read whole: its lists of records are
a table each, called as the field that holds them; its lists of numbers are arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import count, islice
from typing import Any

import numpy as np

from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.logs.json_messages import one_by_one
from stillcal.replay.formats.recognition.names.axes import find_axes
from stillcal.replay.formats.recognition.names.containers import qualified
from stillcal.replay.formats.recognition.names.stamps import find_stamps
from stillcal.replay.formats.sources import Source
from stillcal.replay.formats.tables.json_records import Form, Records, form_of, read_document, read_records
from stillcal.replay.formats.tables.json_table import JsonTable
from stillcal.replay.formats.tables.plain import plain_text

MOST_DOCUMENT = 64 << 20
"""Bytes of one object that are read whole."""

_TIMED = ("t", "x", "y", "z")
"""Columns of an array of four that is called after a sensor."""

_FEWEST_KEYED = 10
"""Records alike from which an object's keys count them, rather than say what they are."""

_BLOCK_RECORDS = 16384
_FEWEST_RECORDS = 2
_DEEPEST = 5


def json_tables(source: Source) -> dict[str, Callable[[], JsonTable]]:
    """Return what opens each table of records, by the field that holds it; "" is the file itself.

    Nothing where the file is one object without lists of records. Raises TraceError.
    """
    plain = plain_text(source)
    form = form_of(plain)
    if form is not Form.DOCUMENT:
        return _tables(source, "", partial(read_records, plain, form))
    found: dict[str, Callable[[], JsonTable]] = {}
    for name, records in _record_lists(json_document(source)):
        found |= _tables(source, name, partial(_in_blocks, records, source.size))
    return found


def _tables(
    source: Source, name: str, records: Callable[[], Iterator[Records]]
) -> dict[str, Callable[[], JsonTable]]:
    """Return what opens the table of records, or of each kind of message among them."""
    opened = one_by_one(records)
    return {
        name if len(opened) == 1 else f"{name}#{i}": partial(
            JsonTable, source.path, of_kind, source.size, [said] if said else None
        )
        for i, (of_kind, said) in enumerate(opened)
    }


def json_document(source: Source) -> dict[str, Any]:
    """Return the one object of a file. Raises TraceError where it is too long (MOST_DOCUMENT) or damaged."""
    value = read_document(plain_text(source), MOST_DOCUMENT)
    if not isinstance(value, dict):
        raise TraceError(source.path, "is no JSON object", "write one object for each sample")
    return value


def json_arrays(document: dict[str, Any]) -> tuple[dict[str, dict[str, Any]], dict[str, float]]:
    """Return a document's arrays of numbers by group and name, and its single numbers by name."""
    by_group: dict[str, dict[str, Any]] = {}
    scalars: dict[str, float] = {}
    for path, value in _inner(document):
        group, _, name = path.rpartition("/")
        if isinstance(value, int | float) and not isinstance(value, bool):
            scalars[name] = float(value)
        array = _array(value)
        if array is not None and array.shape[1:] == (len(_TIMED),) and find_axes(qualified(_TIMED, name)):
            by_group[path] = dict(zip(_TIMED, array.T, strict=True))
        elif array is not None:
            by_group.setdefault(group, {})[name] = array
    return by_group, scalars


def _array(value: Any) -> Any:
    """Return a list of numbers, or of lists of them, as an array; None where it is none."""
    if not isinstance(value, list) or len(value) < _FEWEST_RECORDS:
        return None
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    return array if array.ndim <= 3 else None


def _record_lists(document: dict[str, Any]) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Yield the lists of records within a document, and where they are."""
    for path, value in _inner(document):
        records = isinstance(value, list) and all(isinstance(item, dict) for item in value)
        if records and len(value) >= _FEWEST_RECORDS:
            yield path, value


def _inner(value: Any, path: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield all that is within objects, with its path; objects keyed 0, 1, 2 (pandas) as lists."""
    value = _as_list(value)
    if isinstance(value, dict) and depth < _DEEPEST:
        for key, inner in _as_columns(value).items():
            yield from _inner(inner, f"{path}/{key}".removeprefix("/"), depth + 1)
    elif not isinstance(value, dict):
        yield path, value


def _as_list(value: Any) -> Any:
    """Return an object whose keys count from 0 as the list of its values, and so one of many like records."""
    if isinstance(value, dict) and value and all(k == str(i) for k, i in zip(value, count(), strict=False)):
        return list(value.values())
    return value if not isinstance(value, dict) or len(value) < _FEWEST_KEYED else _keyed(value) or value


def _keyed(records: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the records of an object with a key for each (Firebase); none where they are not alike.

    The key is the time of records that have none.
    """
    kinds = {tuple(value) if isinstance(value, dict) else () for value in records.values()}
    fields = kinds.pop() if len(kinds) == 1 else ()
    if not fields:
        return []
    if find_stamps(fields):
        return list(records.values())
    return [{_TIMED[0]: key, **value} for key, value in records.items()]


def _as_columns(document: dict[str, Any]) -> dict[str, Any]:
    """Return a table written as its columns' names and its rows by column.

    So do pandas (orient="split") and Edge Impulse's acquisition format, which has the time between rows too.
    """
    names, rows = document.get("columns"), document.get("data")
    rate: dict[str, Any] = {}
    sensors, interval = document.get("sensors"), document.get("interval_ms")
    if isinstance(sensors, list) and all(isinstance(s, dict) and "name" in s for s in sensors):
        units = [str(s.get("units", "")).replace("/", " per ") for s in sensors]  # a slash parts groups
        names = [f"{s['name']} [{unit}]" for s, unit in zip(sensors, units, strict=True)]
        rows = document.get("values")
        rate = {"samplingrate": 1e3 / interval} if isinstance(interval, int | float) and interval > 0 else {}
    if not isinstance(names, list) or not isinstance(rows, list) or not rows:
        return document
    if not all(isinstance(row, list) and len(row) == len(names) for row in rows):
        return document
    columns = {str(name): list(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}
    return columns | rate


def _in_blocks(records: list[dict[str, Any]], size_bytes: int) -> Iterator[Records]:
    """Yield records that are in memory, counted from 1 in place of lines."""
    left = iter(records)
    done = 0
    while block := list(islice(left, _BLOCK_RECORDS)):
        lines = np.arange(done + 1, done + 1 + len(block))
        done += len(block)
        yield Records(block, lines, size_bytes * done // len(records))
