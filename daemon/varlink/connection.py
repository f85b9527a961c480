"""One client's connection: its bytes, its limits and its turn. server.py decides who may connect.

asyncvarlink knows the interface, the conversion and the order of replies; the bytes are read here, by
asyncio's own transport, because asyncvarlink's reads from one client until it has no more to say and sets
no limit to a message.
"""

from __future__ import annotations

import asyncio
import os
import select
import socket
import struct
from typing import Any, Protocol

import msgspec
from asyncvarlink import VarlinkInterfaceRegistry, VarlinkInterfaceServerProtocol
from asyncvarlink.serviceinterface import InvalidParameter

from stillcal.calib_core.streams.smoothing import RollingMean
from stillcal.daemon.settings import SocketSettings
from stillcal.daemon.system.clock import Clock
from stillcal.daemon.varlink.interface import CALLER
from stillcal.daemon.varlink.rows import too_large

UNSENT_BYTES = 262_144
"""Unread replies of one client, bytes; above this its next request waits and its stall timer runs."""


class ConnectionOwner(Protocol):
    """The server that a connection belongs to. dropped: number of clients that were disconnected."""

    settings: SocketSettings
    clock: Clock
    dropped: int

    def enter(self, client: Connection) -> None:
        """Add a client."""

    def leave(self, client: Connection) -> None:
        """Remove a client."""

    def queue(self, client: Connection, wait_s: float) -> None:
        """Answer a client's request in its turn, after at least `wait_s`."""


