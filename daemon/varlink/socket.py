"""Making the socket, with its permissions from its first moment, and taking it away again."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path

from stillcal.daemon.settings import SettingsError, SocketSettings
from stillcal.daemon.varlink.address import socket_path


class SocketInUseError(SettingsError):
    """Another daemon answers there."""


@contextlib.contextmanager
def opened(settings: SocketSettings, passed: Sequence[socket.socket]) -> Iterator[list[socket.socket]]:
    """Give the sockets to listen on: those passed, else one made at the settings' path and removed after.

    Raises SettingsError where that cannot be.
    """
    if passed:
        yield list(passed)
        return
    path = socket_path(settings.path)
    try:
        line = _bound(path, settings.mode)
    except OSError as error:
        raise SettingsError(
            f"cannot answer on {path}: {error.strerror}: give another [socket] path"
        ) from error
    inode = path.stat().st_ino
    try:
        yield [line]
    finally:
        with contextlib.suppress(OSError):
            if path.stat().st_ino == inode:
                path.unlink()


def _bound(path: Path, mode: int) -> socket.socket:
    """Bind a socket at `path` with permissions `mode` from its first moment; what is dead there goes."""
    path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
    if _answers(path):
        raise SocketInUseError(f"{path} is in use by another daemon: stop it, or give another [socket] path")
    unnamed = path.with_name(f".{path.name}.{os.getpid()}")
    with contextlib.suppress(FileNotFoundError):
        unnamed.unlink()
    line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
    try:
        line.bind(str(unnamed))
        unnamed.chmod(mode)
        unnamed.rename(path)
    except BaseException:
        line.close()
        raise
    return line


def _answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
        line.settimeout(1.0)
        try:
            line.connect(str(path))
        except OSError:
            return False
    return True
