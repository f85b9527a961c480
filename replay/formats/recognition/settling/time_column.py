"""The column that a table's times are in, and their unit: names say it, or the steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.clock import seconds_per_unit
from stillcal.replay.formats.columns import (
    LONG_TIME_UNITS,
    TIME_UNITS,
    Column,
    TimeMap,
    find_columns,
)
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.names.stamps import Stamps
from stillcal.replay.formats.recognition.settling.probe import (
    MOSTLY_FORWARD,
    Probe,
    first_cell,
    holds_dates,
    repeating,
)
from stillcal.replay.formats.tables.cells import is_number
from stillcal.replay.formats.tables.dates import dates_in_seconds, is_date, kind_of_dates
from stillcal.replay.formats.tables.table import Table

_ALIKE = 2.0
"""Ratio up to which two columns of one table last equally long: units differ by more."""

_FEWEST_STEPS = 3
"""Steps of the coarser column that the first rows must last, for the ratio to be known so well."""

_NAMELESS = ("", "Unnamed: 0")
"""How pandas calls the index of a table, which may be its time."""

MOST_REPEATS = 0.5
"""Share of stamps that may repeat the one before: batches share one, but whole seconds are no clock."""


def time_of(
    table: Table, probe: Probe, stamps: Sequence[Stamps], rate_hz: float | None
) -> tuple[TimeMap, str]:
    """Return where the stamps come from, and how to say it. Raises TraceError where there are none."""
    unusable = None
    paired = next((s for s in stamps if s.fraction is not None and probe.adds_up(s)), None)
    if paired is not None and paired.fraction is not None:
        (column, unit) = paired.fraction
        said = f"time {paired.column} in s and {column} in {unit}"
        return TimeMap(column=paired.column, unit="s", fraction=column, fraction_unit=unit), said
    stamps = [s for s in stamps if s.fraction is None]
    dated = [Stamps(name, "", None) for name in table.names or () if holds_dates(table, name)]
    known = [*dated, *(s for s in stamps if s.unit is not None)]
    for choice in [*stamps, *dated]:
        found = _in_column(table, probe, choice)
        if isinstance(found, TimeMap) and choice.unit is None and found.unit != "date":
            found = _contradicted(table, choice, found, known) or found
        if isinstance(found, TimeMap):
            return found, f"time {choice.column} in {_kind_of_time(table, probe, choice, found)}"
        unusable = unusable or found
    for name in table.names or ():
        choice = Stamps(name, "", None)
        found = _in_column(table, probe, choice) if name in _NAMELESS else None
        if isinstance(found, TimeMap):
            how = _kind_of_time(table, probe, choice, found)
            return found, f"time {name or 'of a column without a name'} in {how}"
    if rate_hz is not None:
        return TimeMap(rate_hz=rate_hz), f"no time stamps, {rate_hz:.6g} Hz as stated"
    if unusable is not None:
        raise unusable
    what = "no column of time stamps found"
    raise TraceError(table.path, what, "name one t (s), or say at how many Hz: --format 100Hz")


def _kind_of_time(table: Table, probe: Probe, choice: Stamps, found: TimeMap) -> str:
    """Return what is said of the times in a column: the rate too where only their steps show the unit."""
    if found.unit == "date":
        return kind_of_dates(first_cell(table, choice.column))
    if choice.unit is not None:
        return found.unit
    step = _step(probe.column(choice.column)) * (TIME_UNITS | LONG_TIME_UNITS)[found.unit]
    return f"{found.unit} (by its steps, {1 / step:.3g} Hz)"


def _in_column(table: Table, probe: Probe, choice: Stamps) -> TimeMap | TraceError | None:
    """Return the time in a column; what is wrong with it where it cannot be used, None where it is none.

    Raises TraceError where it holds times, and the file is damaged further on.
    """
    column = choice.column
    if holds_dates(table, column):
        again = probe.repeating_dates(column)
        return _too_coarse(table, column, again) or TimeMap(column=column, unit="date")
    try:
        values = probe.column(column)
    except TraceError as error:
        if is_number(first_cell(table, column)):
            raise
        remedy = "give the time as a number of s, ms, us or ns, or as a date such as 2026-03-01 10:00:00.02"
        return TraceError(table.path, error.what, remedy, error.row)
    unit = _time_unit(choice, values)
    if unit is not None:
        return _too_coarse(table, column, repeating(values)) or TimeMap(column=column, unit=unit)
    if choice.unit is not None or not _goes_forward(values):
        return None
    what = f"column {column!r} goes in steps of {_step(values):.4g}, which shows no unit of time"
    remedy = "say the unit in its name (time_s, time_ms, time_us); of a count say the rate: --format 100Hz"
    return TraceError(table.path, what, remedy)


def _contradicted(table: Table, choice: Stamps, found: TimeMap, known: Sequence[Stamps]) -> TraceError | None:
    """Return the error where times in a unit that their steps show do not last as long as those beside them.

    known: columns whose unit is no guess.
    """
    units = TIME_UNITS | LONG_TIME_UNITS
    own = _first_seconds(table, choice.column, units[found.unit])
    for other in known:
        seconds = _first_seconds(table, other.column, 1.0 if other.unit is None else units[other.unit])
        if other.column == choice.column or own.size != seconds.size or not _goes_forward(seconds):
            continue
        lasts, should = float(np.ptp(own)), float(np.ptp(seconds))
        steps = np.abs(np.diff(seconds))
        finest = float(steps[steps > 0].min()) if (steps > 0).any() else np.inf
        if should > _FEWEST_STEPS * finest and not should / _ALIKE < lasts < should * _ALIKE:
            what = f"column {choice.column!r} lasts for no such time as column {other.column!r}"
            return TraceError(table.path, what, "say its unit in a column map (docs/formats.md)")
    return None


def _first_seconds(table: Table, column: Column, seconds_per_unit: float) -> Array:
    """Return a column's times in the first rows, s, (n,); none where a row has no such time."""
    (place,) = find_columns([column], table.names, table.width) or [0]
    cells = [row[place].strip().strip('"').encode() for row in table.opening if len(row) == table.width]
    try:
        if cells and is_date(cells[0]):
            return dates_in_seconds(cells)
        return np.array([float(cell) for cell in cells]) * seconds_per_unit
    except ValueError:
        return np.empty(0)


