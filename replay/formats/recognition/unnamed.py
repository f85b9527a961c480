"""What the columns of a table without a header are, by what its first rows hold.

A column of dates, or one whose numbers go forward, is a time; columns of texts are labels; what is left of
three or six columns are sensors' axes. A text that names sensors makes it a table with a row for each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.recognition.names.axes import find_axes
from stillcal.replay.formats.recognition.names.containers import name_sensors, qualified
from stillcal.replay.formats.recognition.names.words import spaced
from stillcal.replay.formats.tables.cells import is_number
from stillcal.replay.formats.tables.dates import is_date

NAMED_BY = "sensor"
"""What the column that names the sensors is called here."""

_AXES = ("x", "y", "z")
_BACKWARD = 0.1
"""Steps back for each step forward that a column of times may have: some rows are out of order. Readings go
back as often as forward."""


@dataclass(frozen=True, slots=True)
class Places:
    """Places of columns. times: that may be the time, as they stand. values: of the sensors' axes."""

    times: list[int]
    values: list[int]


def places_of(rows: Sequence[Sequence[str]]) -> Places:
    """Return what the columns of rows of cells are; rows of another width than the first are passed over.

    Where more than three or six columns may be axes, those are left out in which nothing changes.
    """
    width = len(rows[0])
    columns = [[row[place].strip() for row in rows if len(row) == width] for place in range(width)]
    dates = [place for place in range(width) if is_date(columns[place][0].encode())]
    numbers = {place: numbers for place in range(width) if (numbers := _numbers(columns[place])) is not None}
    times = dates + [place for place, values in numbers.items() if _goes_forward(values)]
    values = [place for place in numbers if place not in times]
    if len(values) not in (3, 6):
        values = [place for place in values if np.unique(numbers[place]).size > 1]
    return Places(times, values)


def names_of_rows(rows: Sequence[Sequence[str]]) -> list[str] | None:
    """Return names for the columns of a table with a row for each sensor and time; None where it is none.

    They are those of its first accelerometer's rows, which may be wider than others'.
    """
    for row in rows:
        for place, text in enumerate(row):
            if is_number(text.strip().encode()) or not find_axes(qualified(_AXES, spaced(text))):
                continue
            if not name_sensors({other[place] for other in rows if len(other) > place}):
                continue
            own = [other for other in rows if len(other) == len(row) and other[place] == text]
            names = names_of_axes(own)
            if names is not None:
                names[place] = NAMED_BY
            return names
    return None


def names_of_axes(rows: Sequence[Sequence[str]]) -> list[str] | None:
    """Return names for the columns of a table with three axes and no others; None where it is none."""
    found = places_of(rows)
    if len(found.values) != len(_AXES):
        return None
    names = [f"column {i}" for i in range(len(rows[0]))]
    for i, time in enumerate(found.times):
        names[time] = f"time {i}" if i else "time"
    for axis, value in zip(_AXES, found.values, strict=True):
        names[value] = axis
    return names


def _numbers(column: Sequence[str]) -> Array | None:
    """Return a column of numbers, NaN where a cell is empty; None where one is a text."""
    cells = [cell.replace(",", ".") for cell in column]
    if not all(is_number(cell.encode()) for cell in cells):
        return None
    return np.array([float(cell) if cell else np.nan for cell in cells])


def _goes_forward(values: Array) -> bool:
    """Whether numbers are such as a clock's or a counter's."""
    steps = np.diff(values)
    forward, back = np.count_nonzero(steps > 0), np.count_nonzero(steps < 0)
    return bool(forward > 0 and back <= _BACKWARD * forward)
