"""A folder with a file for each sample: `oxts` of KITTI's raw recordings and KITTI-360 (Geiger et al. 2013).

`timestamps.txt` holds a date a line, `data/*.txt` one row of 30 numbers each. They mean what KITTI's
dataformat.txt says, which itself calls the acceleration in z `ay` and is therefore not read.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.columns import load_map
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.log import Log
from stillcal.replay.formats.recognition.settle import settled
from stillcal.replay.formats.sources import Source, cannot_open
from stillcal.replay.formats.tables.cells import read_numbers
from stillcal.replay.formats.tables.dates import Dates, NotADateError
from stillcal.replay.formats.tables.numbers import NumberTable

STAMPS, DATA = "timestamps.txt", "data"

_ACCELERATIONS, _RATES = ("ax", "ay", "az", "af", "al", "au"), ("wx", "wy", "wz", "wf", "wl", "wu")
_COLUMNS = (
    *("lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu"),
    *(f"{name} (m/s^2)" for name in _ACCELERATIONS),
    *(f"{name} (rad/s)" for name in _RATES),
    *("pos_accuracy", "vel_accuracy", "navstat", "numsats", "posmode", "velmode", "orimode"),
)
"""In the order of KITTI's dataformat.txt, with the units of the sensors."""

_BLOCK_FILES = 4096
_LONGEST_ROW, _LONGEST_STAMPS = 1 << 16, 1 << 28
"""Bytes of a sample's file, and of the file of dates, that are read at most."""


def sample_folder(folder: Path) -> Log | None:
    """Return the recording of a folder, or of a folder in it, that has a file for each sample; else None.

    Raises TraceError where it cannot be read.
    """
    try:
        folders = [folder, *sorted(Path(entry) for entry in os.scandir(folder) if entry.is_dir())]
        there = [path for path in folders if (path / STAMPS).is_file() and (path / DATA).is_dir()]
        found = [(path, _files_of(path)) for path in there]
    except OSError as error:
        raise cannot_open(folder, error) from None
    return next((log for path, files in found if (log := _opened(path, files)) is not None), None)


def sample_members(archive: Path, members: Mapping[str, Source]) -> Log | None:
    """Return the recording of an archive that holds such a folder; else None. Raises TraceError."""
    for name in members:
        folder = name.removesuffix(STAMPS)
        if PurePosixPath(name).name == STAMPS:
            inside = {n.removeprefix(folder): source for n, source in members.items() if n.startswith(folder)}
            log = _opened(archive / folder, inside)
            if log is not None:
                return log
    return None


def _files_of(folder: Path) -> dict[str, Source]:
    """Return a folder's files by their path in it, none of them looked at yet. Raises OSError."""
    names = [STAMPS, *(f"{DATA}/{entry.name}" for entry in os.scandir(folder / DATA))]
    return {name: _file(folder / name) for name in names}


def _file(path: Path) -> Source:
    return Source(path, 0, lambda: path.open("rb"), path)


def _opened(folder: Path, files: Mapping[str, Source]) -> Log | None:
    """Return the recording of files by their path in a folder; None where they are no rows of 30 numbers.

    Raises TraceError where samples and time stamps are not as many.
    """
    samples = [files[name] for name in sorted(files) if name.startswith(f"{DATA}/") and name.endswith(".txt")]
    first = _row(samples[0]) if samples else None
    if first is None or len(first) != len(_COLUMNS):
        return None
    stamps = _stamps(files[STAMPS])
    if len(stamps) != len(samples):
        what = f"has {len(stamps)} time stamps for {len(samples)} samples"
        raise TraceError(files[STAMPS].path, what, "copy the recording again: there is one for each")

    def rows(places: Sequence[int]) -> Iterator[tuple[Array, float]]:
        for start in range(0, len(samples), _BLOCK_FILES):
            part = samples[start : start + _BLOCK_FILES]
            values = np.array([_whole(sample) for sample in part])
            table = np.column_stack([stamps[start : start + len(part)], values])
            yield table[:, list(places)], (start + len(part)) / len(samples)

    table = NumberTable(folder, ["time", *_COLUMNS], rows, len(samples))
    return Log(folder, "KITTI folder", settled(table, load_map("csv")), beside=files[STAMPS].local and folder)


def _stamps(source: Source) -> Array:
    """Return a file of dates, one a line, as s since 1970, (n,). Raises TraceError naming a faulty line."""
    with source.open() as file:
        cells = file.read(_LONGEST_STAMPS).strip().splitlines()
    try:
        return Dates(cells[0]).seconds(cells) if cells else np.empty(0)
    except NotADateError as error:
        said = cells[error.index].decode("utf-8", "backslashreplace").strip()[:40]
        what = f"holds {said!r}, which is not a date"
        raise TraceError(source.path, what, "copy the recording again", error.index + 1) from None


def _row(source: Source) -> Array | None:
    """Return the numbers of a file that is one row of them, None where it is not."""
    with source.open() as file:
        lines = file.read(_LONGEST_ROW).strip().splitlines()
    return read_numbers(b",".join(lines[0].split())) if len(lines) == 1 else None


def _whole(source: Source) -> Array:
    """Return the numbers of a sample's file. Raises TraceError where they are not as many as the columns."""
    row = _row(source)
    if row is None or len(row) != len(_COLUMNS):
        found = "no row of numbers" if row is None else f"{len(row)} numbers"
        raise TraceError(source.path, f"holds {found} instead of {len(_COLUMNS)}", "copy the recording again")
    return row
