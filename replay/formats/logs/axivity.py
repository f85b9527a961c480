"""Axivity CWA: the recordings of the AX3 and AX6 loggers.

Layout by openmovementproject/openmovement, Docs/ax3/cwa.h: a header of 1024 bytes, then blocks of 512 with
their own check sum. A block tells the time of one of its samples; between these the times are interpolated,
which follows the logger's real rate. Blocks whose check sum is wrong are left out and named.
"""

from __future__ import annotations

import calendar
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.columns import ColumnMap, SensorMap, TemperatureMap, TimeMap
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.log import BOTH, Log, LoggedSensor, Part
from stillcal.replay.formats.sources import Source, unpacked_copy
from stillcal.replay.formats.tables.numbers import NumberTable

_HEADER_BYTES, _BLOCK_BYTES = 1024, 512
_BLOCKS_AT_A_TIME, _BLOCKS_READ = 2048, 128
_MOST_BYTES = 2 << 30
"""An AX6 has 1 GiB of memory, an AX3 0.5."""

_NAMED = 12
"""Damaged blocks that are named one by one."""

_SLOWER, _FASTER = 0.8, 1.25
"""Measured rate over the nominal one between which two blocks follow each other without a pause."""

_BLOCK = np.dtype(
    [
        ("header", "S2"),
        ("length", "<u2"),
        ("fraction", "<u2"),
        ("session", "<u4"),
        ("sequence", "<u4"),
        ("stamp", "<u4"),
        ("light", "<u2"),
        ("temperature", "<u2"),
        ("events", "u1"),
        ("battery", "u1"),
        ("rate", "u1"),
        ("axes", "u1"),
        ("offset", "<i2"),
        ("count", "<u2"),
        ("data", "u1", 480),
        ("checksum", "<u2"),
    ]
)


@dataclass(frozen=True, slots=True, eq=False)
class _Index:
    """What the blocks say, of those that can be used. numbers: (n,) in the file, counted from 0.

    first: (n,) how many samples come before. at, t: (n,) the sample whose time is known, counted over the
    whole file, and the time, s. stretch: (n,) blocks of one number follow each other without a pause.
    """

    numbers: NDArray[np.int64]
    first: NDArray[np.int64]
    at: Array
    t: Array
    stretch: NDArray[np.int64]
    rate_hz: float


def open_axivity(source: Source) -> Log:
    """Open a CWA file. Raises TraceError where it holds no block that can be used."""
    stored = unpacked_copy(source)
    blocks = _blocks(stored)
    sums = _check_sums(blocks)
    usable = _usable(blocks, sums)
    damaged = np.flatnonzero(~usable & (blocks["header"] != b"\xff\xff"))
    if not usable.any():
        raise TraceError(source.path, "no block of this CWA file is whole", "copy it from the logger again")
    six = int(blocks["axes"][usable.argmax()]) >> 4 >= 6
    exchanged = _exchanged(blocks, usable) if six else np.zeros_like(usable)
    if exchanged[usable].all():
        raise TraceError(
            source.path, "no block of this CWA file shows gravity", "copy it from the logger again"
        )
    index = _index(blocks, np.flatnonzero(usable & ~exchanged))
    first = blocks[index.numbers[:1]]
    table = _table(source.path, stored, blocks, index)
    column_map = ColumnMap(
        time=TimeMap(column="t"),
        accelerometer=SensorMap(columns=("ax", "ay", "az"), unit="g"),
        gyroscope=SensorMap(columns=("gx", "gy", "gz"), unit="deg/s") if six else None,
        temperature=TemperatureMap(column="temperature"),
        repeats="keep",
    )
    sensors = BOTH if six else (Sensor.ACCELEROMETER,)
    about = f"{'AX6' if six else 'AX3'}, {index.rate_hz:g} Hz"
    sensor = LoggedSensor.of("imu", [Part(table, column_map, sensors)], about)
    lines = [*_cut_short(stored.size), *_damage(blocks, damaged), *_exchange(exchanged)]
    notes = [f"{short_name(source.path)}: {line}" for line in lines]
    return Log(source.path, "Axivity CWA", [sensor], notes, source.local, _claims(first))


