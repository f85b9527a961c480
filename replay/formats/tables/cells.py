"""Cells in a block of text: where they end, which rows have a key, and the numbers in the selected cells.

numpy on the bytes, with a comma between cells and every row of one width; what JSON does not allow (nan, +1,
.5) is read by float(). Files, quotes and what columns mean are not known here.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array

_COMMA, _NEWLINE = ord(","), ord("\n")
_numbers = msgspec.json.Decoder(list[float])


def blanks_to_commas(text: bytes) -> bytes:
    """Return `text` with one comma for every run of blanks between two words of a line."""
    characters = np.frombuffer(b"\n" + text, dtype=np.uint8)
    blank = (characters == ord(" ")) | (characters == ord("\t"))
    line_end = characters == _NEWLINE
    run_ends = blank & ~(blank | line_end)[np.r_[1 : len(blank), 0]]
    before = np.maximum.accumulate(np.where(blank, 0, np.arange(len(blank))))
    selected = ~blank | (run_ends & ~line_end[before])
    return bytes(np.where(blank, np.uint8(_COMMA), characters)[selected][1:].tobytes())


def line_ends(text: bytes) -> int:
    """Return the number of line ends, five times as fast as bytes.count, which stops at every one."""
    return int(np.count_nonzero(np.frombuffer(text, dtype=np.uint8) == _NEWLINE))


def cell_ends(text: bytes, width: int) -> NDArray[np.intp] | None:
    """Return where the cells end, (rows, width); None where not every row has `width` cells, or no row is."""
    characters = np.frombuffer(text, dtype=np.uint8)
    ends = np.flatnonzero((characters == _COMMA) | (characters == _NEWLINE))
    if not ends.size or ends.size % width:
        return None
    line_end = (characters[ends] == _NEWLINE).reshape(-1, width)
    even = line_end[:, -1].all() and not line_end[:, :-1].any()
    return ends.reshape(-1, width) if even else None


def holding(text: bytes, ends: NDArray[np.intp], key: Sequence[tuple[int, str]]) -> NDArray[np.bool_]:
    """Return which rows have the key's texts at the key's places."""
    characters = np.frombuffer(text, dtype=np.uint8)
    rows = np.ones(len(ends), dtype=np.bool_)
    for place, expected in key:
        value = np.frombuffer(expected.encode(), dtype=np.uint8)
        first = ends[:, place] - value.size
        before = characters[np.maximum(first - 1, 0)]
        rows &= (first == 0) | (before == _COMMA) | (before == _NEWLINE)
        cells = characters[np.maximum(first[:, None] + np.arange(value.size), 0)]
        rows &= (cells == value).all(axis=1)
    return rows


def add_texts(text: bytes, ends: NDArray[np.intp], place: int, known: list[str], most: int) -> None:
    """Append the texts of the cells at a place that are not known yet, until more than `most` are."""
    strange = np.ones(len(ends), dtype=np.bool_)
    for one in known:
        strange &= ~holding(text, ends, [(place, one)])
    flat = ends.ravel()
    while strange.any() and len(known) <= most:
        cell = int(strange.argmax()) * ends.shape[1] + place
        start = int(flat[cell - 1]) + 1 if cell else 0
        known.append(text[start : int(flat[cell])].decode("utf-8", "backslashreplace"))
        strange &= ~holding(text, ends, [(place, known[-1])])


def cut_out(
    text: bytes, ends: NDArray[np.intp], rows: NDArray[np.bool_], columns: Sequence[int]
) -> tuple[bytes, NDArray[np.bool_]]:
    """Return the non-empty cells of the chosen rows and columns, row by row, with commas between.

    The second value tells which cells are not empty: (chosen rows, columns).
    """
    lengths = np.diff(ends.ravel(), prepend=-1)
    filled = (lengths > 1).reshape(ends.shape)
    selected = np.zeros(ends.shape, dtype=np.bool_)
    selected[:, columns] = rows[:, None]
    selected &= filled
    if not selected.all():
        mask = np.repeat(selected.ravel(), lengths)
        text = np.frombuffer(text, dtype=np.uint8)[: mask.size][mask].tobytes()
    return text[:-1].replace(b"\n", b","), filled[rows][:, columns]


def read_numbers(flat: bytes) -> Array | None:
    """Read comma-separated numbers; None where a cell is not a number."""
    try:
        return np.array(_numbers.decode(b"[" + flat + b"]"), dtype=np.float64)
    except msgspec.DecodeError:
        pass
    try:
        return None if b"_" in flat else np.array(list(map(_number, flat.split(b","))))
    except ValueError:
        return None


def is_number(cell: bytes) -> bool:
    """Whether a cell is a number or empty; whether it may be empty, the caller decides."""
    try:
        _number(cell or b"0")
    except ValueError:
        return False
    return b"_" not in cell


def _number(cell: bytes) -> float:
    """Return the number in a cell, NaN for the `NA` that R writes. Raises ValueError."""
    return np.nan if cell.strip() == b"NA" else float(cell)
