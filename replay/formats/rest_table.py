"""Rest tables: one row a resting window instead of samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.static.rest import RestState
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.checks.rest_units import judge_forces, judge_rates, judge_temperatures
from stillcal.replay.formats.clock import unit_since_1970
from stillcal.replay.formats.columns import find_columns
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition import magic
from stillcal.replay.formats.recognition.rest_columns import (
    FORCE,
    FORCE_SCATTER,
    RATE,
    RATE_SCATTER,
    RestColumn,
    rest_columns,
)
from stillcal.replay.formats.recognition.text_formats import text_format
from stillcal.replay.formats.sources import Source, source_of
from stillcal.replay.formats.tables.dates import is_date
from stillcal.replay.formats.tables.table import EMPTY
from stillcal.replay.formats.tables.text import TextTable

_DECIMALS = 12
"""Most decimals tried in printed numbers: with three digits before the point a float has no more."""


@dataclass(frozen=True, slots=True)
class RestTable:
    """The rests of a table, and what is to be said of how it was read, a line each."""

    rests: list[RestState]
    notes: list[str]


@dataclass(frozen=True, slots=True, eq=False)
class _Values:
    """A column in SI units, (n,). rounding_sd: of the decimals printed. stated: whether its unit is."""

    si: Array
    rounding_sd: float
    stated: bool


def read_rest_table(found: Path | Source) -> list[RestState]:
    """Return the rests of a table, as `open_rest_table` reads it. Raises TraceError."""
    return open_rest_table(found).rests


def open_rest_table(found: Path | Source) -> RestTable:
    """Read a rest table, a file or a pipe's bytes.

    Columns: ax ay az, and any of t duration n gx gy gz sax say saz sgx sgy sgz temperature, or other usual
    names for them with their units (recognition/rest_columns.py). A mean's standard uncertainty is s/sqrt(n).
    Where the table has no s or no n, or an s of 0, only the rounding of the printed numbers is known of it,
    step/sqrt(12): a lower bound, the same for all such rows, so that they weigh alike and the residuals have
    to tell the rest.
    Rows without t are numbered 0, 1, 2, ... in its place. Raises TraceError.
    """
    path = found.path if isinstance(found, Source) else found
    columns, notes = _columns(found)
    force = _stacked(columns, FORCE)
    judge_forces(path, force)
    force_sd, force_uncertainty = _uncertainty(columns, FORCE, FORCE_SCATTER)
    rate, rate_sd, rate_uncertainty = None, np.zeros_like(force), np.zeros_like(force)
    if set(RATE) <= columns.keys():
        rate = _stacked(columns, RATE)
        rate_sd, rate_uncertainty = _uncertainty(columns, RATE, RATE_SCATTER)
        notes += [] if columns[RATE[0]].stated else judge_rates(path, force, rate)
    rests = [
        RestState(
            **_extent(columns, i),
            specific_force=frozen(force[i]),
            force_sd=frozen(force_sd[i]),
            force_uncertainty=frozen(force_uncertainty[i]),
            level=_along(force[i], force_sd[i]),
            rate=None if rate is None else frozen(rate[i]),
            rate_sd=None if rate is None else frozen(rate_sd[i]),
            rate_uncertainty=None if rate is None else frozen(rate_uncertainty[i]),
            rate_level=None if rate is None else float(rate_sd[i].max()),
            temperature=_temperature(columns, i),
        )
        for i in range(len(force))
    ]
    return RestTable(rests, notes)


def _uncertainty(
    columns: dict[str, _Values], mean: Sequence[str], scatter: Sequence[str]
) -> tuple[Array, Array]:
    """Return the standard deviation (n, 3) of a sensor's samples, and the uncertainty (n, 3) of its means."""
    rounding = np.full((len(columns[mean[0]].si), 3), max(columns[name].rounding_sd for name in mean))
    if not set(scatter) <= columns.keys():
        return rounding, rounding
    sd = _stacked(columns, scatter)
    if "n" not in columns:
        return sd, rounding
    # A standard deviation of 0 was rounded, or is that of a single sample: no mean is known without an error.
    return sd, np.where(sd > 0.0, sd / np.sqrt(np.maximum(columns["n"].si, 1.0))[:, None], rounding)


def _extent(columns: dict[str, _Values], row: int) -> dict[str, Any]:
    start = float(columns["t"].si[row]) if "t" in columns else float(row)
    length = float(columns["duration"].si[row]) if "duration" in columns else 0.0
    n = int(columns["n"].si[row]) if "n" in columns else 1
    return {"t_start": start, "t_end": start + length, "n": n}


def _along(force: Array, sd: Array) -> float:
    """Return the standard deviation of the norm, for independent axes."""
    norm = float(np.linalg.norm(force))
    return float(np.linalg.norm(sd * force)) / norm if norm else float(np.linalg.norm(sd))


