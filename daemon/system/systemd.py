"""Talk with systemd: readiness, status, watchdog, and the sockets that it opened.

The protocols are sd_notify(3) and sd_listen_fds(3). Without systemd every call does nothing.
"""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import MutableMapping

FIRST_SOCKET = 3
"""The first descriptor that systemd passes (SD_LISTEN_FDS_START)."""


class Notifier:
    """Sends datagrams to NOTIFY_SOCKET. Never raises and never waits, also where nobody reads them."""

    def __init__(self, environ: MutableMapping[str, str] = os.environ) -> None:
        self._address = environ.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        if self._address[:1] in ("/", "@"):
            kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
            self._socket = socket.socket(socket.AF_UNIX, kind)
        self.watchdog_s = _watchdog(environ)

    def ready(self, status: str) -> None:
        """Report that the service is ready, at the start or after a reload."""
        self._send("READY=1", _status(status))

    def status(self, status: str) -> None:
        """Report the status line."""
        self._send(_status(status))

    def alive(self) -> None:
        """Reset the watchdog."""
        self._send("WATCHDOG=1")

    def reloading(self) -> None:
        """Report that the settings are being read again; `ready` ends it."""
        self._send("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self, status: str) -> None:
        """Report that the service is stopping."""
        self._send("STOPPING=1", _status(status))

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, *lines: str) -> None:
        if self._socket is None:
            return
        address = "\0" + self._address[1:] if self._address[0] == "@" else self._address
        with contextlib.suppress(OSError):
            self._socket.sendto("\n".join(lines).encode(), address)


def passed_sockets(environ: MutableMapping[str, str] = os.environ) -> list[socket.socket]:
    """Return the sockets that systemd opened for this process, once: children do not inherit them.

    Empty where there are none or they are meant for another process.
    """
    names = ("LISTEN_PID", "LISTEN_FDS", "LISTEN_FDNAMES")
    pid, count, _ = (environ.pop(name, "") for name in names)
    if pid != str(os.getpid()) or not count.isdigit():
        return []
    passed = []
    for fd in range(FIRST_SOCKET, FIRST_SOCKET + int(count)):
        os.set_inheritable(fd, False)
        passed.append(socket.socket(fileno=fd))
    return passed


def _watchdog(environ: MutableMapping[str, str]) -> float | None:
    """Return the watchdog's timeout, s; None where there is none, or it is for another process."""
    micros = environ.get("WATCHDOG_USEC", "")
    meant = environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    return int(micros) / 1e6 if micros.isdigit() and int(micros) > 0 and meant else None


def _status(text: str) -> str:
    return "STATUS=" + text.replace("\n", " ")
