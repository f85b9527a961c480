"""Where the bytes of a recording come from: a file, a member of a zip archive, a pipe or standard input.

A pipe is copied into a temporary file first, because a recording is read more than once. Devices, sockets,
endless input and what is of no known format are refused before they could fill memory or disk.
"""

from __future__ import annotations

import io
import os
import shutil
import stat
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from stillcal.daemon.system.files import (
    NO_WRITER,
    STANDARD_INPUT,
    STANDARD_INPUT_NAME,
    NoWriterError,
    flags,
    open_pipe,
    pipe_pieces,
)
from stillcal.replay.formats.errors import TraceError

HEAD_BYTES = 1 << 16
"""Bytes by which a format is recognised."""

MOST_SPOOLED = 8 << 30
"""Bytes copied from a pipe or out of an archive at most: no endless input fills the disk."""

MOST_PACKED, _SMALL = 100, 1 << 26
"""Bytes that one byte of an archive may unpack to, and how many may come besides. Readings of a sensor have
noise, and pack ten times at most; gzip packs zeros a thousand times."""

GZIP = b"\x1f\x8b"
_GZIP_WINDOW = 31
"""For zlib: the largest window, and a gzip header."""

_PIECE, _CHECKED = 1 << 20, 2 * HEAD_BYTES
MOST_PADDING = 1 << 20
"""Zeros that may follow gzip data, as tapes and disks fill their last block: more of them are damage."""

UNREADABLE = (EOFError, zlib.error, zipfile.BadZipFile)
"""What unpacking raises on data that are cut short or damaged."""


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """Stored bytes. path: what messages call them; size: as stored, in bytes.

    local: a file of the same bytes, for libraries that read files only; None for a member of an archive.
    keep: what must live as long as the bytes do. said: how they were come by, where that is to be told.
    """

    path: Path
    size: int
    opener: Callable[[], BinaryIO]
    local: Path | None = None
    keep: Any = None
    said: str = ""

    def open(self) -> BinaryIO:
        """Open the bytes for reading from their start. Raises TraceError where they cannot be had."""
        try:
            return self.opener()
        except FileNotFoundError:
            raise TraceError(self.path, "no such file", "check the path") from None
        except (OSError, *UNREADABLE) as error:
            raise cannot_open(self.path, error) from None
        except (RuntimeError, ValueError) as error:  # zipfile: a password, an unknown compression, a bad name
            what = f"cannot be unpacked ({error})"
            raise TraceError(self.path, what, "unpack the archive and give the folder") from None

    def head(self, size: int = HEAD_BYTES) -> bytes:
        """Return the first bytes, unzipped where they are gzip. Raises TraceError."""
        try:
            with self.open() as file:
                return unpacked(file).read(size)
        except UNREADABLE as error:
            raise damaged(self.path, error) from None
        except OSError as error:
            raise cannot_open(self.path, error) from None

    @property
    def zipped(self) -> bool:
        """Whether the stored bytes are gzip. Raises TraceError where they cannot be read."""
        with self.open() as file:
            return file.read(2) == GZIP


Check = Callable[[Source], object]
"""Raises TraceError where the first bytes are of nothing that is read."""


def source_of(path: Path | str, check: Check = Source.head) -> Source:
    """Return the bytes at `path`; "-" and the name of a pipe are read to their end first.

    check: is called on the beginning of what a pipe gives, before the rest is waited for. Raises TraceError
    where there is no such file, or it is a folder, a device, a socket or one of the kernel's own files.
    """
    if str(path) == STANDARD_INPUT:
        return _standard_input(check)
    path = Path(path)
    try:
        info = path.stat()
    except FileNotFoundError:
        raise TraceError(path, "no such file", "check the path") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise cannot_open(path, error) from None
    if stat.S_ISDIR(info.st_mode):
        raise TraceError(path, "is a folder", "name a file in it")
    if stat.S_ISFIFO(info.st_mode):
        try:
            descriptor = open_pipe(path)
        except OSError as error:
            raise cannot_open(path, error) from None
        return _spooled(path, descriptor, check)
    _refuse_special(path, info.st_mode)
    if info.st_size == 0:
        _refuse_unsized(path)
    return Source(path, info.st_size, lambda: path.open("rb"), path)


def _standard_input(check: Check) -> Source:
    path = Path(STANDARD_INPUT_NAME)
    descriptor = sys.stdin.fileno()
    if os.isatty(descriptor):
        raise TraceError(path, "is a terminal", "pipe a recording into it: stillcal ... - < walk.csv")
    info = os.fstat(descriptor)
    if not stat.S_ISFIFO(info.st_mode) and not stat.S_ISSOCK(info.st_mode):
        _refuse_special(path, info.st_mode)
    return _spooled(path, os.dup(descriptor), check)


