"""Blocks of samples as a frame's payload: bit for bit, as float32, or as counts of 16 bits.

Pure functions on bytes and arrays; numbers are little-endian, docs/wire.md has the layout.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams import limits
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.wire.messages import SEQUENCE_MASK

HEADER = struct.Struct("<BBHI")
"""Kind, form, number of samples, sequence number."""

COMPACT = struct.Struct("<qIf")
"""First stamp in ns, unit of the time steps in ns, SI value of one count."""

NANOSECOND = 1e-9
KINDS = {Sensor.ACCELEROMETER: 0x01, Sensor.GYROSCOPE: 0x02}
SENSORS = {kind: sensor for sensor, kind in KINDS.items()}
HAS_TEMPERATURE, HAS_ARRIVAL = 0x10, 0x20
MAX_STEP = 0xFFFF
"""Longest time step between samples of a compact block, in ticks: it is sent in 16 bits."""


class Coding(IntEnum):
    """How samples are written: bit for bit (32 bytes each), float32 (14), or counts of 16 bits (8)."""

    EXACT = 0
    FLOAT = 1
    COUNTS = 2


@dataclass(frozen=True, slots=True)
class BlockStyle:
    """Settings of sample blocks. size: most samples in a block.

    unit: SI value of one count (COUNTS only; what does not fit into 16 bits saturates). tick_ns: unit of
    the time steps of the compact codings; a step beyond 65,535 of them begins another block.
    """

    coding: Coding
    size: int
    unit: float
    tick_ns: int


def sample_payloads(samples: Samples, sequence: int, style: BlockStyle) -> Iterator[bytes]:
    """Yield payloads that hold `samples`, the first of which is number `sequence` of its stream."""
    edges = set(range(0, len(samples), style.size))
    if style.coding is not Coding.EXACT:
        long = np.diff(samples.t) >= MAX_STEP * style.tick_ns * NANOSECOND
        edges |= set((np.flatnonzero(long) + 1).tolist())
    starts = sorted(edges)
    for start, stop in zip(starts, [*starts[1:], len(samples)], strict=True):
        part = samples[start:stop]
        form = style.coding | _flags(part)
        head = HEADER.pack(KINDS[part.sensor], form, len(part), (sequence + start) & SEQUENCE_MASK)
        yield head + (_exact(part) if style.coding is Coding.EXACT else _compact(part, style))


def _flags(part: Samples) -> int:
    has_temperature = HAS_TEMPERATURE if part.temperature is not None else 0
    return has_temperature | (HAS_ARRIVAL if part.t_arrival is not None else 0)


def _exact(part: Samples) -> bytes:
    columns = (part.t, part.xyz, part.temperature, part.t_arrival)
    return b"".join(np.asarray(c, "<f8").tobytes() for c in columns if c is not None)


def _compact(part: Samples, style: BlockStyle) -> bytes:
    unit, tick_ns = style.unit, style.tick_ns
    if style.coding is Coding.FLOAT:
        unit, values = 1.0, part.xyz.astype("<f4")
    else:
        counts = np.rint(part.xyz / float(np.float32(unit)))
        values = np.clip(counts, -32_768, 32_767).astype("<i2")
    ticks = np.rint((part.t - part.t[0]) / (tick_ns * NANOSECOND))
    steps: NDArray[np.uint16] = np.diff(ticks, prepend=0.0).astype("<u2")
    head = COMPACT.pack(round(float(part.t[0]) / NANOSECOND), tick_ns, unit)
    others = (part.temperature, part.t_arrival)
    tail = b"".join(
        c.astype(w).tobytes() for c, w in zip(others, ("<f4", "<f8"), strict=True) if c is not None
    )
    return head + steps.tobytes() + values.tobytes() + tail


class _Columns:
    """Columns of one payload, taken off one after the other. Raises ValueError beyond its end."""

    def __init__(self, payload: bytes) -> None:
        self._payload, self._at = payload, HEADER.size

    def head(self) -> tuple[int, int, float]:
        if len(self._payload) < self._at + COMPACT.size:
            raise ValueError("too short for a compact block")
        t0, tick, unit = COMPACT.unpack_from(self._payload, self._at)
        self._at += COMPACT.size
        return t0, tick, unit

    def take(self, kind: str, count: int) -> NDArray[Any]:
        column = np.frombuffer(self._payload, kind, count, self._at) if count else np.empty(0, kind)
        self._at += column.nbytes
        return column

    def finish(self) -> None:
        if self._at != len(self._payload):
            raise ValueError(f"{len(self._payload)} bytes, expected {self._at}")


def parse_samples(sensor: Sensor, form: int, n: int, payload: bytes) -> Samples:
    """Read the samples after a payload's header, without those that cannot be used. Raises ValueError."""
    coding = Coding(form & 0x0F)
    columns = _Columns(payload)
    if coding is Coding.EXACT:
        t, xyz = columns.take("<f8", n), columns.take("<f8", 3 * n)
    else:
        t, xyz = _compact_columns(columns, coding, n)
    narrow = "<f8" if coding is Coding.EXACT else "<f4"
    temperature = columns.take(narrow, n) if form & HAS_TEMPERATURE else None
    arrival = columns.take("<f8", n) if form & HAS_ARRIVAL else None
    columns.finish()
    return usable(sensor, t, xyz.reshape(n, 3), temperature, arrival)


def _compact_columns(columns: _Columns, coding: Coding, n: int) -> tuple[Array, Array]:
    t0, tick, unit = columns.head()
    steps = columns.take("<u2", n).cumsum(dtype=np.float64)
    values = columns.take("<f4" if coding is Coding.FLOAT else "<i2", 3 * n).astype(np.float64)
    with np.errstate(all="ignore"):
        return (t0 + steps * tick) * NANOSECOND, values * unit


def usable(
    sensor: Sensor, t: Array, xyz: Array, temperature: Array | None = None, arrival: Array | None = None
) -> Samples:
    """Build samples (t (n,) s, xyz (n, 3) SI) from untrusted columns without the rows that cannot be used.

    Those are rows that are not finite or beyond their limits, and rows whose stamp is before that of an
    earlier row. A temperature that cannot be one is NaN, and so may an arrival stamp be.
    """
    good = limits.usable(t, xyz)
    if good.all() and (t[1:] >= t[:-1]).all():
        rows = None
    else:
        rows = np.flatnonzero(good)
        rows = rows[t[rows] >= np.maximum.accumulate(t[rows])]
    if temperature is not None:
        celsius = temperature.astype(np.float64)
        temperature = np.where(limits.plausible_temperature(celsius), celsius, np.nan)
    columns = (t, xyz, temperature, arrival)
    usable_columns = [None if c is None else frozen(c if rows is None else c[rows]) for c in columns]
    assert usable_columns[0] is not None and usable_columns[1] is not None
    return Samples(sensor, usable_columns[0], usable_columns[1], usable_columns[2], usable_columns[3])
