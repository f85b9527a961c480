"""Statistics of short windows on one absolute time grid, and how long a window has to be.

A cell is the span [k w, (k+1) w) of the sensor's time. Its row of statistics depends on the samples inside it
and on nothing else, so the rows are the same to the last bit however a stream is cut into blocks.

A slow sensor leaves too few samples in one cell. Then the rows of two, four or eight cells are joined into
one window, by the density of samples in the last block of eight cells that held any. That density is known
before the block begins, again however the stream is cut. There are no thresholds here.
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

FEW_CODES = 2.5
"""Steps of the quantiser: a range below this holds at most three neighbouring codes."""

_CHUNK = 1 << 13
"""Samples worked on at a time: the scratch arrays, 0.7 MB, then stay in a second-level cache."""

_SAME = 1e-6
"""m/s^2 or rad/s: smaller steps are rounding of one and the same code by a conversion to decimals. The finest
code of phone sensors, 16 bits over 2 g or 125 deg/s, is 6e-4 m/s^2 or 7e-5 rad/s."""


def no_rows(columns: int = COLUMNS) -> Array:
    """Return a table of no rows."""
    return frozen(np.empty((0, columns)))


@dataclass(slots=True)
class Stream:
    """One sensor's samples of the cell that is not complete yet, and the rows not classified yet.

    t: (n,) s. xyz: (n, 3). temperature: (n,) degC, NaN where unknown, or None where no sample has one.
    """

    t: Array = field(default_factory=lambda: frozen(np.empty(0)))
    xyz: Array = field(default_factory=lambda: frozen(np.empty((0, 3))))
    temperature: Array | None = None
    rows: Array = field(default_factory=no_rows)

    def reshaped(self) -> Stream:
        """Return the stream with the shapes of empty arrays restored; a saved file does not keep them."""
        return Stream(self.t, self.xyz.reshape(-1, 3), self.temperature, self.rows.reshape(-1, COLUMNS))


def _temperatures(stream: Stream, block: Samples) -> Array | None:
    """Join the temperatures of waiting and new samples; None where neither has any."""
    if stream.temperature is None and block.temperature is None:
        return None
    parts = ((stream.temperature, stream.t), (block.temperature, block.t))
    return np.concatenate([np.full(t.size, np.nan) if x is None else x for x, t in parts])


def take(
    stream: Stream, block: Samples, window: float, *, close: bool = False, counted: float = -math.inf
) -> Stream:
    """Add a block to a stream: complete cells become rows, other samples wait. close: no sample waits.

    counted: of the cells before this one only the samples are counted.
    """
    waiting = stream.t.size > 0
    t = np.concatenate((stream.t, block.t)) if waiting else block.t
    xyz = np.concatenate((stream.xyz, block.xyz)) if waiting else block.xyz
    temperature = _temperatures(stream, block)
    if t.size == 0:
        return stream
    cells = np.floor(t / window)
    whole = t.size if close else int(np.searchsorted(cells, cells[-1], side="left"))
    if whole == 0:
        return Stream(
            frozen(t), frozen(xyz), None if temperature is None else frozen(temperature), stream.rows
        )
    norm = block.sensor is Sensor.ACCELEROMETER
    part, tail = slice(0, whole), slice(whole, None)
    inside, waiting_temperature = None, None
    if temperature is not None:
        inside, waiting_temperature = temperature[part], frozen(temperature[tail].copy())
    rows = reduce_cells(t[part], xyz[part], inside, cells[part], window, norm=norm, counted=counted)
    rows = np.concatenate((stream.rows, rows)) if stream.rows.shape[0] else rows
    return Stream(frozen(t[tail].copy()), frozen(xyz[tail].copy()), waiting_temperature, frozen(rows))


def reduce_cells(
    t: Array,
    xyz: Array,
    temperature: Array | None,
    cells: Array,
    window: float,
    *,
    norm: bool,
    counted: float = -math.inf,
) -> Array:
    """Return one row for each cell that holds a sample, (rows, COLUMNS).

    t: (n,) s. xyz: (n, 3). temperature: (n,) degC or None. cells: (n,) the cell of each sample. window: s,
    length of a cell. norm: whether to fill the columns of the vector's norm, which are 0 otherwise. counted:
    in the rows of cells before this one the pauses and moments are 0.
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
    wanted = int(np.searchsorted(rows[:, K], counted))
    for start, last in _chunks(starts, t.size):
        first = max(start, wanted)
        if first >= last:
            continue
        span = slice(starts[first], starts[last] if last < starts.size else t.size)
        local, out, n = starts[first:last] - span.start, rows[first:last], counts[first:last]
        _gaps(t[span], local, window, out)
        _moments(xyz[span], local, n, out, room, norm=norm)
    return rows


def _chunks(starts: Index, size: int) -> list[tuple[int, int]]:
    """Return the cells in runs of about _CHUNK samples, as (first, last); the cuts change no row."""
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
    """Fill in the longest pause of each cell, s, those at its two borders included."""
    inner = np.maximum.reduceat(_steps(t, starts), starts)
    head = out[:, T0] - out[:, K] * window
    tail = out[:, K_END] * window - out[:, T1]
    out[:, GAP] = np.maximum(inner, np.maximum(head, tail))


