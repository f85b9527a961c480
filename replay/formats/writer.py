"""Writing a recording as CSV with its events and claims: streaming, at full precision, atomically.

Numbers are written in the shortest form that reads back to the same bits (msgspec's; about four times
as fast here as joining Python's repr, twenty times numpy.savetxt).
"""

from __future__ import annotations

import contextlib
import errno
import gzip
import io
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Samples
from stillcal.daemon.store.atomic import led_to, write_atomically
from stillcal.replay.formats.claims import Claims, Event, beside, event_line, holds_claims
from stillcal.replay.formats.errors import TraceError

STANDARD_OUTPUT = Path("-")

_BATCH_ROWS = 8192
"""Rows encoded at a time, so that memory stays flat."""

_ZIP_LEVEL = 4
"""Half the time of level 6, for files 8 % larger (a recording of 7.9 MB)."""

SPARE_BYTES = 2**20
"""More than a recording still writes after the last block that it took, compressed or not."""

_encoder = msgspec.json.Encoder()


class TraceWriter:
    """Writes NAME.csv (or .csv.gz), NAME.events.jsonl and NAME.json; a context manager.

    gyroscope, temperature, arrival: whether the recording has these columns. side_files: whether events and
    claims are written, or left as they stand. sparing: whether some room is kept, by which all is completed
    on a disk that others fill; `filled` says that they have. All is written under temporary names in the same
    folder and renamed when the block ends well; when it ends in an error nothing is left behind and what
    stood there stays. Raises TraceError where the folder does not take it.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        gyroscope: bool = True,
        temperature: bool = False,
        arrival: bool = False,
        claims: Claims | None = None,
        side_files: bool = True,
        sparing: bool = False,
    ) -> None:
        self.path = Path(path)
        self._gyroscope, self._temperature, self._arrival = gyroscope, temperature, arrival
        self._claims = claims
        self._side_files, self._sparing = side_files, sparing
        self._room: SparingFile | None = None
        self._events: list[Event] = []
        self._target = led_to(self.path)
        self._temporary = self._target.with_name(f".{self._target.name}.{os.getpid()}.part")
        self._file: BinaryIO | None = None
        self._stream: BinaryIO | io.BufferedIOBase | None = None

    @property
    def columns(self) -> list[str]:
        """The header."""
        optional = [("temperature", self._temperature), ("t_arrival", self._arrival)]
        gyroscope = ["gx", "gy", "gz"] if self._gyroscope else []
        return ["t", "ax", "ay", "az", *gyroscope, *(name for name, there in optional if there)]

    def __enter__(self) -> TraceWriter:
        if self._target.is_symlink() or (self.path.exists() and not self.path.is_file()):
            remedy = "give a file's name, or '-' for standard output"
            raise TraceError(self.path, "is no regular file and is not replaced", remedy)
        claims = beside(self.path, ".json")
        if self._side_files and self._claims is not None and claims.exists() and not holds_claims(claims):
            what = "would be replaced by the maker's claims, and is none"
            raise TraceError(claims, what, f"move it, or write {self.path.name} under another name")
        try:
            self._file = self._opened()
        except OSError as error:
            raise self._refused(error) from None
        try:
            self._begin(self._file)
        except BaseException:
            self._discard()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._finish()
        except OSError as failure:
            raise self._refused(failure) from None
        finally:
            self._discard()

    def write(
        self, accelerometer: Samples, gyroscope: Samples | None = None, events: Iterable[Event] = ()
    ) -> None:
        """Append samples in time order; where the sensors' stamps differ, the other one's cells stay empty.

        All samples of one call come before those of the next. Of equal stamps in one sensor the last
        sample is kept.
        """
        self._events.extend(events)
        self._append(self._rows(accelerometer, gyroscope if self._gyroscope else None))

    @property
    def filled(self) -> bool:
        """Whether the disk was full, so that the recording must be completed now."""
        return self._room is not None and self._room.filled

    def _opened(self) -> BinaryIO:
        if not self._sparing:
            return self._temporary.open("wb")
        self._room = SparingFile(self._temporary)
        return io.BufferedWriter(self._room)

    def _begin(self, file: BinaryIO) -> None:
        """Begin the recording's own file."""
        packed = self.path.suffix == ".gz"
        self._stream = gzip.GzipFile("", "wb", _ZIP_LEVEL, file, mtime=0) if packed else file
        self._put(",".join(self.columns).encode() + b"\n")

    def _append(self, rows: Array) -> None:
        """Append rows (n, columns), NaN where a cell stays empty."""
        for first in range(0, len(rows), _BATCH_ROWS):
            text = _encoder.encode_lines(rows[first : first + _BATCH_ROWS].tolist())
            self._put(text.translate(None, b"[]").replace(b"null", b""))

    def _rows(self, accelerometer: Samples, gyroscope: Samples | None) -> Array:
        """Return the table of one call: (n, columns), NaN where a cell stays empty."""
        parts = [s for s in (gyroscope, accelerometer) if s is not None and len(s)]
        if not parts:
            return np.empty((0, len(self.columns)))
        shared = len(parts) == 1 or np.array_equal(parts[0].t, parts[1].t)
        t = parts[-1].t if shared else np.union1d(parts[0].t, parts[1].t)
        rows = np.full((t.size, len(self.columns)), np.nan)
        rows[:, 0] = t
        for samples in parts:
            at = slice(None) if shared else np.searchsorted(t, samples.t)
            first = 1 if samples is accelerometer else 4
            rows[at, first : first + 3] = samples.xyz
            for name, column in (("temperature", samples.temperature), ("t_arrival", samples.t_arrival)):
                if column is not None and name in self.columns:
                    rows[at, self.columns.index(name)] = column
        return rows

    def _put(self, data: bytes) -> None:
        if self._stream is None:
            raise RuntimeError("a TraceWriter writes inside a with block only")
        try:
            self._stream.write(data)
        except BrokenPipeError:  # whoever read standard output has had enough
            raise
        except OSError as error:
            raise self._refused(error) from None

    def _end(self) -> None:
        """Complete the recording's own file, which stays open."""
        if self._stream is not None and self._stream is not self._file:
            self._stream.close()

    def _finish(self) -> None:
        """Complete all files, then rename them into place, the recording itself last."""
        assert self._file is not None
        self._end()
        self._file.flush()
        if self._room is not None:
            self._room.free()
        os.fsync(self._file.fileno())
        self._file.close()
        if self._side_files:
            self._write_side_files()
        self._temporary.replace(self._target)

    def _write_side_files(self) -> None:
        events = beside(self.path, ".events.jsonl")
        if self._events:
            write_atomically(events, b"".join(map(event_line, self._events)))
        else:
            events.unlink(missing_ok=True)
        if self._claims is not None:
            write_atomically(beside(self.path, ".json"), msgspec.json.encode(self._claims.without_counts()))

    def _discard(self) -> None:
        if self._room is not None:
            self._room.free()
        if self._file is not None:
            with contextlib.suppress(OSError):  # what waits to be written may not fit
                self._file.close()
        with contextlib.suppress(OSError):
            self._temporary.unlink(missing_ok=True)
        self._file = self._stream = None

    def _refused(self, error: OSError) -> TraceError:
        what = f"cannot be written ({error.strerror or error})"
        return TraceError(self.path, what, "name a file in a folder that exists, can be written and has room")


