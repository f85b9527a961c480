"""MATLAB files of version 5 to 7: the arrays of real numbers, and those that stand in structs.

Read here, from the format's description (MathWorks, "MAT-File Format"), and not by scipy, which looks an
element's type up in a table without asking whether the table goes so far: a damaged file ended the process.
Texts, cells, objects, sparse and complex arrays hold no samples and are passed over.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

HEADER = 128
"""Bytes before the first element; the last two say the byte order."""

DEEPEST = 5
"""Structs in one another that are looked into."""

_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Types of an element's numbers. An array of doubles may be stored in a smaller type."""

_MATRIX, _COMPRESSED = 14, 15
_STRUCT, _NUMBERS, _COMPLEX = 2, range(6, 16), 0x800
"""Classes of arrays, and a flag beside the class."""

Arrays = dict[str, dict[str, NDArray[Any]]]
"""By the struct's path ("" outside all), then by name; without axes of length 1."""


class TooLongError(ValueError):
    """The arrays take more memory than they may."""


def read_matlab(content: bytes, most_bytes: int) -> Arrays:
    """Return the arrays of a file. Raises ValueError, struct.error or zlib.error where it is damaged.

    Raises TooLongError where its arrays, unpacked, take more than most_bytes.
    """
    order = "<" if content[HEADER - 2 : HEADER] == b"IM" else ">"
    groups: Arrays = {}
    for kind, data in _unpacked(_elements(memoryview(content)[HEADER:], order), order, most_bytes):
        if kind != _MATRIX:
            raise ValueError(f"an element of type {kind} where an array must stand")
        _gather("", *_array(data, order, 0), groups)
    return groups


def _unpacked(
    elements: Iterator[tuple[int, memoryview]], order: str, most_bytes: int
) -> Iterator[tuple[int, memoryview]]:
    """Yield elements, and in place of a compressed one those in it. Raises TooLongError."""
    for kind, stored in elements:
        packed = kind == _COMPRESSED
        data = memoryview(zlib.decompressobj().decompress(stored, most_bytes + 1)) if packed else stored
        most_bytes -= len(data)
        if most_bytes < 0:
            raise TooLongError
        yield from _elements(data, order) if packed else [(kind, data)]


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Yield type and bytes of each element."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(order + "II", data, at)
        first, after = at + 8, at + 8 + size
        if kind >> 16:  # a small element: its type and size share four bytes, four more are its own
            kind, size, first, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        elif kind != _COMPRESSED:
            after += -size % 8
        if first + size > min(after, len(data)):
            raise ValueError("an element is longer than what holds it")
        yield kind, data[first : first + size]
        at = after


def _array(data: memoryview, order: str, depth: int) -> tuple[str, Any]:
    """Return name and content of an array: numbers, a dictionary of a struct's fields, None for any other."""
    if not data:
        return "", None  # a field without a value
    parts = _elements(data, order)
    (_, flags), (_, lengths), (_, name) = islice(parts, 3)
    (described,) = struct.unpack_from(order + "I", flags)
    shape = np.frombuffer(lengths, order + "u4").tolist()
    label, kind = bytes(name).decode("latin-1"), described & 0xFF
    if kind in _NUMBERS and not described & _COMPLEX:
        stored, values = next(parts)
        if stored not in _STORED:
            raise ValueError(f"numbers of type {stored}, which there is not")
        return label, np.frombuffer(values, order + _STORED[stored]).reshape(shape, order="F").squeeze()
    if kind == _STRUCT and set(shape) == {1} and depth < DEEPEST:
        (_, longest), (_, names) = islice(parts, 2)
        (width,) = struct.unpack_from(order + "i", longest)
        cut = (bytes(names[at : at + width]) for at in range(0, len(names), width))
        fields = [field.split(b"\0")[0].decode("latin-1") for field in cut]
        contents = [_array(held, order, depth + 1)[1] for _, held in parts]
        return label, dict(zip(fields, contents, strict=True))
    return label, None


def _gather(path: str, name: str, content: Any, groups: Arrays) -> None:
    """Sort an array, or those of a struct, under the struct that it stands in."""
    if isinstance(content, dict):
        for field, inner in content.items():
            _gather(f"{path}/{name}".strip("/"), field, inner, groups)
    elif content is not None:
        groups.setdefault(path, {})[name] = content
