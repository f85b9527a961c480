"""A folder of results that stays consistent after a crash, a kill or Ctrl-C; the next run continues from it.

Outcomes are kept in parts of some seconds' work; the two tables are written from them at the end of every
run. A part counts once its recordings' file is there, written after its findings'.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stillcal.replay.fleet import parquet
from stillcal.replay.fleet.discovery import RESULTS
from stillcal.replay.fleet.parquet import FINDINGS, RECORDINGS, Rows
from stillcal.replay.fleet.worker import LOST, Examined, Task, content

FLUSH_S, FLUSH_ROWS = 5.0, 256
"""Results that are lost at most if this process is killed: seconds of work, and rows."""


class Results:
    """The results in `folder`, which is made if needed.

    made_by: version and options; a row of another made_by does not count as finished.
    """

    def __init__(self, folder: Path, made_by: str) -> None:
        self.folder, self.made_by = folder, made_by
        self._parts = folder / "parts"
        self._parts.mkdir(parents=True, exist_ok=True)
        self._fresh: list[Examined] = []
        self._flushed = 0.0  # the first outcome is written at once, so that a full disk shows
        self._next = 1 + max((int(p.name[:6]) for p in self._parts.glob("*.recordings.parquet")), default=0)
        self._rows = {row["name"]: row for row in _all(folder, 0)}

    def todo(self, tasks: Sequence[Task]) -> list[Task]:
        """Return the tasks whose recordings are new or have changed since, or were lost with their workers.

        A recording is known by size and time of change, and where these differ, by its content.
        """
        return [task for task in tasks if not self._done(task)]

    def keep(self, task: Task, outcome: Examined) -> None:
        """Add the outcome of a task; it is on the disk within FLUSH_S or FLUSH_ROWS."""
        size, mtime = task.recording.stat if task.recording.path.exists() else (None, None)
        outcome.row |= {"made_by": self.made_by, "size_bytes": size, "mtime_ns": mtime}
        self._fresh.append(outcome)
        if len(self._fresh) >= FLUSH_ROWS or time.monotonic() - self._flushed > FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Write the outcomes since the last flush as one part."""
        self._flushed = time.monotonic()
        if not self._fresh:
            return
        stem = self._parts / f"{self._next:06d}"
        parquet.write(
            Path(f"{stem}.findings.parquet"), [f for e in self._fresh for f in e.findings], FINDINGS
        )
        parquet.write(Path(f"{stem}.recordings.parquet"), [e.row for e in self._fresh], RECORDINGS)
        self._next, self._fresh = self._next + 1, []

    def finish(self) -> tuple[Rows, Rows]:
        """Write both tables, the newest outcome of each recording, and clear the parts away."""
        self.flush()
        recordings, findings = read(self.folder)
        parquet.write(self.folder / RESULTS[1], findings, FINDINGS)
        parquet.write(self.folder / RESULTS[0], recordings, RECORDINGS)
        for part in sorted(self._parts.glob("*.parquet"), reverse=True):  # recordings before their findings
            part.unlink()
        return recordings, findings

    def _done(self, task: Task) -> bool:
        row = self._rows.get(task.recording.name)
        if row is None or row["made_by"] != self.made_by or row["status"] == LOST:
            return False
        return (row["size_bytes"], row["mtime_ns"]) == task.recording.stat or row["content"] == content(
            task.recording
        )


def read(folder: Path) -> tuple[Rows, Rows]:
    """Return the rows of recordings and of findings in `folder`, the newest of each recording, by name."""
    newest: dict[str, tuple[dict[str, Any], int]] = {}
    findings: list[Rows] = []
    for number, (recordings, findings_path) in enumerate(
        zip(_sources(folder, 0), _sources(folder, 1), strict=True)
    ):
        findings.append(parquet.read(findings_path))
        newest |= {row["name"]: (row, number) for row in parquet.read(recordings)}
    rows = [newest[name][0] for name in sorted(newest)]
    current = [
        f for n, part in enumerate(findings) for f in part if newest.get(f["name"], (None, -1))[1] == n
    ]
    return rows, sorted(current, key=lambda f: (f["name"], f["effect"]))


def _sources(folder: Path, which: int) -> list[Path]:
    parts = sorted((folder / "parts").glob("*.recordings.parquet"))
    if which:
        parts = [p.with_name(p.name.replace("recordings", "findings")) for p in parts]
    return [folder / RESULTS[which], *parts]


def _all(folder: Path, which: int) -> Rows:
    return [row for path in _sources(folder, which) for row in parquet.read(path)]