def _columns(found: Path | Source) -> tuple[dict[str, _Values], list[str]]:
    """Return the table's columns by their own names, and notes. Raises TraceError on what is not finite."""
    table = _table(found)
    path, names = table.path, table.names or []
    wanted = rest_columns(names, path)
    if not {column.quantity for column in wanted} >= set(FORCE):
        missing = [name for name in FORCE if name not in names]
        what = f"no column {missing[0]!r}" if len(missing) < len(FORCE) else "none of the columns ax, ay, az"
        raise TraceError(path, what, "name the means of a rest table ax, ay, az", table.header_line)
    unread = [name for name in names if name and name not in {column.name for column in wanted}]
    places = find_columns([column.name for column in wanted], names, table.width) or []
    dated = next((c.name for c in wanted if c.quantity == "t" and _is_dated(table, c.name)), None)
    if dated is not None:
        table.read_dates(names.index(dated))
    blocks = list(table.blocks(places))
    values = np.concatenate([b.values for b in blocks])
    lines = np.concatenate([b.lines for b in blocks])
    warm = np.array([column.quantity == "temperature" for column in wanted])
    values = np.where(warm & np.isnan(values), EMPTY, values)
    spread = np.array([column.quantity in (*FORCE_SCATTER, *RATE_SCATTER) for column in wanted])
    for bad, held in (
        (~np.isfinite(values) | ((values == EMPTY) & ~warm), "no finite number"),
        (spread & (values < 0.0), "a standard deviation below 0"),
    ):
        if bad.any():
            row, i = (int(k) for k in np.argwhere(bad)[0])
            what = f"column {wanted[i].name!r} holds {held}"
            raise TraceError(path, what, "correct or delete that row", int(lines[row]))
    found_columns = {c.quantity: _in_si(values[:, i], c) for i, c in enumerate(wanted)}
    if "temperature" in found_columns:
        celsius = found_columns["temperature"].si
        judge_temperatures(path, np.where(celsius == EMPTY, np.nan, celsius), lines.tolist())
    passed_over = [f"{short_name(path)}: {note}" for note in table.notes]
    return found_columns, [*_told(path, wanted), *_left_out(path, unread), *passed_over]


def _table(found: Path | Source) -> TextTable:
    """Return the table, from its header on. Raises TraceError where it has none."""
    source = found if isinstance(found, Source) else source_of(found)
    kind = magic.kind_of(source)
    if kind != magic.TEXT:
        raise TraceError(
            source.path, f"is {kind}, and rest tables are read from text only", "write it as CSV"
        )
    form = text_format(source)
    cut = msgspec.structs.replace(form.column_map, select=None, decimal="auto")
    table = TextTable(form.source or source, cut)
    if form.names is not None:
        table.names = form.names
    if table.names is None:
        what = "none of the columns ax, ay, az: the table has no header"
        raise TraceError(table.path, what, "name the means of a rest table in its first line", 1)
    return table


def _is_dated(table: TextTable, name: str) -> bool:
    place = (table.names or []).index(name)
    return place < len(table.first_row) and is_date(table.first_row[place].encode())


def _in_si(values: Array, column: RestColumn) -> _Values:
    """Return a column in SI units; an empty cell stays empty. Times since 1970 show theirs by their size."""
    shown = unit_since_1970(float(values[0])) if column.quantity == "t" and column.stated is None else None
    factor = shown or column.factor
    known = np.where(values == EMPTY, EMPTY, factor * values + column.offset)
    return _Values(known, factor * rounding_sd(values[values != EMPTY]), column.stated is not None)


def _told(path: Path, columns: Sequence[RestColumn]) -> list[str]:
    """Return which columns were read as what, where their names are not the own ones."""
    others = [column for column in columns if column.name != column.quantity]
    said = ", ".join(f"{c.name} as {c.quantity}" for c in others)
    return [f"{short_name(path)}: columns recognised by their names: {said}"] if others else []


def _left_out(path: Path, names: Sequence[str]) -> list[str]:
    return [f"{short_name(path)}: columns not read: {', '.join(names)}"] if names else []


def _stacked(columns: dict[str, _Values], names: Sequence[str]) -> Array:
    return np.column_stack([columns[name].si for name in names])


def _temperature(columns: dict[str, _Values], row: int) -> float | None:
    value = columns["temperature"].si[row] if "temperature" in columns else EMPTY
    return None if value == EMPTY else float(value)


def rounding_sd(values: Array) -> float:
    """Return the standard uncertainty of numbers rounded to the decimals that they are printed with."""
    for decimals in range(_DECIMALS):
        scaled = values * 10.0**decimals
        if np.allclose(scaled, np.rint(scaled), rtol=0, atol=1e-6):
            return float(10.0**-decimals / 12**0.5)
    return float(10.0**-_DECIMALS / 12**0.5)
