"""The store's files: reading one, locking it, and what to say where the system refuses.

store.py changes a store; document.py defines the contents of its file.
"""

from __future__ import annotations

import errno
import os
import stat
from dataclasses import dataclass
from pathlib import Path

from stillcal.calib_core.errors import UserError
from stillcal.daemon.store.atomic import SAFE, flags
from stillcal.daemon.store.document import Fault, StoreDocument, StoreFormatError, parse
from stillcal.daemon.store.lock import try_lock

MAX_BYTES = 64 * 2**20
"""No store grows to this; a file that did is not ours and is not read into memory."""

_REMEDIES = {
    errno.ENOSPC: "the disk is full: free some space",
    errno.EDQUOT: "the disk quota is used up: free some space",
    errno.EFBIG: "it would be larger than this process may write: raise the limit (ulimit -f)",
    errno.EROFS: "the file system is read-only: remount it or give another path",
    errno.EACCES: "permission denied: run as the store's owner or give another path",
    errno.EPERM: "not permitted: run as the store's owner or give another path",
    errno.ENOENT: "there is no such folder: create it or give another path",
    errno.EIO: "the disk reports an error: check it (dmesg)",
}


class StoreError(UserError):
    """The store cannot be read or written; the message says why and what to do."""


class StoreLockedError(StoreError):
    """Another process writes this store. pid: which, or None where it did not say."""

    def __init__(self, path: Path, pid: int | None) -> None:
        who = f"process {pid}" if pid else "another process"
        super().__init__(f"{path} is in use by {who}: stop it first, or give another --store")
        self.pid = pid


@dataclass(frozen=True, slots=True)
class Reading:
    """What lies at one path. document is None where nothing is there or `problem` says what is wrong."""

    path: Path
    document: StoreDocument | None = None
    schema: int | None = None
    problem: StoreFormatError | None = None


def read(path: Path) -> Reading:
    """Read what lies at a path. Raises StoreError where it may not be read, or is no regular file."""
    try:
        data = _bytes(path)
    except FileNotFoundError:
        return Reading(path)
    except PermissionError as error:
        raise store_error(error, path, "read") from error
    except OSError as error:
        return Reading(path, problem=StoreFormatError(Fault.UNREADABLE, f"{error.strerror}"))
    try:
        document, schema = parse(data)
    except StoreFormatError as error:
        return Reading(path, problem=error)
    return Reading(path, document, schema)


def _bytes(path: Path) -> bytes:
    fd = os.open(path, os.O_RDONLY | flags("O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))  # a FIFO must not block
    try:
        status = os.fstat(fd)
        if not stat.S_ISREG(status.st_mode):
            raise StoreError(f"{path} is not a regular file: a store cannot be there")
        if status.st_size > MAX_BYTES:
            raise OSError(errno.EFBIG, f"{status.st_size} bytes, more than any store has")
        with os.fdopen(fd, "rb", closefd=False) as file:
            return file.read()
    finally:
        os.close(fd)


def take_lock(path: Path, store: Path) -> int:
    """Lock `path` on behalf of `store` and return its descriptor. Raises StoreLockedError, StoreError."""
    try:
        fd = os.open(path, os.O_RDWR | os.O_CREAT | SAFE, 0o600)
    except OSError as error:
        raise store_error(error, store, "lock") from error
    try:
        if not try_lock(fd):
            holder = os.read(fd, 32).strip()
            raise StoreLockedError(store, int(holder) if holder.isdigit() else None)
        os.ftruncate(fd, 0)
        os.lseek(fd, 0, os.SEEK_SET)
        os.write(fd, f"{os.getpid()}\n".encode())
    except OSError as error:
        os.close(fd)
        raise store_error(error, store, "lock") from error
    except StoreLockedError:
        os.close(fd)
        raise
    return fd


def store_error(error: OSError, path: Path, verb: str) -> StoreError:
    """Return an error of the system's as what could not be done, and what to do about it."""
    remedy = _REMEDIES.get(error.errno or 0, error.strerror or str(error))
    return StoreError(f"cannot {verb} {path}: {remedy}")
