"""Files and folders that a name given by a person may lead to: opened with care, made with right permissions.

A name may lead to a FIFO that nobody writes, a device without end, or a disk that fails for a moment. Whoever
reads a file that a person named reads it here.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import select
import stat
import sys
import time
from collections.abc import Generator, Iterator
from pathlib import Path

WRONG_NAME = frozenset(
    {
        errno.ENOENT,
        errno.ENOTDIR,
        errno.EISDIR,
        errno.ELOOP,
        errno.ENAMETOOLONG,
        errno.EACCES,
        errno.EPERM,
        errno.EINVAL,
        errno.EEXIST,
        errno.EADDRINUSE,
        errno.ENODEV,
        errno.ENXIO,
    }
)
"""Errors that trying again does not mend: the name is wrong, or what lies there is not ours."""

STANDARD_INPUT, STANDARD_INPUT_NAME = "-", "standard input"
"""What a person writes for it in place of a path, and what messages call it."""

FIRST_WRITER_S = 10.0
"""s: how long a pipe that nobody has opened for writing is waited for."""

NO_WRITER = ("nobody writes to this pipe", "start its writer, or give a file")
"""What is said of a pipe that was waited for in vain, and the remedy."""

_PIECE = 1 << 20
_SYSTEMS_OWN = (Path("/dev"), Path("/proc"))

RESERVE_BYTES = 64 * 2**20
"""Free room that a recording leaves on the disk: the daemon's own files need some."""


def flags(*names: str) -> int:
    """Return the flags of os.open of these names together; one that this system lacks counts nothing."""
    return sum(getattr(os, name, 0) for name in names)


def input_name(path: Path | str) -> str:
    """Return what messages call the input `path`."""
    return STANDARD_INPUT_NAME if str(path) == STANDARD_INPUT else str(path)


def short_name(path: Path | str) -> str:
    """Return what notes and titles call the input `path`: the name of a file without its folder.

    That of a pipe such as /dev/fd/63 says nothing without it.
    """
    name = input_name(path)
    return name if any(Path(name).is_relative_to(own) for own in _SYSTEMS_OWN) else Path(name).name


def is_read_once(path: Path | str) -> bool:
    """Whether what lies at `path` can be read only once: standard input ("-") or a pipe."""
    try:
        return str(path) == STANDARD_INPUT or stat.S_ISFIFO(Path(path).stat().st_mode)
    except (OSError, ValueError):  # ValueError: a null character in the path
        return False


class NotRegularError(OSError):
    """What lies at the name is no regular file."""


class EmptyPipeError(NotRegularError):
    """The pipe at the name gave nothing."""


class NoWriterError(OSError):
    """Nobody writes to the pipe at the name."""


class TooLargeError(OSError):
    """The file is larger than what is looked for can be."""


@contextlib.contextmanager
def naming(path: object) -> Iterator[None]:
    """Name `path` in an OSError of the block that names no file, as that of a full disk does."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def passing(error: OSError) -> bool:
    """Say whether the same call may succeed later: a failing or full disk, no descriptors, no memory."""
    known = error.errno is not None and error.errno not in WRONG_NAME
    return known and not isinstance(error, TooLargeError)


def read_regular(path: Path, limit: int) -> bytes:
    """Return the contents of a regular file of at most `limit` bytes.

    Raises NotRegularError, without waiting for a FIFO's writer, TooLargeError, and other OSError.
    """
    try:
        fd = os.open(path, os.O_RDONLY | flags("O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise NotRegularError(errno.ELOOP, "its links lead in a circle", str(path)) from None
        raise
    try:
        found = os.fstat(fd)
        if not stat.S_ISREG(found.st_mode):
            raise NotRegularError(errno.EINVAL, "not a regular file", str(path))
        if found.st_size > limit:
            raise TooLargeError(errno.EFBIG, f"larger than {limit} bytes", str(path))
        with os.fdopen(fd, "rb", closefd=False) as file:
            data = file.read(limit + 1)
            if data is None:  # a file of /proc that has nothing to read now
                raise NotRegularError(errno.EINVAL, "not a regular file", str(path))
    finally:
        os.close(fd)
    if len(data) > limit:
        raise TooLargeError(errno.EFBIG, f"larger than {limit} bytes", str(path))
    return data


def read_input(path: Path | str, limit: int) -> bytes:
    """Return the contents, `limit` bytes at most, of a regular file, a pipe or standard input ("-").

    Raises NoWriterError, what `read_regular` does, TooLargeError as soon as a pipe has given more, and
    EmptyPipeError where it gives nothing: what should have written to it failed.
    """
    if not is_read_once(path):
        return read_regular(Path(path), limit)
    if str(path) == STANDARD_INPUT:
        data = sys.stdin.buffer.read(limit + 1)
    else:
        data = bytearray()
        with naming(path), contextlib.closing(pipe_pieces(open_pipe(path))) as pieces:
            for piece in pieces:
                data += piece
                if len(data) > limit:
                    break
    if len(data) > limit:
        raise TooLargeError(errno.EFBIG, f"larger than {limit} bytes", input_name(path))
    if not data:
        raise EmptyPipeError(errno.EINVAL, "empty: nothing was written to it", input_name(path))
    return bytes(data)


def open_pipe(path: Path | str) -> int:
    """Return a descriptor to read the pipe at `path` from, without waiting for a writer. Raises OSError.

    A pipe that the shell handed over (/dev/fd/63) is taken as it is: opened anew it would be one more reader,
    who does not know that its writer has been there and has ended.
    """
    handed_over = re.fullmatch(r"/(?:dev|proc/self)/fd/(\d+)", str(path))
    if handed_over:
        return os.dup(int(handed_over[1]))
    return os.open(path, os.O_RDONLY | flags("O_NONBLOCK", "O_CLOEXEC"))


def pipe_pieces(descriptor: int) -> Generator[bytes]:
    """Yield what a pipe gives until its end, and close its descriptor.

    A named pipe without a writer gives an end at once that is none: waits FIRST_WRITER_S for one, then raises
    NoWriterError.
    """
    patience, begun = time.monotonic() + FIRST_WRITER_S, False
    try:
        while True:
            try:
                piece = os.read(descriptor, _PIECE)
            except BlockingIOError:  # there is a writer, who has nothing to say yet
                select.select([descriptor], [], [])
                continue
            if piece:
                begun = True
                yield piece
            elif begun or os.get_blocking(descriptor):
                return
            elif time.monotonic() > patience:
                raise NoWriterError(errno.ENXIO, "; ".join(NO_WRITER))
            else:
                time.sleep(0.05)
    finally:
        os.close(descriptor)


def make_folder(path: Path, mode: int) -> None:
    """Make a folder and those above it with permissions `mode`, less what the umask takes. Raises OSError.

    Unlike Path.mkdir, whose `mode` is not that of the folders above.
    """
    if path.is_dir():
        return
    if path.parent != path:
        make_folder(path.parent, mode)
    path.mkdir(mode=mode, exist_ok=True)
