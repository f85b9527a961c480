"""Further columns of a recording that may drive its sensors' errors: battery voltage, load, a motor."""

from __future__ import annotations

import csv
import gzip
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stillcal.calib_core.streams.course import Course
from stillcal.replay.formats.errors import TraceError

TIME = "t"
OWN = (TIME, "ax", "ay", "az", "gx", "gy", "gz", "temperature", "t_arrival")
"""Columns that the recording itself is made of."""


def read_covariates(path: Path, names: Sequence[str]) -> dict[str, Course]:
    """Return the named columns of a CSV recording, each over the column `t`. Empty cells are left out.

    Raises TraceError where the file is no CSV with these columns, or a cell is no finite number.
    """
    if not path.is_file():
        raise TraceError(path, "--covariate needs a CSV file, to read it again", "save it as a file first")
    try:
        with gzip.open(path, "rt", newline="") if path.suffix == ".gz" else path.open(newline="") as lines:
            return _columns(path, csv.reader(lines), names)
    except (OSError, UnicodeDecodeError, csv.Error, EOFError) as error:
        raise TraceError(
            path, f"--covariate cannot read it as CSV ({error})", "give a CSV recording with that column"
        ) from error


def _places(path: Path, header: list[str], names: Sequence[str]) -> dict[str, int]:
    """Return where time and the named columns are."""
    for name in names:
        if name in OWN:
            raise TraceError(path, f"{name!r} is a sensor's own column", "name a further one for --covariate")
    for name in (TIME, *names):
        if name not in header:
            raise TraceError(path, f"it has no column {name!r}", f"it has {', '.join(header) or 'none'}", 1)
    return {name: header.index(name) for name in (TIME, *names)}


def _columns(path: Path, rows: Any, names: Sequence[str]) -> dict[str, Course]:
    at = _places(path, [cell.strip() for cell in next(rows, [])], names)
    t: dict[str, list[float]] = {name: [] for name in names}
    values: dict[str, list[float]] = {name: [] for name in names}
    for cells in rows:
        if not cells:
            continue
        for name in names:
            if at[name] < len(cells) and cells[at[name]].strip():
                t[name].append(_number(path, rows.line_num, TIME, cells[at[TIME]]))
                values[name].append(_number(path, rows.line_num, name, cells[at[name]]))
    for name in names:
        if not values[name]:
            raise TraceError(path, f"the column {name!r} is empty", "choose another column")
    return {name: Course(np.array(t[name]), np.array(values[name])) for name in names}


def _number(path: Path, row: int, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise TraceError(path, f"{name} is {cell.strip()!r}, no finite number", "mend or remove the row", row)
    return value
