"""How the first samples of a table behave: sizes, directions, repeats and dates of its columns."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.columns import (
    TIME_UNITS,
    Column,
    find_columns,
)
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.names.axes import Axes
from stillcal.replay.formats.recognition.names.stamps import Stamps, is_plausible_temperature
from stillcal.replay.formats.tables.dates import is_date
from stillcal.replay.formats.tables.table import EMPTY, Table

PROBED_ROWS = 20_000

MOSTLY_FORWARD = 0.9
"""Share of steps that a column of times makes forward at least; a few rows may be out of order."""

_ROWS_TOGETHER = 100
"""Rows, a second or two of them, over which motion swings back and gravity does not."""

_KEPT = 0.5
"""Size of the median vector over that of the vectors: 1 for gravity at rest, near 0 for motion without it."""


class Probe:
    """The first rows of a table, column by column."""

    def __init__(self, table: Table) -> None:
        self._table = table

    def column(self, name: Column) -> Array:
        """Return the first values of a column, (n,), NaN where a cell is empty."""
        return self._columns([name])[:, 0]

    def norms(self, axes: Axes) -> Array:
        """Return the sizes of the first vectors, (n,)."""
        with np.errstate(over="ignore"):  # a damaged file holds numbers of any size
            norms: Array = np.linalg.norm(self._vectors(axes), axis=1)
        return norms[np.isfinite(norms)]

    def whole_numbers(self, axes: Axes) -> bool:
        """Whether all first values of a sensor are whole numbers."""
        values = self._vectors(axes)
        return not (values[np.isfinite(values)] % 1).any()

    def _vectors(self, axes: Axes) -> Array:
        """Return a sensor's first vectors, (n, 3), with gravity added where it has columns of its own."""
        values = self._columns(axes.columns)
        return values if axes.gravity is None else values + self._columns(axes.gravity)

    def _columns(self, names: Sequence[Column]) -> Array:
        places = find_columns(list(names), self._table.names, self._table.width) or []
        block = next(iter(self._table.blocks(places)), None)
        values = np.empty((0, len(names))) if block is None else block.values[:PROBED_ROWS]
        return np.where(values == EMPTY, np.nan, values)

    def all_change(self, axes: Axes) -> bool:
        """Whether none of a sensor's first values is the same throughout."""
        return bool((np.ptp(self._vectors(axes), axis=0) > 0).all())

    def keeps_its_direction(self, axes: Axes) -> bool:
        """Whether vectors agree over some rows, as those do that hold gravity: motion alone swings back."""
        vectors = self._vectors(axes)
        vectors = vectors[np.isfinite(vectors).all(axis=1)]
        count = len(vectors) // _ROWS_TOGETHER
        if not count:
            return True
        windows = vectors[: count * _ROWS_TOGETHER].reshape(count, _ROWS_TOGETHER, 3)
        with np.errstate(over="ignore"):
            kept, typical = (
                float(np.median(np.linalg.norm(v, axis=1))) for v in (np.median(windows, axis=1), vectors)
            )
        return not kept < _KEPT * typical

    def repeating_dates(self, name: Column) -> float:
        """Return the share of the first dates of a column that repeat the one before."""
        (place,) = find_columns([name], self._table.names, self._table.width) or [0]
        cells = [row[place] for row in self._table.opening if len(row) > place]
        return sum(a == b for a, b in itertools.pairwise(cells)) / max(len(cells) - 1, 1)

    def adds_up(self, stamps: Stamps) -> bool:
        """Whether a column holds whole seconds and another what is to be added to them, less than one."""
        if stamps.fraction is None or holds_dates(self._table, stamps.column):
            return False
        column, unit = stamps.fraction
        try:
            seconds, parts = self._columns([stamps.column, column]).T
        except TraceError:
            return False
        whole = np.isfinite(seconds).all() and not (seconds % 1).any() and bool((parts >= 0).all())
        less = bool((parts * TIME_UNITS[unit] < 1).all())
        steps = np.diff(seconds + parts * TIME_UNITS[unit])
        return bool(whole and less and steps.size and np.mean(steps >= 0) >= MOSTLY_FORWARD)

    def plausible_temperature(self, thermometer: tuple[str, str]) -> bool:
        """Whether a column holds temperatures that a sensor can have."""
        return is_plausible_temperature(self.column(thermometer[0]), thermometer[1])


def holds_dates(table: Table, column: Column) -> bool:
    """Whether a column of a text table begins with a date."""
    return is_date(first_cell(table, column))


def first_cell(table: Table, column: Column) -> bytes:
    """Return the first cell of a column of a text table, nothing where the table is none of text."""
    (place,) = find_columns([column], table.names, table.width) or [0]
    return table.first_row[place].encode() if len(table.first_row) > place else b""


def repeating(stamps: Array) -> float:
    """Return the share of stamps that repeat the one before."""
    return float(np.mean(np.diff(stamps) == 0)) if stamps.size > 1 else 0.0