class Connection(VarlinkInterfaceServerProtocol, asyncio.Protocol):
    """One client. Its requests are answered one at a time, in turn with those of other clients.

    cost: of its last answer, s; turn: how much of the time of answering it has had, s, as its server counts.
    """

    def __init__(self, registry: VarlinkInterfaceRegistry, server: ConnectionOwner) -> None:
        super().__init__(registry)
        self._server = server
        self._line: asyncio.Transport | None = None
        self._buffer = bytearray()
        self._searched = 0
        self._congested = self._eof = False
        self._unsent: list[asyncio.Future[None]] = []
        self._stall_timer: asyncio.TimerHandle | None = None
        self._subscriber: Any = None
        self._call_credit, self._credit_at = server.settings.calls_per_s, server.clock()
        self.answering = False
        self.turn = self.cost = 0.0
        self.may_change = False
        self.rolling_means: dict[str, RollingMean] = {}

    def on_disconnect(self, subscriber: Any) -> None:
        """Close `subscriber` when the client has gone, which it may have already."""
        self._subscriber = subscriber
        if self._line is None or self._eof:
            self.end_subscription()

    @property
    def listening(self) -> bool:
        """Whether the client is subscribed."""
        return self._subscriber is not None

    # Called by asyncio

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Register the client with the server."""
        assert isinstance(transport, asyncio.Transport)
        self._line = transport
        transport.set_write_buffer_limits(UNSENT_BYTES)
        self.may_change = _may_change(transport.get_extra_info("socket"))
        self._server.enter(self)

    def data_received(self, data: bytes) -> None:
        """Buffer bytes until the client's turn."""
        self._buffer += data
        if self.answering and len(self._buffer) > self._server.settings.message_bytes:
            self.drop()
        self._next_question()

    def eof_received(self) -> bool:  # type: ignore[override]  # asyncio's, whose True keeps our side open
        """Answer what was asked, then hang up; its subscription ends. Who takes no answer has gone."""
        self._eof = True
        self.end_subscription()
        if self.answering and self._line is not None and _hung_up(self._line.get_extra_info("socket")):
            self.hang_up()
        self._next_question()
        return True

    def connection_lost(self, exc: Exception | None) -> None:
        """Unregister the client."""
        self._line = None
        self._buffer.clear()
        self._stop_stall_timer()
        self.end_subscription()
        self._release_senders()
        self._server.leave(self)

    def pause_writing(self) -> None:
        """Start the stall timer of a client that does not read its replies."""
        self._congested = True
        self._start_stall_timer()

    def resume_writing(self) -> None:
        """Continue with a client that has read its replies."""
        self._congested = False
        self._stop_stall_timer()
        self._release_senders()
        self._next_question()

    # Requests

    def _next_question(self) -> None:
        """Queue the next request if it is complete."""
        if self._line is None or self.answering:
            return
        end = self._buffer.find(0, self._searched)
        self._searched = len(self._buffer) if end < 0 else end
        if (len(self._buffer) if end < 0 else end) > self._server.settings.message_bytes:
            self.drop()
        elif end >= 0:
            self._line.pause_reading()
            self._server.queue(self, self._delay())
        elif self._eof:
            self._line.close()
        else:
            self._line.resume_reading()
            self._start_stall_timer() if self._buffer else self._stop_stall_timer()

    def answer(self) -> None:
        """Answer the first buffered request; called in this client's turn."""
        end = self._buffer.find(0)
        if self._line is None or self._congested or self.answering or end < 0:
            return
        self._stop_stall_timer()
        question = bytes(self._buffer[:end])
        del self._buffer[: end + 1]
        self._searched = 0
        if too_large(question):
            self.send_error(InvalidParameter(parameter="parameters"))
            self._next_question()
            return
        try:
            request = msgspec.json.decode(question)
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
            request = None
        if isinstance(request, dict):
            self._answer(request)
        else:
            self.drop()

    def _answer(self, request: dict[str, Any]) -> None:
        CALLER.set(self)
        reply = self.request_received(request, None)
        if reply is None or reply.done():
            self._next_question()
            return
        self.answering = True
        if self._line is not None:
            self._line.resume_reading()  # or nobody would notice that the client leaves
        reply.add_done_callback(self._answered)

    def _answered(self, reply: asyncio.Future[None]) -> None:
        self.answering = False
        self._subscriber = None
        self._next_question()

    def _delay(self) -> float:
        """Count one request and return how long it must wait, s (token bucket of one second's calls)."""
        now, rate = self._server.clock(), self._server.settings.calls_per_s
        self._call_credit = min(self._call_credit + rate * (now - self._credit_at), rate) - 1.0
        self._credit_at = now
        return max(-self._call_credit / rate, 0.0)

    # Replies

    def send_message(
        self, obj: Any, fds: list[int] | None = None, autoclose: bool = True
    ) -> asyncio.Future[None]:
        """Send a reply; the future is done once the client can take the next one, or has disconnected."""
        sent: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        if self._line is not None and not self._line.is_closing():
            self._line.write(msgspec.json.encode(obj) + b"\0")
        if self._congested and self._line is not None:
            self._unsent.append(sent)
        else:
            sent.set_result(None)
        return sent

    def _release_senders(self) -> None:
        for future in self._unsent:
            if not future.done():
                future.set_result(None)
        self._unsent.clear()

    # Stalling and ending

    def _start_stall_timer(self) -> None:
        if self._stall_timer is None:
            loop = asyncio.get_running_loop()
            self._stall_timer = loop.call_later(self._server.settings.stall_s, self.drop)

    def _stop_stall_timer(self) -> None:
        if self._stall_timer is not None:
            self._stall_timer.cancel()
            self._stall_timer = None

    def end_subscription(self) -> None:
        """End the client's subscription."""
        if self._subscriber is not None:
            self._subscriber.close()
            self._subscriber = None

    def drop(self) -> None:
        """Disconnect without a reply and count it."""
        self._server.dropped += 1
        self.hang_up()

    def hang_up(self) -> None:
        """Disconnect at once; unsent replies are dropped."""
        if self._line is not None:
            self._line.abort()


def _may_change(line: socket.socket) -> bool:
    """Return whether the client is root or the daemon's own user, from the kernel (SO_PEERCRED, unix(7))."""
    credentials = line.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    _, uid, _ = struct.unpack("3i", credentials)
    return uid in (0, os.geteuid())


def _hung_up(line: socket.socket) -> bool:
    """Return whether the peer has closed both directions, so that it will read no reply (poll(2))."""
    poll = select.poll()
    poll.register(line.fileno(), 0)
    return any(events & select.POLLHUP for _, events in poll.poll(0))
