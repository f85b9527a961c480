"""The socket's server: accepts clients and answers them in turn. interface.py defines the methods.

A client is accepted once there is room for it. Clients have equal shares of the time of answering, and whose
answer would end first by them is answered first (fair queueing, Demers et al. 1989, 10.1145/75246.75248, with
the cost of a client's last answer for that of its next): who asks for little waits for nobody who asks for
much. After TURN_S of answering, the loop serves the phone again.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import time
from collections.abc import AsyncIterator, Callable, Sequence
from heapq import heappop, heappush
from itertools import count
from pathlib import Path

from asyncvarlink import VarlinkInterfaceRegistry
from asyncvarlink.serviceinterface import VarlinkServiceInterface

from stillcal._version import __version__
from stillcal.calib_core.errors import TryAgainError
from stillcal.daemon.settings import SettingsError, SocketSettings
from stillcal.daemon.system.clock import Clock
from stillcal.daemon.system.log import say
from stillcal.daemon.varlink.address import socket_path
from stillcal.daemon.varlink.connection import Connection
from stillcal.daemon.varlink.daemon import Daemon
from stillcal.daemon.varlink.interface import CalibrationInterface
from stillcal.daemon.varlink.socket import opened

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

TURN_S = 0.01
"""How long clients are answered before the event loop serves everything else, s."""

CLOSING_S = 0.2
"""Longest wait, when the daemon stops, for the last message of each subscription to be sent, s."""

LISTEN_BACKLOG = 1024
"""Clients that the kernel queues before they are accepted (listen(2))."""

LOOK_S = 10.0
"""Time between two looks whether the socket still has its name, s."""

RETRY_S = 1.0
"""Pause before clients are accepted again after the process ran out of descriptors, s."""

OWN_DESCRIPTORS = 32
"""Descriptors that clients leave to the daemon itself, twice what it has open."""


class Server:
    """All clients. settings: their limits, which may be replaced at any time.

    dropped: number disconnected for stalling, for malformed requests or to make room.
    """

    def __init__(
        self,
        daemon: Daemon,
        settings: SocketSettings,
        clock: Clock = time.monotonic,
        cpu_time: Clock = time.thread_time,
    ) -> None:
        self.settings, self.clock, self._cpu_time = settings, clock, cpu_time
        self.dropped = 0
        self._registry = _registry(daemon)
        self._clients: dict[Connection, None] = {}
        self._queue: list[tuple[float, int, Connection]] = []
        self._queued, self._turn = count(), 0.0
        self._arrived: list[Connection] = []
        self._serving = False
        self._departed = asyncio.Event()

    async def admit(self, listener: socket.socket) -> None:
        """Accept clients until cancelled; where there is no room, the longest idle one is disconnected."""
        loop = asyncio.get_running_loop()
        while True:
            await _acceptable(listener)
            free = await self._make_room()
            try:
                line, _ = listener.accept()
            except BlockingIOError:
                continue  # the client has left
            except OSError as error:
                say("warning", "socket", f"cannot accept a client: {error.strerror}")
                await asyncio.sleep(RETRY_S)
                continue
            if free:
                await loop.connect_accepted_socket(lambda: Connection(self._registry, self), line)
            else:
                self.dropped += 1
                line.close()

    async def _make_room(self) -> bool:
        """Make room for a client; return whether there is any.

        The client that has been idle longest is disconnected first, then the one subscribed longest, but
        never one whose request is being answered.
        """
        while len(self._clients) >= places(self.settings.connections):
            idle = next((c for c in self._clients if not c.answering), None)
            leaving = idle or next((c for c in self._clients if c.listening), None)
            if leaving is None:
                return False
            self._departed.clear()
            leaving.drop()
            await self._departed.wait()
        return True

    def enter(self, client: Connection) -> None:
        """Add a client."""
        self._clients[client] = None

    def leave(self, client: Connection) -> None:
        """Remove a client."""
        self._clients.pop(client, None)
        self._departed.set()

    def queue(self, client: Connection, wait_s: float) -> None:
        """Answer a client's request in its turn, after at least `wait_s`."""
        if client in self._clients:
            self._clients[client] = self._clients.pop(client)
        if wait_s > 0:
            asyncio.get_running_loop().call_later(wait_s, self._enqueue, client)
        else:
            self._enqueue(client)

    async def close(self) -> None:
        """End all subscriptions and disconnect all clients."""
        ending = [client for client in self._clients if client.listening]
        for client in ending:
            client.end_subscription()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CLOSING_S):
                while any(client.answering for client in ending):
                    await asyncio.sleep(0.001)
        for client in list(self._clients):
            client.hang_up()

    def _enqueue(self, client: Connection) -> None:
        self._arrived.append(client)
        if not self._serving:
            self._serving = True
            asyncio.get_running_loop().call_soon(self._serve)

    def _serve(self) -> None:
        """Answer for TURN_S those clients first that have had least, then return to the event loop."""
        until = self.clock() + TURN_S
        while (self._queue or self._arrived) and self.clock() < until:
            for client in self._arrived:
                client.turn = max(client.turn, self._turn)
                heappush(self._queue, (client.turn + client.cost, next(self._queued), client))
            self._arrived.clear()
            _, _, client = heappop(self._queue)
            self._turn, began = max(self._turn, client.turn), self._cpu_time()
            client.answer()
            client.cost = self._cpu_time() - began
            client.turn += client.cost
        self._serving = bool(self._queue or self._arrived)
        if self._serving:
            asyncio.get_running_loop().call_soon(self._serve)


