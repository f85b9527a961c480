"""Finding recordings in a folder or by a pattern, and their device and model by their folders."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from stillcal.replay.formats.claims import beside
from stillcal.replay.formats.columns import builtin_formats, load_map
from stillcal.replay.formats.recognition.by_map import other_file
from stillcal.replay.formats.recognition.candidates import is_one_recording, may_be_recording
from stillcal.replay.formats.recognition.opened import AUTO, stated_hz
from stillcal.replay.formats.recognition.pairs import rates_file

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


@dataclass(frozen=True, slots=True)
class Listing:
    """What was found. passed_over: files that are no recordings and belong to none, by their names."""

    recordings: list[FoundRecording]
    passed_over: list[str]


def find(where: str, format: str = AUTO) -> Listing:
    """Return the recordings below the folder `where`, or those that the pattern `where` fits, by name.

    A folder is searched for files and folders that TRACE may be, whatever they are called. A pattern may hold
    ** for any depth; all files that it fits are taken. Results of a fleet are no recordings. Raises
    NoRecordingsError where there is none.
    """
    wild = bool(_WILD & set(where)) and not Path(where).exists()
    root = _root(where) if wild else Path(where)
    rules = () if format == "rest" else _rules(format)
    there = sorted(root.glob(str(Path(where).relative_to(root))) if wild else _files_in(root))
    seen = [p for p in there if not p.name.startswith(".") and not p.name.endswith(RESULTS)]
    taken = [p for p in seen if (wild and p.is_file()) or _is_recording(p)]
    pairs = {p: other for p in taken if (other := _other(p, rules)) is not None}
    seconds = set(pairs.values())
    recordings = [_found_recording(p, root, pairs.get(p)) for p in taken if p not in seconds]
    if not recordings:
        there_is = "no recording below" if root.exists() else "no file or folder"
        what = "no file matches" if wild else there_is
        raise NoRecordingsError(f"{what} {where}; name a folder of recordings or a pattern in quotes")
    read = {*taken, *(file for recording in recordings for file in recording.files)}
    others = [p for p in seen if p not in read and p.is_file()]
    return Listing(recordings, [_inside(p, root) for p in others])


def _is_recording(path: Path) -> bool:
    return is_one_recording(path) if path.is_dir() else path.is_file() and may_be_recording(path)


def _other(path: Path, rules: Sequence[tuple[str, str]]) -> Path | None:
    """Return the gyroscope's own file that is read with an accelerometer's, None where there is none."""
    if path.is_dir():
        return None
    return other_file(path, tuple(rules)) or rates_file(path)


def _rules(format: str) -> tuple[tuple[str, str], ...]:
    """Return how names of accelerometers' files lead to gyroscopes'; "auto" or a rate: in any format."""
    if format == AUTO or stated_hz(format) is not None:
        return tuple(dict.fromkeys(rule for name in builtin_formats() for rule in _rules(name)))
    gyroscope = load_map(format).gyroscope
    return gyroscope.other_file if gyroscope else ()


def _files_in(root: Path) -> Iterator[Path]:
    """Yield the file `root`, or the files in it and the folders in it that are one recording."""
    if root.is_file():
        yield root
    for folder, folders, files in os.walk(root):
        if is_one_recording(Path(folder)):
            folders.clear()
            yield Path(folder)
        else:
            yield from (Path(folder, name) for name in files)


def _root(pattern: str) -> Path:
    """Return the folder before the first part of a pattern that has a wildcard."""
    parts = Path(pattern).parts
    first = next(i for i, part in enumerate(parts) if _WILD & set(part))
    return Path(*parts[:first])


def _inside(path: Path, root: Path) -> str:
    return str(path.relative_to(root) if path != root else Path(path.name))


def _found_recording(path: Path, root: Path, other: Path | None) -> FoundRecording:
    name = _inside(path, root)
    folders = Path(name).parts[:-1]
    if path.is_dir():
        return FoundRecording(path, name, folders, tuple(sorted(p for p in path.rglob("*") if p.is_file())))
    around = (beside(path, ".json"), beside(path, ".events.jsonl"), *([other] if other else []))
    files = dict.fromkeys((path, *(p for p in around if p.is_file())))
    return FoundRecording(path, name, folders, tuple(files))
