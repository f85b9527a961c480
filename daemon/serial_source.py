"""The phone's serial line: opening it, reading and writing it on the event loop, and getting it back.

Everything runs in callbacks of one asyncio loop; no thread, no task. What arrives is decoded at once and
waits in a bounded queue; when that is full, reading stops and the kernel holds the sender back. What the
bytes mean is wire.py's, what to do about it is the service's.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import glob
import os
import termios
import zlib
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import serial

from stillcal.daemon.wire import (
    Command,
    Form,
    Identify,
    Message,
    WireCounters,
    WireDecoder,
    WireEncoder,
    WireSettings,
)

READ_BYTES = 65_536
UNSENT_LIMIT = 65_536
"""Bytes of commands that may wait for a device that does not read; further commands are dropped."""


@dataclass(frozen=True, slots=True)
class SerialSettings:
    """Which line, and how patiently.

    port: the device's path, or a pattern ("/dev/serial/by-id/usb-Arduino*") whose matches are tried in
    order of their names at every attempt. baud: symbols per s on a real line. retry_s: wait after the
    first failed attempt; each further one doubles it up to retry_max_s, and jitter spreads it by that
    share either way. queue: messages that may wait to be taken before reading stops.
    """

    port: str
    baud: int = 115200
    retry_s: float = 0.1
    retry_max_s: float = 5.0
    jitter: float = 0.25
    queue: int = 1024

    def __post_init__(self) -> None:
        if not self.port:
            raise ValueError("port = '': must be the path of a serial device or a pattern of such paths")
        if not 1200 <= self.baud <= 4_000_000:
            raise ValueError(f"baud = {self.baud}: must be within 1200..4000000")
        if not 0 < self.retry_s <= self.retry_max_s <= 3600:
            raise ValueError(
                f"retry_s = {self.retry_s}, retry_max_s = {self.retry_max_s}: "
                "must be within 0 < retry_s <= retry_max_s <= 3600 s"
            )
        if not 0 <= self.jitter <= 1:
            raise ValueError(f"jitter = {self.jitter}: must be within 0..1")
        if not 1 <= self.queue <= 1_000_000:
            raise ValueError(f"queue = {self.queue}: must be within 1..1000000 messages")

    def wait(self, attempt: int) -> float:
        """Return how long to wait, in s, after the attempt-th failure in a row (from 1).

        The spread is a pure function of port and attempt, so that many daemons do not knock in step and
        one run is like the next.
        """
        full = min(self.retry_s * 2.0 ** min(attempt - 1, 60), self.retry_max_s)
        draw = zlib.crc32(f"{self.port}:{attempt}".encode()) / 0xFFFFFFFF
        return full * (1.0 + self.jitter * (2.0 * draw - 1.0))


@dataclass(frozen=True, slots=True)
class LinkUp:
    """The line was opened. device: the path; attempts: those before it that failed or brought nothing."""

    device: str
    attempts: int


@dataclass(frozen=True, slots=True)
class LinkDown:
    """The line was lost, or (device "") could not be opened, for this new reason."""

    device: str
    reason: str


@dataclass(slots=True)
class LinkCounters:
    """What the line went through. pauses: how often a full queue stopped reading."""

    connections: int = 0
    disconnections: int = 0
    failed_attempts: int = 0
    pauses: int = 0
    commands_sent: int = 0
    commands_dropped: int = 0


Record = Message | LinkUp | LinkDown


class SerialSource:
    """A line that is opened again whenever it is lost. Records come out in the order of their happening.

    Iterate over it, or call `take`, from one task. Between LinkUp and LinkDown lies what one connection
    brought; nothing that was read from the device is lost between the two.
    """

    def __init__(self, settings: SerialSettings) -> None:
        self.settings = settings
        self.link = LinkCounters()
        self._decoder = WireDecoder()
        self._encoders = {form: WireEncoder(WireSettings(form=form)) for form in Form}
        self._records: deque[Record] = deque()
        self._news = asyncio.Event()
        self._port: serial.Serial | None = None
        self._unsent = bytearray()
        self._reading = self._writing = False
        self._failures = 0
        self._told: str | None = None
        self._retry: asyncio.TimerHandle | None = None
        self._closed = False

    async def __aenter__(self) -> Self:
        self._connect()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # For the one who takes

    @property
    def connected(self) -> bool:
        """Whether a device is open now."""
        return self._port is not None

    @property
    def device(self) -> str:
        """Path of the device that is open, "" where none is."""
        return "" if self._port is None else str(self._port.port)

    @property
    def wire(self) -> WireCounters:
        """A copy of the decoder's counters."""
        return self._decoder.snapshot()

    async def take(self) -> list[Record]:
        """Wait until there is something and return all of it; an empty list once the source is closed."""
        await self._something()
        records = list(self._records)
        self._records.clear()
        self._resume()
        return records

    async def __aiter__(self) -> AsyncIterator[Record]:
        while await self._something():
            record = self._records.popleft()
            self._resume()
            yield record

    async def _something(self) -> bool:
        while not self._records and not self._closed:
            self._news.clear()
            await self._news.wait()
        return bool(self._records)

    def send(self, command: Command) -> bool:
        """Send a command in the form that the device speaks; say whether it is on its way.

        It is not, and is forgotten, while no device is open or the device has long not been reading.
        """
        form = self._decoder.form or Form.BINARY
        sent = self._put(self._encoders[form].encode(command))
        self.link.commands_sent += sent
        self.link.commands_dropped += not sent
        return sent

    def close(self) -> None:
        """Close the line for good; what was read before can still be taken."""
        if self._closed:
            return
        self._closed = True
        if self._retry is not None:
            self._retry.cancel()
        if self._port is not None:
            self._lose("closed", for_good=True)
        self._news.set()

    # Opening

    def _connect(self) -> None:
        """Try every device that the settings mean; where none opens, try again later."""
        self._retry = None
        reason = "no such device"
        for device in self._candidates():
            try:
                self._port = _opened(device, self.settings.baud)
            except (serial.SerialException, OSError, termios.error, ValueError) as error:
                reason = str(error)
                continue
            self._greet(device)
            return
        self._fail(reason)

    def _candidates(self) -> list[str]:
        port = self.settings.port
        return sorted(glob.glob(port)) if glob.has_magic(port) else [port]  # noqa: PTH207 - may be absolute

    def _greet(self, device: str) -> None:
        """Ask who is there, in both forms: neither kind of device minds the other's."""
        self.link.connections += 1
        self._emit(LinkUp(device, self._failures))
        self._told = None
        self._unsent.clear()
        self._resume()
        binary, text = (self._encoders[form].encode(Identify()) for form in (Form.BINARY, Form.TEXT))
        self._put(binary + b"\n" + text)

    def _fail(self, reason: str) -> None:
        self.link.failed_attempts += 1
        self._failures += 1
        if reason != self._told:
            self._told = reason
            self._emit(LinkDown("", reason))
        self._schedule()

    def _schedule(self) -> None:
        loop = asyncio.get_running_loop()
        self._retry = loop.call_later(self.settings.wait(self._failures), self._connect)

    def _lose(self, reason: str, for_good: bool = False) -> None:
        port, self._port = self._port, None
        assert port is not None
        self._stop(port.fileno())
        with contextlib.suppress(OSError, termios.error):
            termios.tcflush(port.fileno(), termios.TCOFLUSH)  # or close() waits for a stuck device
        port.close()
        self.link.disconnections += 1
        for message in self._decoder.end():
            self._emit(message)
        self._emit(LinkDown(str(port.port), reason))
        if not for_good:
            self._failures += 1
            self._schedule()

    # Reading

    def _read(self) -> None:
        assert self._port is not None
        try:
            data = os.read(self._port.fileno(), READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._lose(error.strerror or errno.errorcode.get(error.errno or 0, "I/O error"))
            return
        if not data:
            self._lose("hung up")
            return
        for message in self._decoder.feed(data):
            self._failures = 0  # only a device that makes sense ends the back-off
            self._emit(message)
        if len(self._records) >= self.settings.queue:
            self._pause()

    def _emit(self, record: Record) -> None:
        self._records.append(record)
        self._news.set()

    def _pause(self) -> None:
        if self._reading and self._port is not None:
            asyncio.get_running_loop().remove_reader(self._port.fileno())
            self._reading = False
            self.link.pauses += 1

    def _resume(self) -> None:
        if not self._reading and self._port is not None and len(self._records) <= self.settings.queue // 2:
            asyncio.get_running_loop().add_reader(self._port.fileno(), self._read)
            self._reading = True

    def _stop(self, fd: int) -> None:
        loop = asyncio.get_running_loop()
        loop.remove_reader(fd)
        loop.remove_writer(fd)
        self._reading = self._writing = False

    # Writing

    def _put(self, data: bytes) -> bool:
        if self._port is None or len(self._unsent) + len(data) > UNSENT_LIMIT:
            return False
        self._unsent += data
        if not self._writing:
            self._write()
        return True

    def _write(self) -> None:
        assert self._port is not None
        fd, loop = self._port.fileno(), asyncio.get_running_loop()
        try:
            del self._unsent[: os.write(fd, self._unsent)]
        except BlockingIOError:
            pass
        except OSError:
            self._unsent.clear()  # the reader learns of the loss, after what still arrived
        if self._unsent and not self._writing:
            loop.add_writer(fd, self._write)
        elif not self._unsent and self._writing:
            loop.remove_writer(fd)
        self._writing = bool(self._unsent)


def _opened(device: str, baud: int) -> serial.Serial:
    """Open `device` raw, locked against others, and so that a read tells silence from a hang-up.

    pyserial sets VMIN to 0, with which a read of nothing returns 0 bytes as a hang-up does (termios(3));
    with 1 it says EAGAIN. Raises serial.SerialException, OSError or termios.error.
    """
    port = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
    try:
        attributes = termios.tcgetattr(port.fileno())
        attributes[6][termios.VMIN] = 1
        termios.tcsetattr(port.fileno(), termios.TCSANOW, attributes)
    except BaseException:
        port.close()
        raise
    return port