def _blocks(stored: Source) -> NDArray[np.void]:
    """Map the file's whole blocks into memory."""
    assert stored.local is not None
    if stored.size > _MOST_BYTES:
        what = f"{stored.size / (1 << 30):.3g} GiB are more than such a logger stores"
        raise TraceError(stored.path, what, "copy it from the logger again")
    count = (stored.size - _HEADER_BYTES) // _BLOCK_BYTES
    if count < 1:
        raise TraceError(stored.path, "a CWA file without a block of data", "copy it from the logger again")
    return np.memmap(stored.local, dtype=_BLOCK, mode="r", offset=_HEADER_BYTES, shape=(count,))


def _cut_short(size: int) -> Iterator[str]:
    """Say where a file ends within a block: its copying was broken off."""
    left = (size - _HEADER_BYTES) % _BLOCK_BYTES
    if left:
        yield f"the file is cut short: its last block has {left} of {_BLOCK_BYTES} bytes and is left out"


def _check_sums(blocks: NDArray[np.void]) -> NDArray[np.uint16]:
    """Return the sum of each block's 16-bit words; zero where the block is whole."""
    sums = np.empty(len(blocks), dtype=np.uint16)
    for first in range(0, len(blocks), _BLOCKS_AT_A_TIME):
        part = blocks[first : first + _BLOCKS_AT_A_TIME]
        words = np.frombuffer(part.tobytes(), dtype="<u2").reshape(len(part), -1)
        sums[first : first + len(part)] = words.sum(axis=1, dtype=np.uint16)
    return sums


def _usable(blocks: NDArray[np.void], sums: NDArray[np.uint16]) -> NDArray[np.bool_]:
    packing, axes = blocks["axes"] & 0x0F, blocks["axes"] >> 4
    width = np.where(packing == 0, 4, 2 * axes)
    usable: NDArray[np.bool_] = (
        (blocks["header"] == b"AX")
        & (sums == 0)
        & (blocks["length"] == _BLOCK_BYTES - 4)
        & np.isin(axes, (3, 6, 9))
        & np.isin(packing, (0, 2))
        & (blocks["count"] > 0)
        & (blocks["count"].astype(np.int64) * width <= 480)
        & (_seconds(blocks) > 0)
    )
    first = np.flatnonzero(usable)[:1]
    return usable & (blocks["axes"] == blocks["axes"][first]) if first.size else usable


def _damage(blocks: NDArray[np.void], damaged: NDArray[np.intp]) -> Iterator[str]:
    if damaged.size:
        named = " ".join(map(str, damaged[:_NAMED])) + (" ..." if damaged.size > _NAMED else "")
        share = f"{damaged.size} of {len(blocks)}"
        yield f"{share} blocks are damaged and were left out (wrong check sum or layout): {named}"