def places(connections: int) -> int:
    """Return how many clients there is room for, by the setting and by the descriptors of this process."""
    if resource is None:
        return connections
    descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if descriptors == resource.RLIM_INFINITY:
        return connections
    return max(1, min(connections, descriptors - OWN_DESCRIPTORS))


@contextlib.asynccontextmanager
async def serving(
    daemon: Daemon, settings: SocketSettings, passed: Sequence[socket.socket] = ()
) -> AsyncIterator[Server]:
    """Serve the sockets that systemd passed, or else one of our own, while the block lasts."""
    server, listeners = Server(daemon, settings), list[asyncio.Task[None]]()
    with contextlib.ExitStack() as held:

        def listen() -> None:
            for line in held.enter_context(opened(settings, passed)):
                held.callback(line.close)
                line.setblocking(False)
                line.listen(LISTEN_BACKLOG)
                listeners.append(asyncio.create_task(server.admit(line)))

        listen()
        if not passed:
            listeners.append(asyncio.create_task(_kept_reachable(socket_path(settings.path), listen)))
        try:
            yield server
        finally:
            for listener in listeners:
                listener.cancel()
            await asyncio.gather(*listeners, return_exceptions=True)
            await server.close()


async def _kept_reachable(path: Path, listen: Callable[[], None]) -> None:
    """Listen anew where the socket's name was removed, as when a folder of temporary files is cleaned."""
    while True:
        await asyncio.sleep(LOOK_S)
        if os.path.lexists(path):
            continue
        try:
            listen()
        except (SettingsError, TryAgainError) as error:
            say("warning", "socket", str(error))
        else:
            say("warning", "socket", f"{path} had been removed: made anew")


async def _acceptable(listener: socket.socket) -> None:
    """Wait until a client wants to connect."""
    loop, readable = asyncio.get_running_loop(), asyncio.Event()
    loop.add_reader(listener, readable.set)
    try:
        await readable.wait()
    finally:
        loop.remove_reader(listener)


def _registry(daemon: Daemon) -> VarlinkInterfaceRegistry:
    registry = VarlinkInterfaceRegistry()
    registry.register_interface(CalibrationInterface(daemon))
    about = VarlinkServiceInterface("stillcal", "stillcal", __version__, "https://varlink.org", registry)
    registry.register_interface(about)
    return registry
