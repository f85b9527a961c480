"""Replace a file so that neither a reader nor a crash nor a full disk leaves half of it.

Write a temporary beside the target, fsync it, rename it over the target, fsync the folder. Where a name is a
link, the target is the file that it leads to. Nothing here knows what is written.
"""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path

from stillcal.daemon.system.files import flags, naming

SAFE = flags("O_CLOEXEC", "O_NOFOLLOW", "O_BINARY")
"""For files that are written: no child inherits them, no link stands in for them, no line end is changed."""


class NotDurableError(OSError):
    """The file was replaced whole, but its folder could not be synced: a power cut may undo the change."""


def write_atomically(path: Path, data: bytes, mode: int = 0o644) -> None:
    """Replace the file at `path` by `data`, with permissions `mode`; the old stays until the new is whole.

    The temporary is `path` with `.tmp` added, so that crashes leave at most one, which the next write
    replaces, as it does whatever else lies there but a folder; `path` may have one writer at a time. Raises
    OSError (disk full, read-only folder, I/O error) with the old file intact and the temporary removed, and
    NotDurableError where only the last step, the sync of the folder, failed. A failed fsync is never tried
    again on the same file: the kernel may have dropped the pages and would then report success (fsync(2),
    errors). A device, a pipe or a socket at `path` is never replaced: OSError. A link at `path` stays one:
    its file is replaced.
    """
    path = led_to(path)
    if path.is_symlink() or (path.exists() and not (path.is_file() or path.is_dir())):
        raise OSError(errno.EINVAL, "is no regular file and is not replaced", str(path))
    temporary = path.with_name(path.name + ".tmp")
    try:
        with naming(path):
            _write_synced(temporary, data, mode)
            temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    try:
        sync_folder(path.parent)
    except OSError as error:
        raise NotDurableError(error.errno, error.strerror, str(path)) from error


def led_to(path: Path) -> Path:
    """Return the file that a name stands for: of a link the file at its end, which need not exist.

    Of links that lead in a circle it is one of these.
    """
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def sync_folder(folder: Path) -> None:
    """Make renames and removals in `folder` durable, where the system can sync a folder (not Windows)."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    fd = os.open(folder, os.O_RDONLY | flags("O_DIRECTORY", "O_CLOEXEC"))
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def _write_synced(path: Path, data: bytes, mode: int) -> None:
    path.unlink(missing_ok=True)  # what a crash left, or a FIFO, which opening would wait for
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | SAFE, mode), "wb") as file:
        if hasattr(os, "fchmod"):
            os.fchmod(file.fileno(), mode)  # os.open's mode is cut by the umask
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
