"""Check that the operating system has what a command needs.

Recordings, stores and reports are files; commands on files run wherever Python runs. The daemon needs Linux,
and its clients need local sockets.
"""

from __future__ import annotations

import importlib

from stillcal.calib_core.errors import UserError

DAEMON = ("fcntl", "termios", "signal.SIGHUP", "socket.AF_UNIX", "socket.SO_PEERCRED", "time.CLOCK_BOOTTIME")
"""For a lock on the store, a serial line, reloading, the socket, and a clock that goes on in suspend."""

LOCAL_SOCKET = ("socket.AF_UNIX",)
PSEUDO_TERMINAL = ("tty", "os.openpty")


class UnsupportedError(UserError):
    """The operating system lacks what a command needs; the message says what and where to run it."""


def require(command: str, names: tuple[str, ...]) -> None:
    """Check that this Python has each module or module attribute. Raises UnsupportedError where it has not.

    >>> require("stillcal query", ("socket.socket",))
    """
    missing = [name for name in names if not _has(name)]
    if missing:
        raise UnsupportedError(f"{command} needs Linux; this system has no {', '.join(missing)}")


def _has(name: str) -> bool:
    module, _, attribute = name.partition(".")
    try:
        return hasattr(importlib.import_module(module), attribute or "__name__")
    except ImportError:
        return False
