"""Disks that fail under the store and the state, counted: full, read-only, limited, reporting errors.

All but the failing fsync are real: the kernel refuses. Full and read-only disks are small file systems in
a mount namespace of their own, which needs user namespaces; where a machine has none, that is said.
`python -m stillcal.replay.trials.faults.disk FOLDER FAULT` is what runs inside.
"""

from __future__ import annotations

import contextlib
import errno
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.daemon.service import saved_state
from stillcal.daemon.store.files import StoreError
from stillcal.daemon.store.store import Store
from stillcal.replay.trials.faults.kill import Tell, example, in_child
from stillcal.replay.trials.faults.wire import Figures

NAMESPACE = ("unshare", "--user", "--map-root-user", "--mount")
STATE = bytes(range(256)) * 40
FULL, READ_ONLY = "full", "read-only"


def failing_disks(folder: Path) -> list[Figures]:
    """Try every fault in `folder`, which is empty."""
    record, _ = example()
    return [
        failing_fsync(folder, record),
        limited(folder, record),
        *(mounted(folder, fault) for fault in (FULL, READ_ONLY)),
    ]


def failing_fsync(folder: Path, record: CalibrationRecord) -> Figures:
    """Let each fsync of a save in turn report EIO: the old is kept, or the new is there and it is said."""
    path = folder / "eio.json"
    counts = {"saves that failed": 0, "old store intact": 0, "new store in place": 0, "torn stores": 0}
    Store(path).publish(_numbered(record, 1))
    for number in range(2, 100):
        before = path.read_bytes()
        with fsync_failing_at(number - 1):
            refusal = _refusal(partial(Store(path).publish, _numbered(record, number)))
        if not refusal:
            break
        after = path.read_bytes()
        counts["saves that failed"] += 1
        counts["old store intact"] += before == after
        counts["new store in place"] += before != after and "make durable" in refusal
        counts["torn stores"] += not Store(path).verify().whole
    kept = counts["old store intact"] + counts["new store in place"]
    holds = counts["saves that failed"] == kept > 0 and not counts["torn stores"]
    return Figures("EIO on each fsync", holds, counts)


def limited(folder: Path, record: CalibrationRecord) -> Figures:
    """Save in a process that may write files of 2000 bytes only (RLIMIT_FSIZE)."""
    path = folder / "limited.json"

    def save(tell: Tell) -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
        for line in _endured(path, record):
            tell(line)

    prepared(path, record)
    child, heard = in_child(save)
    with os.fdopen(heard, encoding="utf-8") as lines:
        results = lines.read().splitlines()
    os.waitpid(child, 0)
    return _figures("a file that may not grow", results)


def mounted(folder: Path, fault: str) -> Figures:
    """Save on a file system of 1 MiB that is `fault`: full or read-only."""
    name = f"a {fault} disk"
    if subprocess.run([*NAMESPACE, "true"], check=False, capture_output=True).returncode:
        return Figures(f"{name}: not tried, no mount namespaces here", True, {"tried": 0})
    disk = folder / fault
    disk.mkdir()
    command = [*NAMESPACE, sys.executable, "-m", __name__, str(disk), fault]
    ran = subprocess.run(command, check=False, capture_output=True, text=True)
    return _figures(name, ran.stdout.splitlines())


@contextlib.contextmanager
def fsync_failing_at(number: int) -> Iterator[None]:
    """Let the number-th fsync of this process, counted from 1, report EIO; the others do nothing."""
    fsync, calls = os.fsync, 0

    def failing(fd: object) -> None:
        nonlocal calls
        calls += 1
        if calls == number:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    os.fsync = failing
    try:
        yield
    finally:
        os.fsync = fsync


def prepared(path: Path, record: CalibrationRecord) -> None:
    """Leave a store and a state where the fault will be."""
    Store(path).publish(_numbered(record, 1))
    saved_state.save(saved_state.state_path(path), STATE)


def _numbered(record: CalibrationRecord, number: int) -> CalibrationRecord:
    return replace(record, fitted_at=float(number))


def _refusal(save: Callable[[], object]) -> str:
    """Return how a save was refused, empty where it was not."""
    try:
        save()
    except (StoreError, OSError) as error:
        return str(error)
    return ""


def _endured(path: Path, record: CalibrationRecord) -> Iterator[str]:
    """Try to save store and state where it cannot be; yield a word for everything that holds."""
    state = saved_state.state_path(path)
    before = path.read_bytes(), state.read_bytes()
    if refusal := _refusal(lambda: Store(path).publish(_numbered(record, 2))):
        yield f"store-refused {refusal}"
    if _refusal(lambda: saved_state.save(state, STATE[::-1])):
        yield "state-refused"
    if path.read_bytes() == before[0] and Store(path).verify().whole:
        yield "store-intact"
    if state.read_bytes() == before[1]:
        yield "state-intact"
    if not list(path.parent.glob(f"{path.stem}*.tmp")):
        yield "no-temporary-left"


def _figures(name: str, results: list[str]) -> Figures:
    words = {line.split()[0] for line in results}
    expected = ("store-refused", "state-refused", "store-intact", "state-intact", "no-temporary-left")
    counts = {word.replace("-", " "): int(word in words) for word in expected}
    return Figures(name, all(counts.values()), counts)


def _inside(disk: Path, fault: str) -> None:
    """Mount a small file system on `disk`, break it, and save."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", disk], check=True)
    path = disk / "store.json"
    record, _ = example()
    prepared(path, record)
    if fault == FULL:
        _fill(disk / "ballast")
    else:
        subprocess.run(["mount", "-o", "remount,ro", disk], check=True)
    for line in _endured(path, record):
        print(line)


def _fill(path: Path) -> None:
    with path.open("wb", buffering=0) as ballast, contextlib.suppress(OSError):
        while True:
            ballast.write(bytes(4096))


if __name__ == "__main__":
    _inside(Path(sys.argv[1]), sys.argv[2])