def _moments(xyz: Array, starts: Index, n: Index, out: Array, room: Array, *, norm: bool) -> None:
    """Fill in the moments of cells that begin at `starts` and hold `n` samples each, of xyz (samples, 3).

    room: (2, any), memory to work in: allocating it anew costs more than the work done in it.
    """
    for cells, width in _by_count(n):
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


def _by_count(n: Index) -> list[tuple[Index | slice, int]]:
    """Group cells by their number of samples: the cells and their largest number, below twice the least."""
    common = int(np.bincount(n).argmax())
    if (n == common).all():
        return [(slice(None), common)]
    octave = np.where(n == common, -1, np.frexp(n)[1])
    groups = [np.flatnonzero(octave == k) for k in np.unique(octave)]
    return [(cells, int(n[cells].max())) for cells in groups]


def _reduced(both: Array, inside: Flags | None, n: Index, out: Array, cells: Index | slice) -> None:
    """Reduce each cell's samples in both[0] (samples, axes and perhaps norm, cells) into its row of `out`.

    inside: (samples, cells) which samples are real where cells hold different numbers of them, None where all
    are; the others repeat the cell's last sample. Both parts of `both` are overwritten. numpy adds rows to
    rows in order (a single column it would sum pairwise, but there are at least three), so that a cell's sums
    do not depend on the other cells.
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


def joined(rows: Array, widths: Index, window: float) -> Array:
    """Join rows into windows of `widths` cells, (n,), one for each row, aligned on the grid.

    window: s, length of a cell. Means and squares are combined exactly (Chan, Golub and LeVeque 1979). Below
    two samples a second cells stay empty: the pause across one counts from its neighbours' samples.
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
    out[:, GAP] = np.maximum.reduceat(_pauses(rows, begins, widths, starts, window), starts)
    for mean, squares in ((MEAN, M2), (slice(NORM, NORM + 1), slice(NORM_M2, NORM_M2 + 1))):
        centre = np.add.reduceat(n * rows[:, mean], starts) / total
        between = n * (rows[:, mean] - np.repeat(centre, members, axis=0)) ** 2
        out[:, mean], out[:, squares] = centre, np.add.reduceat(rows[:, squares] + between, starts)
    squared, size = _single_steps(rows, starts)
    out[:, D2] = np.add.reduceat(rows[:, D2] + squared, starts)
    out[:, LSB] = np.minimum.reduceat(np.minimum(rows[:, LSB], size), starts)
    out[:, LOW] = np.minimum.reduceat(rows[:, LOW], starts)
    out[:, HIGH] = np.maximum.reduceat(rows[:, HIGH], starts)
    out[:, TEMP] = np.add.reduceat(n[:, 0] * rows[:, TEMP], starts) / total[:, 0]
    return out


def _pauses(rows: Array, begins: Array | Index, widths: Index, starts: Index, window: float) -> Array:
    """Return for each row the longest pause in and around it within its window, (n,) s.

    begins: (n,) first cell of its window. starts: first row of each window. Next to a cell that holds a
    sample the pause is the row's own; across empty cells it reaches to the next sample or to the border.
    """
    first = np.zeros(rows.shape[0], dtype=bool)
    first[starts] = True
    last = np.append(first[1:], True)
    before = np.where(first, begins * window, np.append(0.0, rows[:-1, T1]))
    after = np.where(last, (begins + widths) * window, np.append(rows[1:, T0], 0.0))
    opens = np.where(first, begins, np.append(0.0, rows[:-1, K_END])) != rows[:, K]
    closes = np.where(last, begins + widths, np.append(rows[1:, K], 0.0)) != rows[:, K_END]
    pause = np.maximum(rows[:, GAP], np.where(opens, rows[:, T0] - before, 0.0))
    return np.maximum(pause, np.where(closes, after - rows[:, T1], 0.0))


def _single_steps(rows: Array, starts: Index) -> tuple[Array, Array]:
    """Return the steps that no cell holds, between cells of one sample each: squared, and their size, (n, 3).

    Zero, and inf for the size, elsewhere: at the first cell of a window (`starts`) and next to fuller cells.
    """
    single = rows[:, N] == 1
    within = np.append(False, single[1:] & single[:-1])
    within[starts] = False
    step = np.abs(np.diff(rows[:, MEAN], axis=0, prepend=rows[:1, MEAN]))
    size = np.where(within[:, None] & (step >= _SAME), step, np.inf)
    return np.where(within[:, None], step * step, 0.0), size


def sparse(rows: Array, enough: int) -> Flags:
    """Tell which windows have less than half of `enough` samples, (n,).

    The longest windows may lack one more: a sensor that gives one a second gives four, now and then three.
    """
    longest = rows[:, K_END] - rows[:, K] >= BLOCK
    return np.asarray(2 * (rows[:, N] + longest) < enough)


