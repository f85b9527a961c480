"""Statistics of short windows on one absolute time grid: the only thing the detector knows of samples.

A cell is the stretch [k w, (k+1) w) of the sensor's time. Its row depends on the samples inside it and on
nothing else, so however a stream is cut into blocks, the rows come out the same to the last bit. Rows are
joined (two, four, eight) for slow sensors. No thresholds here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.samples import Samples, Sensor

Index = NDArray[np.intp]
Flags = NDArray[np.bool_]

# Columns of a row. K, K_END: first cell and the one after the last. N: samples. T0, T1: first and last
# sample, s. GAP: longest pause, s. Per axis: MEAN, M2 (sum of squares about it), D2 (sum of squared steps
# from sample to sample), LSB (smallest step that was not 0; inf where none), LOW, HIGH. NORM, NORM_M2: mean
# and sum of squares of the vector's norm. TEMP: mean temperature or NaN.
K, K_END, N, T0, T1, GAP = range(6)
MEAN, M2, D2, LSB, LOW, HIGH = (slice(6 + 3 * i, 9 + 3 * i) for i in range(6))
NORM, NORM_M2, TEMP = 24, 25, 26
COLUMNS = 27

BLOCK = 8  # cells of the longest window; everything that changes with time changes between blocks

_CHUNK = 1 << 13  # samples worked on at a time: the scratch arrays then stay in cache
_SAME = 1e-6  # SI; smaller steps are conversion noise of one and the same code


def no_rows(columns: int = COLUMNS) -> Array:
    """Return a table of no rows."""
    return frozen(np.empty((0, columns)))


@dataclass(slots=True)
class Stream:
    """One sensor's samples of the cell that is not complete yet, and the rows not judged yet.

    temperature: degC, NaN where unknown; None where no sample of the cell has one.
    """

    t: Array = field(default_factory=lambda: frozen(np.empty(0)))
    xyz: Array = field(default_factory=lambda: frozen(np.empty((0, 3))))
    temperature: Array | None = None
    rows: Array = field(default_factory=no_rows)

    def reshaped(self) -> Stream:
        """Return it with the shapes that empty arrays lose on their way through a file."""
        return Stream(self.t, self.xyz.reshape(-1, 3), self.temperature, self.rows.reshape(-1, COLUMNS))


def _temperatures(stream: Stream, block: Samples) -> Array | None:
    if stream.temperature is None and block.temperature is None:
        return None
    parts = ((stream.temperature, stream.t), (block.temperature, block.t))
    return np.concatenate([np.full(t.size, np.nan) if x is None else x for x, t in parts])


def take(stream: Stream, block: Samples, window: float, *, close: bool = False) -> Stream:
    """Add a block to a stream: complete cells become rows, the rest waits. `close`: nothing waits."""
    waiting = stream.t.size > 0
    t = np.concatenate((stream.t, block.t)) if waiting else block.t
    xyz = np.concatenate((stream.xyz, block.xyz)) if waiting else block.xyz
    warmth = _temperatures(stream, block)
    if t.size == 0:
        return stream
    cells = np.floor(t / window)
    whole = t.size if close else int(np.searchsorted(cells, cells[-1], side="left"))
    if whole == 0:
        return Stream(frozen(t), frozen(xyz), None if warmth is None else frozen(warmth), stream.rows)
    norm = block.sensor is Sensor.ACCELEROMETER
    part, tail = slice(0, whole), slice(whole, None)
    warm, warm_tail = (None, None) if warmth is None else (warmth[part], frozen(warmth[tail].copy()))
    rows = reduce_cells(t[part], xyz[part], warm, cells[part], window, norm=norm)
    rows = np.concatenate((stream.rows, rows)) if stream.rows.shape[0] else rows
    return Stream(frozen(t[tail].copy()), frozen(xyz[tail].copy()), warm_tail, frozen(rows))


def reduce_cells(
    t: Array, xyz: Array, temperature: Array | None, cells: Array, window: float, *, norm: bool
) -> Array:
    """Return one row per cell that holds a sample. t: (n,) s; xyz: (n, 3); result (rows, COLUMNS).

    cells: (n,) the cell of each sample. The norm's columns stay 0 unless `norm`.
    """
    starts = np.flatnonzero(np.concatenate(([True], cells[1:] != cells[:-1])))
    counts = np.diff(starts, append=t.size)
    rows = np.zeros((starts.size, COLUMNS))
    rows[:, K] = cells[starts]
    rows[:, K_END] = cells[starts] + 1
    rows[:, N] = counts
    rows[:, T0] = t[starts]
    rows[:, T1] = t[starts + counts - 1]
    rows[:, TEMP] = np.nan if temperature is None else np.add.reduceat(temperature, starts) / counts
    room = np.empty((2, 4 * min(t.size, _CHUNK + _CHUNK // 4)))
    for first, last in _chunks(starts, t.size):
        span = slice(starts[first], starts[last] if last < starts.size else t.size)
        local, out, n = starts[first:last] - span.start, rows[first:last], counts[first:last]
        _gaps(t[span], local, window, out)
        _moments(xyz[span], local, n, out, room, norm=norm)
    return rows


def _chunks(starts: Index, size: int) -> list[tuple[int, int]]:
    """Cut the cells into runs of about _CHUNK samples; where the cuts fall changes no row."""
    targets = np.arange(0, size, _CHUNK)
    cuts = np.unique(np.concatenate((np.searchsorted(starts, targets), [0, starts.size])))
    return list(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True))


def _steps(x: Array, starts: Index) -> Array:
    """Return x[i] - x[i-1] within cells, 0 at each cell's first sample."""
    step = np.empty_like(x)
    np.subtract(x[1:], x[:-1], out=step[1:])
    step[starts] = 0.0
    return step


