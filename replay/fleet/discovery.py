"""Finding recordings in a folder or by a pattern, and their device and model by their folders."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from stillcal.replay.formats.claims import beside
from stillcal.replay.formats.columns import builtin_formats, load_map
from stillcal.replay.formats.recognition.opened import AUTO, other_file

TEXTS = (".csv", ".csv.gz")
"""How recordings end whose format is given."""

LOGS = (".ulg", ".bin", ".bag", ".db3", ".mcap", ".cwa", ".parquet", ".h5", ".hdf5", ".mat", ".npz", ".zip")
"""How recordings end besides, where the content of each says its format (docs/formats.md)."""

EXPORTS = frozenset(
    {
        "metadata.yaml",  # of a ROS 2 bag
        "Raw Data.csv",  # phyphox
        "Accelerometer.csv",  # phyphox
        "TotalAcceleration.csv",  # Sensor Logger
        "AccelerometerUncalibrated.csv",  # Sensor Logger
    }
)
"""Files that make their folder one recording."""

RESULTS = ("recordings.parquet", "findings.parquet")
"""How a fleet's own results end, which are no recordings."""

_WILD = frozenset("*?[")


class NoRecordingsError(ValueError):
    """No recording was found."""


@dataclass(frozen=True, slots=True)
class FoundRecording:
    """A recording and where it lies. name: its path below the folder that was looked through.

    device, model: by its folders; what the maker claims of the model comes before the folder's name. Below
    the root MODEL/DEVICE/recording; with one folder only, MODEL/recording, each recording its own device,
    or, where the maker claims the model, DEVICE/recording. files: it and what belongs to it.
    """

    path: Path
    name: str
    folders: tuple[str, ...]
    files: tuple[Path, ...]

    def owner(self, claimed: str | None) -> tuple[str, str]:
        """Return (model, device), given the model that the maker claims."""
        stem = beside(Path(self.path.name), "").name
        if len(self.folders) >= 2:
            return claimed or self.folders[-2], "/".join(self.folders)
        if len(self.folders) == 1:
            return claimed or self.folders[0], self.folders[0] if claimed else f"{self.folders[0]}/{stem}"
        return claimed or "unknown", stem

    @property
    def stat(self) -> tuple[int, int]:
        """Size in bytes of all its files, and when the last of them was changed, ns."""
        stats = [file.stat() for file in self.files]
        return sum(s.st_size for s in stats), max(s.st_mtime_ns for s in stats)


def find(where: str, format: str = "csv") -> list[FoundRecording]:
    """Return the recordings below the folder `where`, or those that the pattern `where` fits, by name.

    A pattern may hold ** for any depth. A folder is searched for TEXTS and, where the format is "auto", for
    LOGS and folders that are one recording (EXPORTS); files of other names need a pattern. Results of a
    fleet are no recordings. Raises NoRecordingsError where there is none.
    """
    wild = bool(_WILD & set(where)) and not Path(where).exists()
    root = _root(where) if wild else Path(where)
    automatic = format == AUTO
    paths = root.glob(str(Path(where).relative_to(root))) if wild else _recordings_in(root, automatic)
    rules = () if format == "rest" else _rules(format)
    recordings = sorted(
        p
        for p in paths
        if not p.name.startswith(".") and (p.is_file() or (automatic and p.is_dir() and _is_export(p)))
    )
    others = {other for p in recordings if (other := other_file(p, rules)) is not None}
    recordings_found = [_found_recording(p, root, rules) for p in recordings if p not in others]
    if not recordings_found:
        sought = "recording" if automatic else " or ".join(TEXTS)
        there = f"no {sought} below" if root.exists() else "no file or folder"
        what = "no file matches" if wild else there
        raise NoRecordingsError(f"{what} {where}; name a folder of recordings or a pattern in quotes")
    return recordings_found


def _rules(format: str) -> tuple[tuple[str, str], ...]:
    """Return how names of accelerometers' files lead to those of gyroscopes; "auto": in any format."""
    if format == AUTO:
        return tuple(dict.fromkeys(rule for name in builtin_formats() for rule in _rules(name)))
    gyroscope = load_map(format).gyroscope
    return gyroscope.other_file if gyroscope else ()


def _recordings_in(root: Path, automatic: bool) -> Iterator[Path]:
    if not root.is_dir():
        yield root
    endings = (*TEXTS, *LOGS) if automatic else TEXTS
    for folder, folders, files in os.walk(root):
        if automatic and _is_export(Path(folder)):
            folders.clear()
            yield Path(folder)
        else:
            sought = (n for n in files if n.lower().endswith(endings) and not n.endswith(RESULTS))
            yield from (Path(folder, name) for name in sought)


def _is_export(folder: Path) -> bool:
    return any((folder / name).is_file() for name in EXPORTS)


def _root(pattern: str) -> Path:
    """Return the folder before the first part of a pattern that has a wildcard."""
    parts = Path(pattern).parts
    first = next(i for i, part in enumerate(parts) if _WILD & set(part))
    return Path(*parts[:first])


def _found_recording(path: Path, root: Path, rules: tuple[tuple[str, str], ...]) -> FoundRecording:
    inside = path.relative_to(root) if path != root else Path(path.name)
    other = other_file(path, rules)
    if path.is_dir():
        whole = tuple(sorted(p for p in path.rglob("*") if p.is_file()))
        return FoundRecording(path, str(inside), inside.parts[:-1], whole)
    around = (beside(path, ".json"), beside(path, ".events.jsonl"), *([other] if other else []))
    return FoundRecording(path, str(inside), inside.parts[:-1], (path, *(p for p in around if p.is_file())))
