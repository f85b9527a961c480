"""How many cells a window needs at the present sampling rate, decided block by block of the absolute grid.

A slow sensor leaves too few samples in one cell, so two, four or eight are joined, by the density of samples
in the last block of eight cells that held any: known before the block begins, however the stream is cut.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.static.windows import BLOCK, Index


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
