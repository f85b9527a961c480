"""The base of all sources of samples: settings, records of the link, reconnection.

A source runs in callbacks of one asyncio loop. It looks for its phone, reports when it comes and goes, and
keeps its records until they are taken. serial.py and iio.py say which phone and how it is read.
"""

from __future__ import annotations

import asyncio
import zlib
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from stillcal.daemon.wire.messages import Command, Message
from stillcal.daemon.wire.reassembly import WireCounters


@dataclass(frozen=True, slots=True)
class SerialSettings:
    """Which line to open, and how often to try.

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

        The jitter is a pure function of port and attempt: several daemons do not try in step, and a run
        can be repeated.
        """
        full = min(self.retry_s * 2.0 ** min(attempt - 1, 60), self.retry_max_s)
        draw = zlib.crc32(f"{self.port}:{attempt}".encode()) / 0xFFFFFFFF
        return full * (1.0 + self.jitter * (2.0 * draw - 1.0))


@dataclass(frozen=True, slots=True)
class LinkUp:
    """The line was opened. device: the path; attempts: failed or useless ones before."""

    device: str
    attempts: int


@dataclass(frozen=True, slots=True)
class LinkDown:
    """The line was lost, or (device "") could not be opened, for this new reason."""

    device: str
    reason: str


@dataclass(slots=True)
class LinkCounters:
    """Counts of the line's events. pauses: how often a full queue stopped reading."""

    connections: int = 0
    disconnections: int = 0
    failed_attempts: int = 0
    pauses: int = 0
    commands_sent: int = 0
    commands_dropped: int = 0


Record = Message | LinkUp | LinkDown


class Source(ABC):
    """A source of records, in order of time, that reconnects whenever the phone is lost.

    Enter it once; then one task takes records until it is closed.
    """

    def __init__(self, settings: SerialSettings) -> None:
        self.settings = settings
        self.link = LinkCounters()
        self._records: deque[Record] = deque()
        self._wakeup = asyncio.Event()
        self._failures = 0
        self._last_reason: str | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._closed = False

    async def __aenter__(self) -> Self:
        self._connect()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    @abstractmethod
    def connected(self) -> bool:
        """Whether a phone is connected now."""

    @property
    @abstractmethod
    def device(self) -> str:
        """The path of the phone's device; "" without one."""

    @property
    @abstractmethod
    def wire(self) -> WireCounters:
        """A copy of the counters of the wire."""

    @abstractmethod
    def send(self, command: Command) -> bool:
        """Send a command to the phone; return whether it was queued."""

    @property
    def pending(self) -> bool:
        """Whether there are records to take."""
        return bool(self._records)

    async def take(self) -> list[Record]:
        """Wait for records and return all of them; an empty list once the source is closed."""
        while not self._records and not self._closed:
            self._wakeup.clear()
            await self._wakeup.wait()
        records = list(self._records)
        self._records.clear()
        self._resume()
        return records

    async def let_gather(self, seconds: float) -> None:
        """Let records gather for this long, s."""
        await asyncio.sleep(seconds)

    def close(self) -> None:
        """Release the phone for good; records read before can still be taken."""
        if self._closed:
            return
        self._closed = True
        self._cancel()
        if self.connected:
            self._lose("closed", for_good=True)
        self._wakeup.set()

    @abstractmethod
    def _connect(self) -> None:
        """Look for the phone; call `_fail` where there is none."""

    @abstractmethod
    def _lose(self, reason: str, for_good: bool = False) -> None:
        """Release the phone and report it by `_line_down`."""

    def _resume(self) -> None:  # noqa: B027 - only a line can be held back
        """Continue reading after a full queue has been emptied."""

    def _emit(self, record: Record) -> None:
        self._records.append(record)
        self._wakeup.set()

    def _opened(self, device: str) -> None:
        self.link.connections += 1
        self._emit(LinkUp(device, self._failures))
        self._last_reason = None

    def _fail(self, reason: str) -> None:
        """Report, once for each reason, that there is no phone, and try again later."""
        self.link.failed_attempts += 1
        if reason != self._last_reason:
            self._last_reason = reason
            self._emit(LinkDown("", reason))
        self._retry_later()

    def _line_down(self, device: str, reason: str, for_good: bool) -> None:
        self.link.disconnections += 1
        self._emit(LinkDown(device, reason))
        if not for_good:
            self._retry_later()

    def _retry_later(self) -> None:
        self._failures += 1
        self._schedule(self.settings.wait(self._failures), self._connect)

    def _schedule(self, delay: float, job: Callable[[], None]) -> None:
        self._timer = asyncio.get_running_loop().call_later(delay, job)

    def _cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