def _gaps(t: Array, starts: Index, window: float, out: Array) -> None:
    inner = np.maximum.reduceat(_steps(t, starts), starts)
    head = out[:, T0] - out[:, K] * window
    tail = out[:, K_END] * window - out[:, T1]
    out[:, GAP] = np.maximum(inner, np.maximum(head, tail))


def _moments(xyz: Array, starts: Index, n: Index, out: Array, room: Array, *, norm: bool) -> None:
    """Fill in the moments of cells that begin at `starts` and hold `n` samples each, of xyz (samples, 3).

    room: (2, any), to work in: fresh memory costs more than what is done in it.
    """
    for cells, width in _alike(n):
        count = n[cells]
        if isinstance(cells, slice):
            dense = xyz.reshape(-1, width, 3)
        else:
            within = np.minimum(np.arange(width), count[:, None] - 1)
            dense = xyz.take(starts[cells, None] + within, axis=0)
        inside = None if (count == width).all() else np.arange(width)[:, None] < count
        shape = (width, 3 + norm, count.size)
        size = math.prod(shape)
        both = (room if size <= room.shape[1] else np.empty((2, size)))[:, :size].reshape(2, *shape)
        data, work = both
        data[:, :3] = dense.transpose(1, 2, 0)
        if norm:
            np.multiply(data[:, :3], data[:, :3], out=work[:, :3])
            np.add(work[:, 0], work[:, 1], out=data[:, 3])
            np.sqrt(np.add(data[:, 3], work[:, 2], out=data[:, 3]), out=data[:, 3])
        _reduced(both, inside, count, out, cells)


def _alike(n: Index) -> list[tuple[Index | slice, int]]:
    """Sort cells by how many samples they hold: which ones, and the most of these; never twice the least."""
    common = int(np.bincount(n).argmax())
    if (n == common).all():
        return [(slice(None), common)]
    octave = np.where(n == common, -1, np.frexp(n)[1])
    groups = [np.flatnonzero(octave == k) for k in np.unique(octave)]
    return [(cells, int(n[cells].max())) for cells in groups]


