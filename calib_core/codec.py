"""Records to bytes and back: msgspec with arrays as nested lists, floats kept to the last bit.

Used for the engine's saved state and for stored calibrations; both are plain dataclasses. JSON, which knows
no number that is not finite, and the digest of a record in it, are here too.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec
import numpy as np

from stillcal.calib_core.arrays import frozen

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


def jsonable(record: Any) -> Any:
    """Turn a record into dicts, lists and numbers for JSON; what is not finite becomes None (unknown)."""
    return _finite(plain(record))


def canonical(value: Any) -> bytes:
    """Encode plain values in one way only: `json.dumps(value, sort_keys=True, separators=(",", ":"))`."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def digest(value: Any) -> str:
    """Return the SHA-256 of the canonical JSON of plain values, in hex."""
    return hashlib.sha256(canonical(value)).hexdigest()


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


def floats(value: Any) -> Any:
    """Make every number a float, so that 2 given for 2.0 is the same calibration as read back."""
    if isinstance(value, int):
        return float(value)
    if isinstance(value, Mapping):
        return {key: floats(item) for key, item in value.items()}
    return [floats(item) for item in value] if isinstance(value, list) else value
