"""Recordings that come with the package: `sample:NAME` stands for a file of stillcal.config's samples."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from stillcal.replay.formats.errors import TraceError

PREFIX = "sample:"
_ENDING = ".csv.gz"


def samples() -> list[str]:
    """Return the names of the recordings that come with the package."""
    return sorted(path.name.removesuffix(_ENDING) for path in _folder().glob(f"*{_ENDING}"))


def located(path: Path | str) -> Path:
    """Return the file that `path` means: of "sample:NAME" the packaged recording, else `path` itself.

    Raises TraceError where no recording of that name comes with the package.
    """
    text = str(path)
    if not text.startswith(PREFIX):
        return Path(path)
    name = text.removeprefix(PREFIX)
    if name not in samples():
        raise TraceError(text, "no such sample", f"give one of {', '.join(PREFIX + n for n in samples())}")
    return _folder() / f"{name}{_ENDING}"


def _folder() -> Path:
    return Path(str(files("stillcal.config"))) / "samples"