def _reduced(both: Array, inside: Flags | None, n: Index, out: Array, cells: Index | slice) -> None:
    """Reduce each cell's samples in both[0] (samples, axes and perhaps norm, cells) into its row of `out`.

    inside: (samples, cells), where cells hold unlike numbers of samples: the last is repeated after them.
    Both parts are written over. numpy adds rows to rows in order (a single column it would sum pairwise; here
    are three at least), so a cell's sums do not depend on what other cells there are.
    """
    data, work = both
    width, kinds, count = data.shape
    flat, spare, axes = data.reshape(width, -1), work.reshape(width, -1), slice(0, 3 * count)
    if inside is not None:
        np.multiply(data, inside[:, None, :], out=work)
    mean = np.add.reduce(flat if inside is None else spare, axis=0, initial=0.0).reshape(kinds, count) / n
    np.subtract(flat, mean.reshape(-1), out=spare)
    if inside is not None:
        np.multiply(work, inside[:, None, :], out=work)
    squares = np.add.reduce(np.multiply(spare, spare, out=spare), axis=0, initial=0.0).reshape(kinds, count)
    out[cells, MEAN], out[cells, M2] = mean[:3].T, squares[:3].T
    if kinds > 3:
        out[cells, NORM], out[cells, NORM_M2] = mean[3], squares[3]
    values, step = flat[:, axes], spare[1:, axes]
    out[cells, LOW] = np.minimum.reduce(values, axis=0).reshape(3, count).T
    out[cells, HIGH] = np.maximum.reduce(values, axis=0).reshape(3, count).T
    np.abs(np.subtract(values[1:], values[:-1], out=step), out=step)
    np.multiply(step, step, out=values[1:])
    out[cells, D2] = np.add.reduce(values[1:], axis=0, initial=0.0).reshape(3, count).T
    np.copyto(step, np.inf, where=step < _SAME)
    out[cells, LSB] = np.minimum.reduce(step, axis=0, initial=np.inf).reshape(3, count).T


def joined(rows: Array, widths: Index) -> Array:
    """Join rows into windows of `widths` cells (given for each row), aligned on the grid.

    Means and squares are combined exactly (Chan et al. 1979). A window that lacks a cell has a GAP of inf.
    """
    if rows.shape[0] == 0 or bool((widths == 1).all()):
        return rows
    begins = np.floor(rows[:, K] / widths) * widths
    starts = np.flatnonzero(np.concatenate(([True], begins[1:] != begins[:-1])))
    out = np.empty((starts.size, rows.shape[1]))
    members = np.diff(starts, append=rows.shape[0]).astype(np.intp)
    n = rows[:, N : N + 1]
    total = np.add.reduceat(n, starts)
    out[:, K], out[:, K_END] = begins[starts], begins[starts] + widths[starts]
    out[:, N] = total[:, 0]
    out[:, T0] = np.minimum.reduceat(rows[:, T0], starts)
    out[:, T1] = np.maximum.reduceat(rows[:, T1], starts)
    out[:, GAP] = np.where(members == widths[starts], np.maximum.reduceat(rows[:, GAP], starts), np.inf)
    for mean, squares in ((MEAN, M2), (slice(NORM, NORM + 1), slice(NORM_M2, NORM_M2 + 1))):
        centre = np.add.reduceat(n * rows[:, mean], starts) / total
        between = n * (rows[:, mean] - np.repeat(centre, members, axis=0)) ** 2
        out[:, mean], out[:, squares] = centre, np.add.reduceat(rows[:, squares] + between, starts)
    out[:, D2] = np.add.reduceat(rows[:, D2], starts)
    out[:, LSB] = np.minimum.reduceat(rows[:, LSB], starts)
    out[:, LOW] = np.minimum.reduceat(rows[:, LOW], starts)
    out[:, HIGH] = np.maximum.reduceat(rows[:, HIGH], starts)
    out[:, TEMP] = np.add.reduceat(n[:, 0] * rows[:, TEMP], starts) / total[:, 0]
    return out


def matched(keys: Array, wanted: Array) -> tuple[Index, Flags]:
    """Look up `wanted` in sorted `keys`: where each one is, and whether it is there at all."""
    at = np.searchsorted(keys, wanted)
    found = at < keys.size
    found[found] = keys[at[found]] == wanted[found]
    return at, found


