"""The error that all readers and writers of recordings raise: one line with the remedy."""

from __future__ import annotations

from pathlib import Path

from stillcal.calib_core.errors import UserError


class TraceError(UserError):
    """A recording cannot be used.

    file: the file at fault. row: its line, counted from 1 with the header, None where no line is at
    fault. what: the fault. remedy: what to do about it. `str()` is one line:
    ``file:row: what; remedy``.
    """

    def __init__(self, file: Path | str, what: str, remedy: str, row: int | None = None) -> None:
        place = f"{file}" if row is None else f"{file}:{row}"
        super().__init__(" ".join(f"{place}: {what}; {remedy}".split()))
        self.file = Path(file)
        self.row = row
        self.what = what
        self.remedy = remedy
