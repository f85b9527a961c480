"""Lock a file for one process, with the call that the operating system has.

The kernel releases the lock when the process ends, however it ends, so that no lock is ever stale.
"""

from __future__ import annotations

import importlib
import os
from typing import Any

try:
    import fcntl
except ImportError:  # Windows has msvcrt.locking instead
    fcntl = None  # type: ignore[assignment]

LOCK_BYTE = 1 << 20
"""msvcrt locks bytes, and nobody else can read these: this one lies beyond what the file holds."""


def try_lock(fd: int) -> bool:
    """Lock an open file unless another process has; return whether it is locked. Raises OSError."""
    if fcntl is None:
        return _try_lock_byte(fd)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _try_lock_byte(fd: int) -> bool:
    msvcrt: Any = importlib.import_module("msvcrt")
    os.lseek(fd, LOCK_BYTE, os.SEEK_SET)
    try:
        msvcrt.locking(fd, msvcrt.LK_NBLCK, 1)
    except PermissionError:
        return False
    finally:
        os.lseek(fd, 0, os.SEEK_SET)
    return True