def paired(accel: Array, gyro: Array) -> Array:
    """Set gyroscope rows beside the accelerometer rows of the same cells, shape (n, 2 COLUMNS).

    Cells without gyroscope get a row of zeros, N = 0.
    """
    if gyro.shape[0] == 0:
        both = np.zeros((accel.shape[0], 2 * COLUMNS))
        both[:, :COLUMNS] = accel
        return both
    both = np.empty((accel.shape[0], 2 * COLUMNS))
    both[:, :COLUMNS] = accel
    at, found = matched(gyro[:, K], accel[:, K])
    if found.all():
        both[:, COLUMNS:] = gyro[at]
    else:
        both[:, COLUMNS:] = 0.0
        both[found, COLUMNS:] = gyro[at[found]]
    return both


def across(columns: Array) -> Array:
    """Return the sum of three columns, (n, 3) -> (n,): numpy's own along so short an axis takes ten times."""
    return np.asarray(columns[:, 0] + columns[:, 1] + columns[:, 2])


def spread(rows: Array) -> Array:
    """Return the standard deviation of single samples about each window's mean, rms of the axes."""
    variance = across(rows[:, M2]) / (3.0 * np.maximum(rows[:, N] - 1.0, 1.0))
    return np.asarray(np.sqrt(variance))


def correlation_inflation(m2: Array, d2: Array, limit: float) -> Array:
    """How much the variance of a mean exceeds that of white noise, from lag-one correlation.

    (1 + r) / (1 - r) with 1 - r = d2 / (2 m2), as for a first-order process; between 1 and `limit`. Held
    (repeated) samples show up here too: each code held h times gives 2 h - 1. Both inputs are sums.
    """
    apart = np.minimum(np.maximum(d2 / np.maximum(2.0 * m2, 1e-300), 2.0 / (1.0 + limit)), 1.0)
    return np.asarray(2.0 / apart - 1.0)


@dataclass(frozen=True, slots=True)
class Pace:
    """The block under way: its number, samples and cells so far; before: samples a cell in the last block."""

    block: float = -1.0
    samples: float = 0.0
    cells: float = 0.0
    before: float = np.inf


def paced(pace: Pace, cells: Array, counts: Array, enough: int) -> Index:
    """Return the window length in cells for each row. cells: (n,) their K; counts: (n,) samples in them."""
    blocks, index, samples, held = _blocks(pace, cells, counts)
    if blocks.size == 0:
        return np.empty(0, dtype=np.intp)
    first = pace.before if blocks[0] == pace.block else _density(pace)
    before = np.concatenate(([first], (samples / held)[:-1]))
    doublings = np.ceil(np.log2(np.maximum(enough / before, 1.0))).astype(np.intp)
    return np.minimum(np.left_shift(1, doublings), BLOCK)[index]


def moved(pace: Pace, cells: Array, counts: Array) -> Pace:
    """Return the pace after these rows have been judged."""
    blocks, _, samples, held = _blocks(pace, cells, counts)
    if blocks.size == 0:
        return pace
    if blocks.size > 1:
        before = float(samples[-2] / held[-2])
    else:
        before = pace.before if blocks[0] == pace.block else _density(pace)
    return Pace(float(blocks[-1]), float(samples[-1]), float(held[-1]), before)


def _density(pace: Pace) -> float:
    return pace.samples / pace.cells if pace.cells else np.inf


def _blocks(pace: Pace, cells: Array, counts: Array) -> tuple[Array, Index, Array, Array]:
    """Return the blocks that rows fall in, each row's place among them, and their samples and cells."""
    block = np.floor(cells / BLOCK)
    starts = np.flatnonzero(np.concatenate(([True], block[1:] != block[:-1]))[: block.size])
    lengths = np.diff(starts, append=block.size)
    blocks, index = block[starts], np.repeat(np.arange(starts.size), lengths)
    samples = np.add.reduceat(counts, starts) if starts.size else np.empty(0)
    held = lengths.astype(np.float64)
    if blocks.size and blocks[0] == pace.block:
        samples[0] += pace.samples
        held[0] += pace.cells
    return blocks, index, samples, held
