"""Statistics of short windows on one absolute time grid: the only thing the detector knows of samples.

A cell is the stretch [k w, (k+1) w) of the sensor's time. Its row depends on the samples inside it and on
nothing else, so however a stream is cut into blocks, the rows come out the same to the last bit. Rows are
joined (two, four, eight) for slow sensors. No thresholds here.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.samples import Array, Samples, Sensor, frozen

Index = NDArray[np.intp]

# Columns of a row. K, K_END: first cell and the one after the last. N: samples. T0, T1: first and last
# sample, s. GAP: longest pause, s. Per axis: MEAN, M2 (sum of squares about it), D2 (sum of squared steps
# from sample to sample), LSB (smallest step that was not 0; inf where none), LOW, HIGH. NORM, NORM_M2: mean
# and sum of squares of the vector's norm. TEMP: mean temperature or NaN.
K, K_END, N, T0, T1, GAP = range(6)
MEAN, M2, D2, LSB, LOW, HIGH = (slice(6 + 3 * i, 9 + 3 * i) for i in range(6))
NORM, NORM_M2, TEMP = 24, 25, 26
COLUMNS = 27

BLOCK = 8  # cells of the longest window; everything that changes with time changes between blocks

_CHUNK = 1 << 14  # samples worked on at a time: the scratch arrays then stay in cache
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
    for first, last in _chunks(starts, t.size):
        span = slice(starts[first], starts[last] if last < starts.size else t.size)
        local, out, n = starts[first:last] - span.start, rows[first:last], counts[first:last]
        _gaps(t[span], local, window, out)
        _moments(np.ascontiguousarray(xyz[span].T), local, n, out, norm=norm)
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


def _moments(axes: Array, starts: Index, n: Index, out: Array, *, norm: bool) -> None:
    for i, x in enumerate(axes):
        out[:, MEAN.start + i], out[:, M2.start + i] = _mean_and_squares(x, starts, n)
        step = np.abs(_steps(x, starts))
        out[:, D2.start + i] = np.add.reduceat(step * step, starts)
        step[step < _SAME] = np.inf
        out[:, LSB.start + i] = np.minimum.reduceat(step, starts)
        out[:, LOW.start + i] = np.minimum.reduceat(x, starts)
        out[:, HIGH.start + i] = np.maximum.reduceat(x, starts)
    if norm:
        length = np.sqrt(axes[0] * axes[0] + axes[1] * axes[1] + axes[2] * axes[2])
        out[:, NORM], out[:, NORM_M2] = _mean_and_squares(length, starts, n)


def _mean_and_squares(x: Array, starts: Index, n: Index) -> tuple[Array, Array]:
    mean = np.add.reduceat(x, starts) / n
    centred = x - np.repeat(mean, n)
    return mean, np.add.reduceat(centred * centred, starts)


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


def matched(keys: Array, wanted: Array) -> tuple[Index, NDArray[np.bool_]]:
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
    apart = np.clip(d2 / np.maximum(2.0 * m2, 1e-300), 2.0 / (1.0 + limit), 1.0)
    return np.asarray(2.0 / apart - 1.0)
