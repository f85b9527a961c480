"""Further columns of a recording that may drive its sensors' errors: battery voltage, load, a motor."""

from __future__ import annotations

import csv
import gzip
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from stillcal.calib_core.streams.course import Course
from stillcal.replay.formats.errors import TraceError

TIME = "t"
OWN = (TIME, "ax", "ay", "az", "gx", "gy", "gz", "temperature", "t_arrival")
"""Columns that the recording itself is made of."""


def read_covariates(path: Path, names: Sequence[str]) -> dict[str, Course]:
    """Return the named columns of a CSV recording, each over the column `t`, without empty and nan cells.

    Raises TraceError where the file is no CSV with these columns, a column holds no numbers, or a cell of one
    that does is none.
    """
    if not path.is_file():
        raise TraceError(path, "--covariate needs a CSV file, to read it again", "save it as a file first")
    try:
        with _opened(path) as lines:
            return _columns(path, csv.reader(lines), names)
    except (OSError, UnicodeDecodeError, csv.Error, EOFError) as error:
        raise TraceError(
            path, f"--covariate cannot read it as CSV ({error})", "give a CSV recording with that column"
        ) from error


def columns_there(path: Path, names: Sequence[str]) -> list[str]:
    """Return the names that a recording has as columns: none where it is no CSV."""
    if not path.is_file():
        return []
    try:
        with _opened(path) as lines:
            header = {cell.strip() for cell in next(csv.reader(lines), [])}
    except (OSError, UnicodeDecodeError, csv.Error, EOFError):
        return []
    return [name for name in names if name in header]


def _opened(path: Path) -> TextIO:
    return gzip.open(path, "rt", newline="") if path.suffix == ".gz" else path.open(newline="")


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
    wrong: dict[str, tuple[int, str]] = {}
    for cells in rows:
        for name in names:
            cell = cells[at[name]].strip() if at[name] < len(cells) else ""
            if not _filled(cell):
                continue
            value = _number(cell)
            if value is None:
                wrong.setdefault(name, (rows.line_num, cell))
                continue
            t[name].append(_time(path, rows.line_num, cells[at[TIME]]))
            values[name].append(value)
    for name in names:
        if not values[name]:
            raise TraceError(path, f"the column {name!r} holds no numbers", _which_do(path))
        if name in wrong:
            row, cell = wrong[name]
            raise TraceError(path, f"{name} is {cell!r}, no finite number", "mend or remove the row", row)
    return {name: Course(np.array(t[name]), np.array(values[name])) for name in names}


def _which_do(path: Path) -> str:
    """Name the further columns that hold nothing but numbers."""
    with _opened(path) as lines:
        rows = csv.reader(lines)
        header = [cell.strip() for cell in next(rows, [])]
        numbers: set[str] = set()
        words: set[str] = set()
        for cells in rows:
            for name, cell in zip(header, map(str.strip, cells), strict=False):
                if _filled(cell):
                    (words if _number(cell) is None else numbers).add(name)
    further = [name for name in header if name in numbers - words and name not in OWN]
    return f"columns that do: {', '.join(further)}" if further else "no further column of the file does"


def _filled(cell: str) -> bool:
    """Whether a cell holds anything: `nan` stands for nothing, as an empty one does."""
    return cell.lower() not in ("", "nan")


def _number(cell: str) -> float | None:
    """Return the finite number in a cell, or None."""
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _time(path: Path, row: int, cell: str) -> float:
    value = _number(cell)
    if value is None:
        raise TraceError(path, f"{TIME} is {cell.strip()!r}, no finite number", "mend or remove the row", row)
    return value