def _too_coarse(table: Table, column: Column, repeating: float) -> TraceError | None:
    """Return the error where a share of stamps that repeat the one before is too large for a clock."""
    if repeating <= MOST_REPEATS:
        return None
    what = f"{repeating:.0%} of the stamps in column {column!r} repeat the one before"
    return TraceError(table.path, what, "give one column of times that differ from sample to sample")


def _time_unit(choice: Stamps, values: Array) -> Any:
    """Return the unit of a column of stamps, None where its values are none."""
    known = values[np.isfinite(values)]
    if not _goes_forward(values):
        return None
    seconds = seconds_per_unit("auto" if choice.unit is None else choice.unit, known, None)
    if (
        "fine" in choice.label and seconds != 1e-6
    ):  # Xsens' SampleTimeFine: us in some devices, 0.1 ms in others
        return None
    return {length: unit for unit, length in (TIME_UNITS | LONG_TIME_UNITS).items()}.get(seconds or 0.0)


def _goes_forward(values: Array) -> bool:
    """Whether a column of numbers, (n,), NaN where a cell is empty, goes forward as times do."""
    known = values[np.isfinite(values)]
    return bool(known.size > 1 and known[-1] > known[0] and np.mean(np.diff(known) >= 0) >= MOSTLY_FORWARD)


def _step(values: Array) -> float:
    """Return the median step forward of a column of numbers."""
    steps = np.diff(values[np.isfinite(values)])
    return float(np.median(steps[steps > 0]))