def longest_pause(rows: Array, window: float, gap: float) -> Array:
    """Return the longest pause that a window may have, (n,) s: `gap`, or two of its mean sample intervals.

    window: s, length of a cell. A sensor below seven samples a second pauses for longer than 0.3 s where it
    lacks one sample, or none.
    """
    length = (rows[:, K_END] - rows[:, K]) * window
    return np.maximum(gap, 2.0 * length / np.maximum(rows[:, N], 1.0))


def matched(keys: Array, wanted: Array) -> tuple[Index, Flags]:
    """Look up `wanted` in sorted `keys`; return where each one is and whether it is there at all."""
    at = np.searchsorted(keys, wanted)
    present = at < keys.size
    present[present] = keys[at[present]] == wanted[present]
    return at, present


def paired(accel: Array, gyro: Array) -> Array:
    """Join accelerometer rows with the gyroscope rows of the same cells, (n, 2 COLUMNS).

    Cells without gyroscope get zeros there, also for N.
    """
    if gyro.shape[0] == 0:
        both = np.zeros((accel.shape[0], 2 * COLUMNS))
        both[:, :COLUMNS] = accel
        return both
    both = np.empty((accel.shape[0], 2 * COLUMNS))
    both[:, :COLUMNS] = accel
    at, present = matched(gyro[:, K], accel[:, K])
    if present.all():
        both[:, COLUMNS:] = gyro[at]
    else:
        both[:, COLUMNS:] = 0.0
        both[present, COLUMNS:] = gyro[at[present]]
    return both


def across(columns: Array) -> Array:
    """Return the sum over axes, (n, 3) -> (n,); ten times faster than numpy's own along so short an axis."""
    return np.asarray(columns[:, 0] + columns[:, 1] + columns[:, 2])


def spread(rows: Array) -> Array:
    """Return the standard deviation of single samples about each window's mean, (n,), rms of the axes."""
    variance = across(rows[:, M2]) / (3.0 * np.maximum(rows[:, N] - 1.0, 1.0))
    return np.asarray(np.sqrt(variance))


def correlation_inflation(m2: Array, d2: Array, limit: float) -> Array:
    """Return by which factor the variance of a mean exceeds that of white noise, from lag-one correlation.

    It is (1 + r) / (1 - r) with 1 - r = d2 / (2 m2), that of a first-order process, between 1 and `limit`.
    m2: sum of squares about the mean. d2: sum of squared steps from sample to sample. Repeated samples are
    allowed for too: where each value is repeated h times, the factor is 2 h - 1.
    """
    apart = np.minimum(np.maximum(d2 / np.maximum(2.0 * m2, 1e-300), 2.0 / (1.0 + limit)), 1.0)
    return np.asarray(2.0 / apart - 1.0)


@dataclass(frozen=True, slots=True)
class Density:
    """The density of samples on the grid.

    block: number of the present one. samples, cells: in it so far. before: samples a cell in the one before.
    """

    block: float = -1.0
    samples: float = 0.0
    cells: float = 0.0
    before: float = np.inf


def window_cells(density: Density, cells: Array, counts: Array, enough: int) -> Index:
    """Return the window length in cells for each row, (n,).

    cells: (n,) their K. counts: (n,) samples in them. enough: samples that a window should have.
    """
    blocks, index, samples, lengths = _blocks(density, cells, counts)
    if blocks.size == 0:
        return np.empty(0, dtype=np.intp)
    first = density.before if blocks[0] == density.block else _samples_a_cell(density)
    before = np.concatenate(([first], (samples / lengths)[:-1]))
    doublings = np.ceil(np.log2(np.maximum(enough / before, 1.0))).astype(np.intp)
    return np.minimum(np.left_shift(1, doublings), BLOCK)[index]


def with_rows(density: Density, cells: Array, counts: Array) -> Density:
    """Return the density after these rows."""
    blocks, _, samples, lengths = _blocks(density, cells, counts)
    if blocks.size == 0:
        return density
    if blocks.size > 1:
        before = float(samples[-2] / lengths[-2])
    else:
        before = density.before if blocks[0] == density.block else _samples_a_cell(density)
    return Density(float(blocks[-1]), float(samples[-1]), float(lengths[-1]), before)


def _samples_a_cell(density: Density) -> float:
    return density.samples / density.cells if density.cells else np.inf


def _blocks(density: Density, cells: Array, counts: Array) -> tuple[Array, Index, Array, Array]:
    """Return the blocks that rows fall in, each row's index among them, their samples and cells."""
    block = np.floor(cells / BLOCK)
    starts = np.flatnonzero(np.concatenate(([True], block[1:] != block[:-1]))[: block.size])
    lengths = np.diff(starts, append=block.size)
    blocks, index = block[starts], np.repeat(np.arange(starts.size), lengths)
    samples = np.add.reduceat(counts, starts) if starts.size else np.empty(0)
    n_cells = lengths.astype(np.float64)
    if blocks.size and blocks[0] == density.block:
        samples[0] += density.samples
        n_cells[0] += density.cells
    return blocks, index, samples, n_cells
