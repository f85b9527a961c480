"""Records to bytes and back, by msgspec, with arrays as nested lists and floats kept to the last bit.

It serves the engine's saved state and stored calibrations, which are plain records. It also turns records
into JSON, which has no infinite numbers and no NaN, and computes the digest of a record.
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
    """Return a record as dicts, lists, strings and numbers."""
    return msgspec.to_builtins(record, enc_hook=_encode)


def from_plain(value: Any, kind: type[T]) -> T:
    """Build a `kind` from dicts, lists, strings and numbers. Raises msgspec.ValidationError on a misfit."""
    return msgspec.convert(value, type=kind, dec_hook=_decode)


def jsonable(record: Any) -> Any:
    """Return a record as values for JSON, where numbers that are not finite become None (unknown)."""
    return _finite(plain(record))


def canonical(value: Any) -> bytes:
    """Encode plain values in the one canonical way: sorted keys, no spaces, finite numbers only."""
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
    """Return plain values with every number as a float, so that 2 and 2.0 give the same digest."""
    if isinstance(value, int):
        return float(value)
    if isinstance(value, Mapping):
        return {key: floats(item) for key, item in value.items()}
    return [floats(item) for item in value] if isinstance(value, list) else value