def _exchanged(blocks: NDArray[np.void], usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the blocks in which the gyroscope's places may hold the accelerometer's values, (n,).

    Such a stretch stands at the start of the AX6 file that this was written with. A block at rest shows
    gravity in one of the two places; those that move are doubted until one at rest shows the right order.
    """
    axes = int(blocks["axes"][usable.argmax()]) >> 4
    seen = np.zeros(len(blocks), dtype=np.int8)  # 1: gravity where it belongs, -1: in the other place
    for first in range(0, len(blocks), _BLOCKS_AT_A_TIME):
        part = blocks[first : first + _BLOCKS_AT_A_TIME]
        counts = np.frombuffer(part["data"].tobytes(), dtype="<i2").reshape(len(part), -1)
        values = counts[:, : counts.shape[1] // axes * axes].reshape(len(part), -1, axes)[:, :10]
        mean, scatter = values.mean(axis=1), values.std(axis=1).max(axis=1)
        one_g = (1 << (8 + (part["light"] >> 13).astype(np.int64))).astype(np.float64)
        places = [np.linalg.norm(mean[:, p : p + 3], axis=1) / one_g for p in (3, 0)]
        right, wrong = (np.abs(norm - 1) < 0.1 for norm in places)
        still = scatter < 0.03 * one_g
        seen[first : first + len(part)] = np.where(
            still & right & ~wrong, 1, np.where(still & wrong & ~right, -1, 0)
        )
    seen[~usable] = 0
    shown = np.flatnonzero(seen)
    if not shown.size or (seen[shown] > 0).all():
        return np.zeros(len(blocks), dtype=np.bool_)
    place = np.arange(len(blocks))
    before = np.maximum(np.searchsorted(shown, place, side="right") - 1, 0)
    after = np.minimum(np.searchsorted(shown, place, side="left"), shown.size - 1)
    return np.asarray((seen[shown[before]] < 0) | (seen[shown[after]] < 0))


def _exchange(exchanged: NDArray[np.bool_]) -> Iterator[str]:
    if exchanged.any():
        numbers = np.flatnonzero(exchanged)
        where = f"{numbers.size} blocks, between {numbers[0]} and {numbers[-1]}"
        yield f"acceleration and rate are exchanged in {where}; they were left out"


def _seconds(blocks: NDArray[np.void]) -> NDArray[np.int64]:
    """Return the whole seconds of the blocks' time stamps since 1970, as if UTC; 0 where there is none."""
    stamp = blocks["stamp"].astype(np.int64)
    year, month = 2000 + (stamp >> 26), np.clip((stamp >> 22) & 15, 1, 12)
    months = {
        int(key): calendar.timegm((int(key) // 12, int(key) % 12 + 1, 1, 0, 0, 0))
        for key in np.unique(year * 12 + month - 1)
    }
    keys = np.array(sorted(months))
    starts = np.array([months[int(key)] for key in keys])[np.searchsorted(keys, year * 12 + month - 1)]
    day, hours, minutes, seconds = (stamp >> 17) & 31, (stamp >> 12) & 31, (stamp >> 6) & 63, stamp & 63
    total: NDArray[np.int64] = starts + 86400 * (day - 1) + 3600 * hours + 60 * minutes + seconds
    return np.where(stamp == 0, 0, total)


def _index(blocks: NDArray[np.void], numbers: NDArray[np.intp]) -> _Index:
    chosen = blocks[numbers]
    rate = 3200.0 / (1 << (15 - int(chosen["rate"][0] & 0x0F)))
    count = chosen["count"].astype(np.int64)
    first = np.cumsum(count) - count
    has_fraction = (chosen["fraction"] & 0x8000) != 0
    fraction = np.where(has_fraction, (chosen["fraction"] & 0x7FFF) / 32768.0, 0.0)
    # The offset of such a block was moved to whole seconds for older readers; it is moved back (cwa.h).
    at: Array = np.asarray(first + chosen["offset"] + np.floor(fraction * rate), dtype=np.float64)
    t: Array = np.asarray(_seconds(chosen) + fraction, dtype=np.float64)
    step, passed = np.diff(at), np.diff(t)
    with np.errstate(divide="ignore", invalid="ignore"):
        measured = step / passed / rate
    follows = (np.diff(chosen["sequence"].astype(np.int64)) == 1) & (step > 0)
    follows &= (measured > _SLOWER) & (measured < _FASTER)
    stretch = np.concatenate([[0], np.cumsum(~follows)])
    return _Index(numbers.astype(np.int64), first, at, t, stretch, rate)


def _times(index: _Index, blocks: range, counts: NDArray[np.int64]) -> Array:
    """Return the times, s, of all samples of blocks of one stretch, by the known ones in it and beside it."""
    near = slice(max(0, blocks.start - 1), blocks.stop + 1)
    same = index.stretch[near] == index.stretch[blocks.start]
    at, t = index.at[near][same], index.t[near][same]
    wanted = index.first[blocks.start] + np.arange(int(counts.sum()))
    slopes = np.diff(t) / np.diff(at) if len(t) > 1 else np.array([1.0 / index.rate_hz])
    times: Array = np.interp(wanted, at, t)
    before, after = wanted < at[0], wanted > at[-1]
    times[before] = t[0] + (wanted[before] - at[0]) * slopes[0]
    times[after] = t[-1] + (wanted[after] - at[-1]) * slopes[-1]
    return times


def _table(path: Path, stored: Source, blocks: NDArray[np.void], index: _Index) -> NumberTable:
    names = ["t", "temperature", "ax", "ay", "az", "gx", "gy", "gz"]
    bounds = [0, *(np.flatnonzero(np.diff(index.stretch)) + 1).tolist(), len(index.numbers)]

    def rows(places: Sequence[int]) -> Iterator[tuple[Array, float]]:
        last = -np.inf
        for start, stop in pairwise(bounds):
            for begin in range(start, stop, _BLOCKS_READ):
                chosen = range(begin, min(begin + _BLOCKS_READ, stop))
                part = blocks[index.numbers[chosen.start : chosen.stop]]
                values = _decoded(part)
                values[:, 0] = _times(index, chosen, part["count"].astype(np.int64))
                # After a pause the first stretch, extrapolated, may reach over the second's beginning.
                values[:, 0] = np.maximum(np.maximum.accumulate(values[:, 0]), last)
                last = float(values[-1, 0])
                yield values[:, list(places)], chosen.stop / len(index.numbers)

    return NumberTable(path, names, rows, stored.size)


def _decoded(blocks: NDArray[np.void]) -> Array:
    """Return the samples of blocks, (n, 8): 0 for t, temperature degC, acceleration g, rate deg/s or 0."""
    axes, packing = int(blocks["axes"][0]) >> 4, int(blocks["axes"][0]) & 0x0F
    counts = blocks["count"].astype(np.int64)
    values = np.zeros((int(counts.sum()), 8))
    # 75/256 degC a count from -50 degC: the MCP9700's 10 mV/K and 0.5 V, by a 10-bit converter (cwa.h).
    values[:, 1] = np.repeat((blocks["temperature"] & 0x3FF) * 75.0 / 256.0 - 50.0, counts)
    data = np.ascontiguousarray(blocks["data"])
    if packing == 0:
        words = data.view("<u4")
        words = words[np.arange(words.shape[1]) < counts[:, None]]
        exponent = (words >> 30).astype(np.int64)
        for axis in range(3):
            bits = ((words >> (10 * axis)) & 0x3FF).astype(np.int64)
            values[:, 2 + axis] = (np.where(bits > 511, bits - 1024, bits) << exponent) / 256.0
        return values
    cells = data.view("<i2")
    cells = cells[:, : cells.shape[1] // axes * axes].reshape(len(blocks), -1, axes)
    cells = cells[np.arange(cells.shape[1]) < counts[:, None]]
    force_lsb, rate_lsb = (np.repeat(lsb, counts)[:, None] for lsb in _lsb(blocks))
    force = 0 if axes == 3 else 3
    values[:, 2:5] = cells[:, force : force + 3] * force_lsb
    if axes > 3:
        values[:, 5:8] = cells[:, :3] * rate_lsb
    return values


def _lsb(blocks: NDArray[np.void]) -> tuple[Array, Array]:
    """Return the values of one count in each block, (n,): g, and deg/s (range 8000/2^n over 2^15 counts)."""
    light = blocks["light"].astype(np.int64)
    return 1.0 / (1 << (8 + (light >> 13))), 8000.0 / (1 << ((light >> 10) & 7)) / 32768.0


def _claims(first: NDArray[np.void]) -> Claims:
    """Return what the settings in the first block, (1,), say of the sensors."""
    rate, axes = int(first["rate"][0]), int(first["axes"][0])
    force_lsb, rate_lsb = (float(lsb[0]) for lsb in _lsb(first))
    gyroscope, packed = axes >> 4 >= 6, axes & 0x0F == 0
    return Claims(
        nominal_rate_hz=3200.0 / (1 << (15 - (rate & 0x0F))),
        accel_range=(16 >> (rate >> 6)) * STANDARD,
        accel_lsb=(1 / 256.0 if packed else force_lsb) * STANDARD,
        gyro_range=float(np.deg2rad(rate_lsb * 32768)) if gyroscope else None,
        gyro_lsb=float(np.deg2rad(rate_lsb)) if gyroscope else None,
    )
