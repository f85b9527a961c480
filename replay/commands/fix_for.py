"""`diagnose --fix-for TOOL FILE`: the simulation's own configuration, corrected by what was found."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from stillcal.calib_core.codec import jsonable
from stillcal.calib_core.errors import UserError
from stillcal.daemon.store.atomic import write_atomically
from stillcal.daemon.system.files import read_regular
from stillcal.replay.export.fix.findings import Fixed
from stillcal.replay.export.fix.fixers import fixed_for
from stillcal.replay.export.target import MAX_BYTES, text_of


class Correction:
    """One configuration that is to be corrected; it is read, and refused if it must be, before the diagnosis.

    base: the configuration to begin with where `path` does not exist yet; None where it must exist.
    Raises UserError where the file does not exist, or is not the tool's.
    """

    def __init__(self, tool: str, path: Path, base: str | None = None) -> None:
        self._tool, self._path, self._base = tool, path, base
        if base is None and not path.exists():
            raise UserError(
                f"{path}: no such file; give the {tool} configuration that the simulation was made with"
            )
        self._before = read_regular(path, MAX_BYTES) if path.exists() else None
        self._fixed({"findings": []})

    def write(self, answer: Mapping[str, Any]) -> None:
        """Write the corrected file and say what was changed; where nothing was, the file stays untouched."""
        fixed = self._fixed(jsonable(answer))
        for line in fixed.changed:
            click.echo(f"{self._path}: {line}")
        for line in fixed.not_held:
            click.echo(f"stillcal: {self._path}: cannot hold {line}", err=True)
        if not fixed.changed:
            click.echo(f"{self._path}: nothing to change")
            return
        if self._before is not None:
            kept = self._backup()
            write_atomically(kept, self._before)
            click.echo(f"{self._path}: corrected; what it was is kept in {kept.name}")
        write_atomically(self._path, fixed.text.encode())

    def _fixed(self, answer: Mapping[str, Any]) -> Fixed:
        try:
            text = self._base if self._before is None else text_of(self._before)
            return fixed_for(self._tool, text, answer)
        except UserError as error:
            raise UserError(f"{self._path}: {error}") from error

    def _backup(self) -> Path:
        """Return a name beside the file that nothing has yet."""
        n = 1
        while (kept := self._path.with_name(f"{self._path.name}.bak{'' if n == 1 else n}")).exists():
            n += 1
        return kept
