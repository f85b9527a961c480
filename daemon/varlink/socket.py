"""Create the daemon's socket with the right permissions from the start, and remove it at the end."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path

from stillcal.calib_core.errors import TryAgainError
from stillcal.daemon.settings import SettingsError, SocketSettings
from stillcal.daemon.system.files import make_folder, passing
from stillcal.daemon.varlink.address import socket_path

_FOREIGN_GROUP = "[socket] group: the daemon's user is no member of it: make it one, or leave the group out"


class SocketInUseError(SettingsError):
    """Another daemon listens there."""


@contextlib.contextmanager
def opened(settings: SocketSettings, passed: Sequence[socket.socket]) -> Iterator[list[socket.socket]]:
    """Give the sockets to listen on: those passed, else one made at the settings' path and removed after.

    Raises SettingsError where that cannot be, and TryAgainError where it cannot be now.
    """
    if passed:
        yield list(passed)
        return
    path = socket_path(settings.path)
    try:
        line = _bound(path, settings.mode, group_id(settings.group) if settings.group else None)
    except OSError as error:
        if passing(error):
            raise TryAgainError(f"cannot listen on {path}: {error.strerror}") from error
        raise SettingsError(
            f"cannot listen on {path}: {error.strerror or error}: give another [socket] path"
        ) from error
    made = _identity(path)
    try:
        yield [line]
    finally:
        with contextlib.suppress(OSError):
            if _identity(path) == made:
                path.unlink()


def group_id(name: str) -> int:
    """Return the number of a group of this system. Raises SettingsError where there is none of that name."""
    import grp  # noqa: PLC0415 - only Linux has it

    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        what = f"[socket] group = {name!r}: this system has no such group (`getent group` lists them)"
        raise SettingsError(what) from None


def _bound(path: Path, mode: int, group: int | None) -> socket.socket:
    """Bind a socket at `path` with permissions `mode` from its first moment; a dead daemon's socket goes.

    Where it is to belong to a group, nobody but the owner may use it before it does. Nothing else is
    replaced: bind(2) refuses a name that exists. Called before the daemon has other threads that make files,
    because the process has one umask.
    """
    make_folder(path.parent, 0o755)
    if _answers(path):
        raise SocketInUseError(f"{path} is in use by another daemon: stop it, or give another [socket] path")
    with contextlib.suppress(FileNotFoundError):
        if not stat.S_ISSOCK(path.lstat().st_mode):
            raise FileExistsError(errno.EEXIST, "a file is there that is no socket", str(path))
        path.unlink()
    line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
    before = os.umask(0o777 & ~(mode if group is None else mode & 0o700))
    try:
        line.bind(str(path))
    except BaseException:
        line.close()
        raise
    finally:
        os.umask(before)
    if group is not None:
        try:
            os.chown(path, -1, group)
            path.chmod(mode)
        except OSError as error:
            line.close()
            path.unlink()
            if isinstance(error, PermissionError):
                raise SettingsError(_FOREIGN_GROUP) from None
            raise
    return line


def _answers(path: Path) -> bool:
    """Say whether a daemon listens there. Raises OSError where that cannot be known."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
        line.settimeout(1.0)
        try:
            line.connect(str(path))
        except (FileNotFoundError, ConnectionRefusedError):
            return False
    return True


def _identity(path: Path) -> tuple[int, int, int]:
    found = path.lstat()
    return stat.S_IFMT(found.st_mode), found.st_dev, found.st_ino
