"""Records to bytes and back: msgspec with arrays as nested lists, floats kept to the last bit.

Used for the engine's saved state and for stored calibrations; both are plain dataclasses.
"""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec
import numpy as np

from stillcal.calib_core.samples import frozen

T = TypeVar("T")


def _encode(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"cannot store a {type(value).__name__}")


def _decode(kind: type, value: Any) -> Any:
    return frozen(value)


def packed(record: Any) -> bytes:
    """Encode a record as MessagePack."""
    return msgspec.msgpack.encode(record, enc_hook=_encode)


def unpacked(data: bytes, kind: type[T]) -> T:
    """Decode MessagePack into `kind`. Raises msgspec.ValidationError or DecodeError on bad bytes."""
    return msgspec.msgpack.decode(data, type=kind, dec_hook=_decode)


def plain(record: Any) -> Any:
    """Turn a record into dicts, lists and numbers fit for JSON."""
    return msgspec.to_builtins(record, enc_hook=_encode)


def from_plain(value: Any, kind: type[T]) -> T:
    """Turn dicts, lists and numbers into `kind`. Raises msgspec.ValidationError where they do not fit."""
    return msgspec.convert(value, type=kind, dec_hook=_decode)
