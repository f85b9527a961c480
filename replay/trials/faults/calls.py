"""System calls that fail once: every call that the store and the state make, with every passing error.

The calls are those of module os and of the files that it opens, played from inside the process; what the
kernel itself refuses is tried by disk.py.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

from stillcal.calib_core.engine.actions import Publish
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.errors import UserError
from stillcal.daemon.service import saved_state
from stillcal.daemon.service.storage import Storage
from stillcal.daemon.store.store import Store, StoreSettings
from stillcal.replay.trials.faults.kill import example
from stillcal.replay.trials.faults.wire import Figures

PASSING = (errno.EIO, errno.ENOSPC, errno.EMFILE, errno.ENOMEM, errno.EINTR)

CALLS = (
    "open",
    "fstat",
    "stat",
    "lstat",
    "read",
    "write",
    "fsync",
    "fchmod",
    "replace",
    "link",
    "unlink",
    "close",
)
"""Of module os; those of a file that was opened by os.fdopen are read and write."""

MOST = 1000
"""More calls than one save makes."""

SHORT = StoreSettings(history=2)
"""As many calls as with a long history, sooner."""


@dataclass(slots=True)
class Calls:
    """How many calls were made, and which of them failed."""

    made: int = 0
    name: str = ""

    @property
    def failed(self) -> bool:
        """Whether one did."""
        return bool(self.name)


@contextlib.contextmanager
def failing_call(number: int, error: int) -> Iterator[Calls]:
    """Let the number-th call of this process, counted from 1, fail with `error`; the others do as ever."""
    calls = Calls()

    def counted(name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*args: Any, **kwargs: Any) -> Any:
            calls.made += 1
            if calls.made == number:
                calls.name = name
                if name == "close":
                    call(*args, **kwargs)  # the kernel frees the descriptor even so (close(2))
                raise OSError(error, os.strerror(error))
            return call(*args, **kwargs)

        return wrapped

    def opened(fd: int, mode: str = "r", **kwargs: Any) -> Any:
        return _Counted(fdopen(fd, mode, **kwargs), counted)

    saved = {name: getattr(os, name) for name in CALLS}
    fdopen, flock = os.fdopen, fcntl.flock
    try:
        for name, call in saved.items():
            setattr(os, name, counted(name, call))
        os.fdopen = opened  # type: ignore[assignment]  # as far as stillcal calls it
        fcntl.flock = counted("flock", flock)
        yield calls
    finally:
        for name, call in saved.items():
            setattr(os, name, call)
        os.fdopen, fcntl.flock = fdopen, flock


class _Counted:
    """A file whose reads and writes count as calls."""

    def __init__(self, file: IO[Any], counted: Callable[..., Callable[..., Any]]) -> None:
        self._file, self._counted = file, counted

    def __enter__(self) -> _Counted:
        self._file.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._file.__exit__(*error)

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._file, name)
        return self._counted(name, found) if name in ("read", "write", "flush") else found


def every_call(folder: Path) -> Iterator[Figures]:
    """Try every passing error at every call, each in a folder of its own."""
    for error in PASSING:
        own = folder / errno.errorcode[error]
        own.mkdir()
        yield surviving(error, own)


def surviving(error: int, folder: Path) -> Figures:
    """Save store and state, the first call failing, then the second, ...: what was acknowledged is there.

    After each fault it is tried once more, as the daemon does, and must succeed.
    """
    return asyncio.run(_surviving(error, folder))


async def _surviving(error: int, folder: Path) -> Figures:
    record, _ = example()
    path = folder / "store.json"
    counts = {"calls that failed": 0, "saves refused": 0, "lost calibrations": 0, "torn stores": 0}
    counts |= {"torn states": 0, "not saved after": 0, "set aside": 0}
    known = -1
    for number in range(1, MOST):
        newest = replace(record, fitted_at=float(number))
        data = saved_state.encode(saved_state.SavedState(EngineState(record=newest)))
        storage = Storage(Store(path, SHORT), lambda note: None)
        acknowledged = False
        with failing_call(number, error) as calls:
            try:
                storage.open()
                storage.enqueue(Publish(float(number), newest, "newer"))
                acknowledged = await storage.save(data)
            except (UserError, OSError):
                counts["saves refused"] += 1
            finally:
                with contextlib.suppress(OSError):
                    storage.close()
        known = number if acknowledged else known
        counts["calls that failed"] += calls.failed
        counts["lost calibrations"] += _number(path) < known
        again = Storage(Store(path, SHORT), lambda note: None)
        again.open()
        again.enqueue(Publish(float(number), newest, "newer"))
        if await again.save(data):
            known = number
        else:
            counts["not saved after"] += 1
        again.close()
        found = Store(path).verify()
        counts["torn stores"] += not found.whole or found.last_good.document is None
        counts["torn states"] += saved_state.load(saved_state.state_path(path)).state is None
        if not calls.failed:
            break
    counts["set aside"] = sum("unreadable" in p.name or "bad" in p.name for p in folder.iterdir())
    bad = ("lost calibrations", "torn stores", "torn states", "not saved after", "set aside")
    holds = not any(counts[name] for name in bad) and counts["calls that failed"] > 0
    return Figures(f"{errno.errorcode[error]} once at each system call", holds, counts)


def _number(path: Path) -> int:
    """Return the number of the calibration in a store, -1 for none."""
    document = Store(path).verify().store.document if path.exists() else None
    return -1 if document is None or document.current is None else int(document.current.fitted_at or 0)
