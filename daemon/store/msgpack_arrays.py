"""Encode arrays as MessagePack straight from memory: the same bytes as from lists of numbers.

A state holds minutes of the gyroscope. As Python numbers they take seven times the memory, at every save.
https://github.com/msgpack/msgpack/blob/master/spec.md
"""

from __future__ import annotations

import struct
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.codec import packed

FLOAT64 = 0xCB
_CELL = np.dtype([("tag", "u1"), ("value", ">f8")])


def encoded(record: object) -> bytes:
    """Encode a record as `packed` does, to the byte."""
    return msgspec.msgpack.encode(record, enc_hook=_encode)


def _encode(value: Any) -> Any:
    long = isinstance(value, np.ndarray) and value.dtype == np.float64 and value.ndim in {1, 2}
    return msgspec.Raw(_numbers(value) if long else packed(value))


def _numbers(values: Array) -> bytes:
    """Return an array of (n,) or (n, k) numbers."""
    if values.ndim == 1:
        return _head(len(values)) + _rows(values[:, None]).tobytes()
    return _head(len(values)) + _rows(values, _head(values.shape[1])).tobytes()


def _rows(values: Array, head: bytes = b"") -> np.ndarray:
    """Return `head` and the numbers of each of n rows as one record of an array (n,)."""
    layout = np.dtype([("head", "u1", (len(head),)), ("cells", _CELL, (values.shape[1],))])
    rows = np.empty(len(values), layout)
    rows["head"] = list(head)
    rows["cells"]["tag"] = FLOAT64
    rows["cells"]["value"] = values
    return rows


def _head(length: int) -> bytes:
    """Return what begins an array of so many values."""
    if length < 16:
        return bytes((0x90 | length,))
    return struct.pack(">BH", 0xDC, length) if length < 65_536 else struct.pack(">BI", 0xDD, length)