class StandardOutputWriter(TraceWriter):
    """Writes a recording as CSV on standard output, without its events and claims, while it is made."""

    def __enter__(self) -> StandardOutputWriter:
        self._begin(sys.stdout.buffer)
        return self

    def _finish(self) -> None:
        sys.stdout.buffer.flush()

    def _discard(self) -> None:
        self._stream = None

    def _refused(self, error: OSError) -> TraceError:
        what = f"cannot be written ({error.strerror or error})"
        return TraceError("standard output", what, "lead it to a disk that has room")


class SparingFile(io.FileIO):
    """A file opened for writing; `filled` once the disk was full and the spare room is in use.

    The spare file is written, not only lengthened, or the room would not be taken. Raises OSError where there
    is no room for it, and later where the spare room is used up too.
    """

    def __init__(self, path: Path) -> None:
        self._spare = path.with_name(f"{path.name}.spare")
        self.filled = False
        try:
            self._spare.write_bytes(bytes(SPARE_BYTES))
            super().__init__(path, "w")
        except BaseException:
            self.free()
            raise

    def write(self, data: Any, /) -> int:
        """Write, on a full disk into the spare room."""
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT) or self.filled:
                raise
        self.filled = True
        self.free()
        return super().write(data)

    def free(self) -> None:
        """Give the spare room back, so that the disk has it for what is written beside the file."""
        with contextlib.suppress(OSError):
            self._spare.unlink()