def _refuse_special(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        what = "is a device" if stat.S_ISCHR(mode) or stat.S_ISBLK(mode) else "is a socket"
        raise TraceError(path, f"{what}, not a recording", "give a file")


def _refuse_unsized(path: Path) -> None:
    """Refuse a file of size 0 that holds something: one of the kernel's own, such as /proc/kmsg.

    Reading one may wait for ever. Raises TraceError.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | flags("O_NONBLOCK", "O_CLOEXEC"))
        try:
            empty = not os.read(descriptor, 1)
        except BlockingIOError:
            empty = False
        finally:
            os.close(descriptor)
    except OSError as error:
        raise cannot_open(path, error) from None
    if not empty:
        what = "is one of the system's own files, which has no size, and not a recording"
        raise TraceError(path, what, "give a file on a disk")


def _spooled(path: Path, descriptor: int, check: Check) -> Source:
    """Copy what a pipe gives into a temporary file; closes the descriptor."""
    copy = tempfile.NamedTemporaryFile(prefix="stillcal-")  # noqa: SIM115 - lives as long as the source
    size, room, head = 0, _room(), b""
    try:
        with closing(pipe_pieces(descriptor)) as pieces:
            for piece in pieces:
                size += len(piece)
                if len(head) < _CHECKED:
                    head += piece
                    if len(head) >= _CHECKED:
                        check(Source(path, len(head), partial(io.BytesIO, head)))
                if size > room:
                    what = f"gives more than {room / (1 << 30):.2g} GiB"
                    raise TraceError(path, what, "save it as a file first")
                copy.write(piece)
        copy.flush()
    except NoWriterError:
        raise TraceError(path, *NO_WRITER) from None
    except OSError as error:
        what = f"cannot be copied to {tempfile.gettempdir()} ({error.strerror or error})"
        raise TraceError(path, what, "make room there, or save the recording as a file first") from None
    stored = Path(copy.name)
    said = f"copied into a temporary file first ({size / 1e6:.3g} MB)"
    return Source(path, size, lambda: stored.open("rb"), stored, copy, said)


def _room() -> int:
    """Return how many bytes a temporary file may take: half of what is free, and MOST_SPOOLED at most."""
    return min(MOST_SPOOLED, shutil.disk_usage(tempfile.gettempdir()).free // 2)


def unpacked(file: BinaryIO) -> BinaryIO:
    """Return a reader of what `file` holds, unzipped where it is gzip."""
    zipped = file.read(2) == GZIP
    file.seek(0)
    return io.BufferedReader(_Unzipped(file), _PIECE) if zipped else file


class _Unzipped(io.RawIOBase):
    """Reads what gzip data hold, all members one after another, and checks their sums.

    Python's own reader takes zeros after the data one by one, gigabytes of them in hours. Raises EOFError
    where the data break off, zlib.error where they are damaged.
    """

    def __init__(self, file: BinaryIO) -> None:
        super().__init__()
        self._file, self._packed = file, b""
        self._member = zlib.decompressobj(_GZIP_WINDOW)

    def readable(self) -> bool:
        """Whether it can be read: yes."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer in part and return how many bytes of it; 0 at the end."""
        while not self._member.eof or self._begin_next():
            self._packed = self._packed or self._file.read(_PIECE)
            if not self._packed:
                raise EOFError("it ends too early")
            data = self._member.decompress(self._packed, len(buffer))
            self._packed = self._member.unused_data or self._member.unconsumed_tail
            if data:
                buffer[: len(data)] = data
                return len(data)
        return 0

    def _begin_next(self) -> bool:
        """Begin the next member, after some zeros at most; False where there is none."""
        zeros = 0
        while zeros <= MOST_PADDING:
            rest = self._packed.lstrip(b"\0")
            zeros += len(self._packed) - len(rest)
            self._packed = rest or self._file.read(HEAD_BYTES)
            if rest:
                self._member = zlib.decompressobj(_GZIP_WINDOW)
            if rest or not self._packed:
                return bool(rest)
        raise zlib.error(f"more than {MOST_PADDING >> 20} MiB of zeros after its end")


def unpacked_copy(source: Source) -> Source:
    """Return the source's bytes, unzipped, as a file of their own, for a library that needs one.

    Raises TraceError where the data are damaged or more than MOST_SPOOLED, or more than any recording packs.
    """
    if source.local is not None and not source.zipped:
        return source
    copy = tempfile.NamedTemporaryFile(prefix="stillcal-")  # noqa: SIM115 - lives as long as the source
    size, room = 0, min(_room(), _SMALL + MOST_PACKED * source.size)
    try:
        with source.open() as file:
            stream = unpacked(file)
            while piece := stream.read(_PIECE):
                size += len(piece)
                if size > room:
                    what = f"holds more than {room / (1 << 30):.2g} GiB once unpacked"
                    packed = f"{source.size:,} bytes packed"
                    raise TraceError(source.path, f"{what}, from {packed}", "unpack it and give the file")
                copy.write(piece)
        copy.flush()
    except UNREADABLE as error:
        raise damaged(source.path, error) from None
    except OSError as error:
        what = f"cannot be unpacked to {tempfile.gettempdir()} ({error.strerror or error})"
        raise TraceError(source.path, what, "make room there, or unpack it yourself") from None
    stored = Path(copy.name)
    return Source(source.path, size, lambda: stored.open("rb"), stored, copy)


def damaged(path: Path, error: Exception) -> TraceError:
    """Return the error for packed data that cannot be unpacked."""
    kind = "zip" if isinstance(error, zipfile.BadZipFile) else "gzip"
    return TraceError(path, f"{kind} data cut short or damaged ({error})", "copy the recording again")


def cannot_open(path: Path, error: Exception) -> TraceError:
    """Return the error for a file that the system does not open."""
    reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return TraceError(path, f"cannot be opened ({reason})", "check its permissions")
