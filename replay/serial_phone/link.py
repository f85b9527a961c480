"""A phone on a pseudo-terminal, which a daemon opens by its path like a USB device.

This module has the bytes, the pace and the plugging; stream.py decides what is sent when. One asyncio loop,
no thread.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import tty
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

from stillcal.calib_core.streams.events import End
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.encoder import WireEncoder, WireSettings
from stillcal.daemon.wire.messages import Claim, Command, Hello, Identify, Message
from stillcal.daemon.wire.reassembly import WireCounters
from stillcal.replay.serial_phone.stream import Chunk, PhoneStream

READ_BYTES = 65_536
"""Bytes read from the terminal at a time, at most."""


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """How the phone is served. wire: how it speaks.

    speed: s of its time in a s of ours, inf for as fast as it is taken. credit: whether it waits for
    grants; a phone faster than time should. step_s: how much of its time a paced phone sends at once.
    repeat_s: after how long, in s of ours, a waiting phone says again where it stands. stride_s: most of its
    time that is in transit at once, and lost by unplugging.
    """

    wire: WireSettings = field(default_factory=WireSettings)
    speed: float = math.inf
    credit: bool = True
    step_s: float = 0.1
    repeat_s: float = 1.0
    stride_s: float = 10.0

    def __post_init__(self) -> None:
        for name in ("speed", "step_s", "repeat_s", "stride_s"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} = {getattr(self, name)}: must be positive")


class PhoneLink:
    """A phone that can be plugged in, pulled out, and plugged in again under another name.

    It keeps silent until a daemon asks who it is and again when that has closed the device; while nobody
    reads, its time stands. What was on its way when it is pulled out is lost, as from a real device.
    """

    def __init__(self, stream: PhoneStream, hello: Hello, settings: LinkSettings | None = None) -> None:
        self.stream = stream
        self.settings = settings or LinkSettings()
        self.hello = hello
        self._encoder = WireEncoder(self.settings.wire)
        self._decoder = WireDecoder()
        self._line: _Line | None = None
        self._asked = self._answered = self._ended = self._parted = False
        self._news = asyncio.Event()
        self._began: tuple[float, float] | None = None

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.unplug()

    @property
    def heard(self) -> WireCounters:
        """Counters of what was received from the daemon."""
        return self._decoder.snapshot()

    def plug(self, path: Path | None = None) -> Path:
        """Appear as a serial device and return its path: `path`, as a link to the terminal, if given.

        Raises FileExistsError where `path` is something else than a link.
        """
        self.unplug()
        self._line = _Line(path, self._hear, self._part)
        self._news.set()
        return self._line.path

    def unplug(self) -> None:
        """Disappear: whoever has the device open meets a hang-up."""
        if self._line is not None:
            self._line.close()
            self._line = None
            self._part()

    async def serve(self) -> None:
        """Send the stream to its end, whatever happens to the line, and wait until the daemon lets go.

        It does so by a sleep without end or by closing the device.
        """
        while not (self._ended and (self.stream.dismissed or self._parted)):
            self._news.clear()
            if not self._asked or (self._answered and self.stream.done):
                await self._news.wait()
            elif not self._answered:
                await self._answer()
            elif self.stream.waiting:
                await self._patience()
            elif (limit := self._limit()) < (due := self.stream.t + self._step_s):
                await self._nap(due)
            else:
                await self._say(self.stream.advance(limit))

    # Time

    @property
    def _step_s(self) -> float:
        return min(self.settings.step_s, self.settings.stride_s)

    def _limit(self) -> float:
        """Return how far the stream may come now, s."""
        t, speed = self.stream.t, self.settings.speed
        if math.isinf(speed):
            return t + self.settings.stride_s
        now = asyncio.get_running_loop().time()
        began, t_began = self._began = self._began or (now, t)
        return min(t_began + speed * (now - began), t + self.settings.stride_s)

    async def _nap(self, until: float) -> None:
        """Wait until the stream's time is due to reach `until`, s, or for a command."""
        await self._news_within((until - self._limit()) / self.settings.speed)

    async def _patience(self) -> None:
        if not await self._news_within(self.settings.repeat_s):
            await self._say(self.stream.standing())

    async def _news_within(self, seconds: float) -> bool:
        """Wait for news so long; asyncio.wait_for would lose a cancellation that comes with them (3.11)."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._news.wait()
        return self._news.is_set()

    # Speech

    def _hear(self, data: bytes) -> None:
        for message in self._decoder.feed(data):
            if isinstance(message, Identify):
                self._asked, self._answered, self._parted, self._began = True, False, False, None
            elif isinstance(message, Command):
                self.stream.obey(message)
        self._news.set()

    def _part(self) -> None:
        self._decoder.end()
        self._asked, self._parted = False, self._ended
        self._news.set()

    async def _answer(self) -> None:
        self._answered = True
        await self._say([self.hello, *self.stream.standing()])

    async def _say(self, messages: Iterable[Message]) -> None:
        for message in messages:
            data = self._encoder.encode(message)
            if self._line is not None and self._asked:
                self._line.send(data)
                await self._line.drained()
                self._ended |= isinstance(message, End)


class _Line:
    """A raw pseudo-terminal. hear: is given what comes; part: is told that the daemon has closed it.

    While no daemon is known to have the device open, it is held open here, or the kernel would report a
    hang-up without pause.
    """

    def __init__(self, path: Path | None, hear: Callable[[bytes], None], part: Callable[[], None]) -> None:
        self._master, slave = os.openpty()
        self._held: int | None = slave
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self._terminal = Path(os.ttyname(slave))
        self.path = self._terminal if path is None else _linked(path, self._terminal)
        self._hear, self._part = hear, part
        self._unsent = bytearray()
        self._empty = asyncio.Event()
        asyncio.get_running_loop().add_reader(self._master, self._read)

    def send(self, data: bytes) -> None:
        """Take bytes to be sent as soon as the terminal takes them."""
        self._unsent += data
        self._write()

    async def drained(self) -> None:
        """Wait until the terminal has taken all, or the line is closed."""
        await self._empty.wait()

    def close(self) -> None:
        """Hang up and remove the link, if it is still this line's."""
        self._forget()
        asyncio.get_running_loop().remove_reader(self._master)
        if self.path.is_symlink() and self.path.readlink() == self._terminal:
            self.path.unlink()
        os.close(self._master)
        self._release()

    def _read(self) -> None:
        try:
            data = os.read(self._master, READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            self._hold()
            self._forget()
            self._part()
            return
        self._release()
        self._hear(data)

    def _write(self) -> None:
        try:
            del self._unsent[: os.write(self._master, self._unsent)]
        except BlockingIOError:
            pass
        except OSError:
            self._unsent.clear()  # nobody is there any more; the reader learns of it
        if self._unsent:
            self._empty.clear()
            asyncio.get_running_loop().add_writer(self._master, self._write)
        else:
            self._forget()

    def _forget(self) -> None:
        """Stop writing: what is still unsent is lost."""
        self._unsent.clear()
        self._empty.set()
        asyncio.get_running_loop().remove_writer(self._master)

    def _hold(self) -> None:
        if self._held is None:
            self._held = os.open(self._terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            tty.setraw(self._held)

    def _release(self) -> None:
        if self._held is not None:
            os.close(self._held)
            self._held = None


def _linked(path: Path, terminal: Path) -> Path:
    """Make `path` a link to the terminal, in place of an older link. Raises FileExistsError on any other."""
    if path.exists() and not path.is_symlink():
        raise FileExistsError(f"{path} exists and is not a link; give another path for the phone")
    fresh = path.with_name(f"{path.name}.{os.getpid()}")
    fresh.symlink_to(terminal)
    return fresh.replace(path)


async def serve_phone(
    chunks: Iterable[Chunk],
    claims: Mapping[str, Claim],
    settings: LinkSettings | None = None,
    path: Path | None = None,
    plugged: Callable[[Path], None] | None = None,
) -> None:
    """Serve one phone from its first chunk until the daemon has heard its end, and hang up.

    claims: as in a recording's NAME.json. path: where it appears (a link), else the terminal's own.
    plugged: is told the path as soon as it is there.
    """
    settings = settings or LinkSettings()
    flow: Literal["credit", "free"] = "credit" if settings.credit else "free"
    hello = Hello(session=int.from_bytes(os.urandom(4)), flow=flow, claims=dict(claims))
    async with PhoneLink(PhoneStream(chunks, settings.credit), hello, settings) as link:
        where = link.plug(path)
        if plugged is not None:
            plugged(where)
        await link.serve()
