"""Rest tables: one row a resting window instead of samples."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.static.rest import RestState
from stillcal.replay.formats.checks.units import multiples_of
from stillcal.replay.formats.columns import ColumnMap, SensorMap, TimeMap, find_columns
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.sources import Source
from stillcal.replay.formats.tables.table import EMPTY
from stillcal.replay.formats.tables.text import TextTable

_OPTIONAL = ("t", "duration", "n", "gx", "gy", "gz", "sax", "say", "saz", "temperature")
_LAYOUT = ColumnMap(
    time=TimeMap(rate_hz=1.0),
    accelerometer=SensorMap(columns=("ax", "ay", "az"), unit="m/s^2"),
    delimiter="auto",
)
_DECIMALS = 12
"""Most decimals tried in printed numbers: with three digits before the point a float has no more."""


def read_rest_table(found: Path | Source) -> list[RestState]:
    """Read a rest table, a file or a pipe's bytes.

    Columns: ax ay az, and any of t duration n gx gy gz sax say saz temperature.
    A mean's standard uncertainty is s/sqrt(n). Where the table has no s, only the rounding of the
    printed numbers is known of it, step/sqrt(12): the same for all rows and a lower bound, so that
    rows weigh alike and the residuals have to tell the rest. Rows without t are numbered 0, 1, 2, ...
    in its place. Raises TraceError.
    """
    columns = _columns(found)
    path = found.path if isinstance(found, Source) else found
    force = _axes(columns, ("ax", "ay", "az"))
    if force is None:
        missing = next(name for name in ("ax", "ay", "az") if name not in columns)
        raise TraceError(path, f"no column {missing!r}", "name the means of a rest table ax, ay, az", 1)
    if not force.any():
        raise TraceError(path, "all rests read zero", "give the means in ax, ay, az")
    if unit := multiples_of(np.linalg.norm(force, axis=1)):
        raise TraceError(path, f"the forces seem to be in {unit}", "give a rest table in m/s^2 and rad/s")
    rate = _axes(columns, ("gx", "gy", "gz"))
    force_sd = _axes(columns, ("sax", "say", "saz"))
    if force_sd is None:
        counted = np.ones(len(force))
        force_sd = np.full_like(force, rounding_sd(force))
    else:
        counted = np.maximum(columns.get("n", np.ones(len(force))), 1.0)
    rate_sd = np.zeros_like(force) if rate is None else np.full_like(rate, rounding_sd(rate))
    return [
        RestState(
            **_extent(columns, i),
            specific_force=frozen(force[i]),
            force_sd=frozen(force_sd[i]),
            force_uncertainty=frozen(force_sd[i] / np.sqrt(counted[i])),
            level=_along(force[i], force_sd[i]),
            rate=None if rate is None else frozen(rate[i]),
            rate_sd=None if rate is None else frozen(rate_sd[i]),
            rate_uncertainty=None if rate is None else frozen(rate_sd[i]),
            rate_level=None if rate is None else float(rate_sd[i].max()),
            temperature=_temperature(columns, i),
        )
        for i in range(len(force))
    ]


def _extent(columns: dict[str, Array], row: int) -> dict[str, Any]:
    start = float(columns["t"][row]) if "t" in columns else float(row)
    length = float(columns["duration"][row]) if "duration" in columns else 0.0
    n = int(columns["n"][row]) if "n" in columns else 1
    return {"t_start": start, "t_end": start + length, "n": n}


def _along(force: Array, sd: Array) -> float:
    """Return the standard deviation of the norm, for independent axes."""
    norm = float(np.linalg.norm(force))
    return float(np.linalg.norm(sd * force)) / norm if norm else float(np.linalg.norm(sd))


def _columns(found: Path | Source) -> dict[str, Array]:
    """Return the table's known columns by name, each (n,). Raises TraceError on what is not finite."""
    table = TextTable(found, _LAYOUT)
    path = table.path
    names = [c for c in ("ax", "ay", "az", *_OPTIONAL) if find_columns([c], table.names, table.width)]
    if not names:
        raise TraceError(path, "none of the columns ax, ay, az", "name the means of a rest table so", 1)
    places = find_columns(names, table.names, table.width) or []
    blocks = list(table.blocks(places))
    values = np.concatenate([b.values for b in blocks])
    lines = np.concatenate([b.lines for b in blocks])
    may_be_empty = np.array([name == "temperature" for name in names])
    bad = ~np.isfinite(values) | ((values == EMPTY) & ~may_be_empty)
    if bad.any():
        row, column = (int(i) for i in np.argwhere(bad)[0])
        what = f"column {names[column]!r} holds no finite number"
        raise TraceError(path, what, "correct or delete that row", int(lines[row]))
    return {name: values[:, i] for i, name in enumerate(names)}


def _axes(columns: dict[str, Array], names: tuple[str, str, str]) -> Array | None:
    if any(name not in columns for name in names):
        return None
    return np.column_stack([columns[name] for name in names])


def _temperature(columns: dict[str, Array], row: int) -> float | None:
    value = columns["temperature"][row] if "temperature" in columns else EMPTY
    return None if value == EMPTY else float(value)


def rounding_sd(values: Array) -> float:
    """Return the standard uncertainty of numbers rounded to the decimals that they are printed with."""
    for decimals in range(_DECIMALS):
        scaled = values * 10.0**decimals
        if np.allclose(scaled, np.rint(scaled), rtol=0, atol=1e-6):
            return float(10.0**-decimals / 12**0.5)
    return float(10.0**-_DECIMALS / 12**0.5)
