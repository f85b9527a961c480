"""The store's files: read them, lock them, and explain the system's errors.

store.py changes a store; document.py defines the contents of its file.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from stillcal.calib_core.errors import TryAgainError, UserError
from stillcal.daemon.store.atomic import SAFE, NotDurableError
from stillcal.daemon.store.document import Fault, StoreDocument, StoreFormatError, parse
from stillcal.daemon.store.lock import try_lock
from stillcal.daemon.system.files import (
    STANDARD_INPUT,
    NotRegularError,
    TooLargeError,
    input_name,
    passing,
    read_input,
    read_regular,
)

MAX_BYTES = 64 * 2**20
"""Larger than any store; a file of this size is not a store and is not read into memory."""

MARKS = (b'"schema"', b'"stillcal calibration"', b'"accel"', b'"gyro"')
BEGINNING_BYTES = 200
"""A store of any schema has one of MARKS among so many bytes at its beginning."""

_REMEDIES = {
    errno.ENOSPC: "the disk is full: free some space",
    errno.EDQUOT: "the disk quota is used up: free some space",
    errno.EFBIG: "it would be larger than this process may write: raise the limit (ulimit -f)",
    errno.EROFS: "the file system is read-only: remount it or give another path",
    errno.EACCES: "permission denied: run as the store's owner or give another path",
    errno.EPERM: "not permitted: run as the store's owner or give another path",
    errno.ENOENT: "there is no such folder: create it or give another path",
    errno.ELOOP: "it is a link, or its links lead in a circle: remove it or give another path",
    errno.EMFILE: "this process has too many files open: raise the limit (ulimit -n)",
    errno.ENFILE: "the system has too many files open: close some",
    errno.ENOMEM: "the system is out of memory: free some",
    errno.EIO: "the disk reports an error: check it (dmesg)",
}


class StoreError(UserError):
    """The store cannot be read or written; the message says why and what to do."""


class StoreLockedError(StoreError):
    """Another process writes this store. pid: its number, None if unknown."""

    def __init__(self, path: Path, pid: int | None) -> None:
        who = f"process {pid}" if pid else "another process"
        super().__init__(f"{path} is in use by {who}: stop it first, or give another --store")
        self.pid = pid


class StoreBusyError(StoreError, TryAgainError):
    """The store cannot be read or written just now; nothing is wrong with what it holds."""


@dataclass(frozen=True, slots=True)
class Reading:
    """What lies at one path. document is None where nothing is there or `problem` says what is wrong.

    regular: whether it is a file at all. foreign: whether it looks like a file that never was a store.
    """

    path: Path
    document: StoreDocument | None = None
    schema: int | None = None
    problem: StoreFormatError | None = None
    regular: bool = True
    foreign: bool = False

    @property
    def there(self) -> bool:
        """Whether anything lies at the path."""
        return self.document is not None or self.problem is not None


def existing(path: Path) -> Path:
    """Return the path of a store to be read or changed. Raises StoreError where nothing is there."""
    if str(path) == STANDARD_INPUT:
        raise StoreError("a store on standard input cannot be changed: give the store's path")
    if not path.exists():
        raise StoreError(f"{path}: no such store: give the path of an existing one")
    return path


def piped(path: Path) -> StoreDocument:
    """Return the store that a pipe or standard input ("-") holds. Raises StoreError where it holds none."""
    return usable(read_piped(path))


def usable(found: Reading) -> StoreDocument:
    """Return the store that was read. Raises StoreError where it is none."""
    if found.document is None:
        why = f"{found.path} cannot be used as a store ({found.problem})"
        raise StoreError(f"{why}: give a store that stillcal wrote") from found.problem
    return found.document


def read_piped(path: Path) -> Reading:
    """Read what a pipe or standard input ("-") holds, as `read` does a file."""
    return replace(_read(path, read_input), path=Path(input_name(path)))


def read(path: Path) -> Reading:
    """Read what lies at a path.

    Only contents can be damaged. Raises StoreError where the file may not be read, and StoreBusyError where
    the system could not read it now.
    """
    return _read(path, read_regular)


def _read(path: Path, read_bytes: Callable[[Path, int], bytes]) -> Reading:
    try:
        data = read_bytes(path, MAX_BYTES)
    except FileNotFoundError:
        return Reading(path)
    except NotRegularError as error:
        problem = StoreFormatError(Fault.UNREADABLE, f"{error.strerror}")
        return Reading(path, problem=problem, regular=False)
    except TooLargeError as error:
        problem = StoreFormatError(Fault.UNREADABLE, f"{error.strerror}, more than any store has")
        return Reading(path, problem=problem, foreign=True)
    except OSError as error:
        raise store_error(error, path, "read") from error
    return parsed(path, data)


def parsed(path: Path, data: bytes) -> Reading:
    """Return what `data`, the bytes of `path`, hold."""
    try:
        document, schema = parse(data)
    except StoreFormatError as error:
        return Reading(path, problem=error, foreign=_is_foreign(data, error))
    return Reading(path, document, schema)


def _is_foreign(data: bytes, problem: StoreFormatError) -> bool:
    """Say whether these bytes never were a store: a damaged one begins as it was written, or is empty."""
    if problem.fault is Fault.FOREIGN:
        return True
    beginning = data[:BEGINNING_BYTES]
    return bool(beginning.strip(b"\0\r\n\t ")) and not any(mark in beginning for mark in MARKS)


def take_lock(path: Path, store: Path) -> int:
    """Lock the file `path` for `store`; return its descriptor. Raises StoreLockedError, StoreError."""
    try:
        fd = os.open(path, os.O_RDWR | os.O_CREAT | SAFE, 0o600)
    except OSError as error:
        raise store_error(error, store, "lock") from error
    try:
        locked = try_lock(fd)
    except OSError as error:
        os.close(fd)
        raise store_error(error, store, "lock") from error
    if not locked:
        holder = _holder(fd)
        os.close(fd)
        raise StoreLockedError(store, holder)
    with contextlib.suppress(OSError):  # who holds it is told for convenience
        os.ftruncate(fd, 0)
        os.lseek(fd, 0, os.SEEK_SET)
        os.write(fd, f"{os.getpid()}\n".encode())
    return fd


def is_locked_by(fd: int, path: Path) -> bool:
    """Say whether the lock at `path` is the one taken as `fd`: a removed lock keeps nobody out."""
    try:
        there = path.stat()
    except FileNotFoundError:
        return False
    taken = os.fstat(fd)
    return (there.st_dev, there.st_ino) == (taken.st_dev, taken.st_ino)


def _holder(fd: int) -> int | None:
    try:
        text = os.read(fd, 32).strip()
    except OSError:
        return None
    return int(text) if text.isdigit() else None


def store_error(error: OSError, path: Path, verb: str) -> StoreError:
    """Return a system error as a StoreError that says what failed and what to do about it."""
    verb = "make durable" if isinstance(error, NotDurableError) else verb
    remedy = _REMEDIES.get(error.errno or 0, error.strerror or str(error))
    kind = StoreBusyError if passing(error) else StoreError
    return kind(f"cannot {verb} {path}: {remedy}")
