"""How often one client is answered and in which turn, on a clock of the test's own."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import pytest

from stillcal.daemon.settings import SocketSettings
from stillcal.daemon.varlink.connection import Connection
from stillcal.daemon.varlink.server import Server
from tests.support.clock import ManualClock


class Owner:
    """A server without a socket."""

    def __init__(self, clock: ManualClock) -> None:
        self.settings, self.clock, self.dropped = SocketSettings(calls_per_s=10.0), clock, 0


def test_a_client_waits_for_what_it_asks_beyond_its_rate() -> None:
    clock = ManualClock()
    owner: Any = Owner(clock)
    connection = Connection(registry=None, server=owner)  # type: ignore[arg-type]  # nothing is asked
    assert [connection._delay() for _ in range(10)] == [0.0] * 10
    assert connection._delay() == pytest.approx(0.1)
    clock.now += 0.1
    assert connection._delay() == pytest.approx(0.1)
    clock.now += 60.0  # what is saved up is one second's calls
    assert [connection._delay() for _ in range(10)] == [0.0] * 10
    assert connection._delay() == pytest.approx(0.1)


@dataclass
class Client:
    """Each answer takes `costs` s, after which `then` is called."""

    name: str
    costs: float
    clock: ManualClock
    answered: list[str]
    turn: float = 0.0
    cost: float = 0.0
    then: Any = None

    def answer(self) -> None:
        self.clock.now += self.costs
        self.answered.append(self.name)
        if self.then is not None:
            self.then()


def test_who_asks_for_little_waits_for_one_answer_and_who_asks_for_much_has_its_share() -> None:
    async def test() -> None:
        clock, answered = ManualClock(), list[str]()
        server = Server(None, SocketSettings(), clock, clock)  # type: ignore[arg-type]  # nothing is asked of it
        clients = [Client(f"much {i}", 0.008, clock, answered) for i in range(8)]
        little = Client("little", 0.0001, clock, answered)
        for client in clients:
            client.then = lambda client=client: len(answered) < 100 and server._enqueue(client)
            server._enqueue(client)  # type: ignore[arg-type]
        little.then = lambda: asyncio.get_running_loop().call_soon(server._enqueue, little)
        server._enqueue(little)  # type: ignore[arg-type]
        while len(answered) < 100:
            await asyncio.sleep(0)
        shares = [answered.count(client.name) for client in clients]
        assert max(shares) - min(shares) <= 1
        asked = [i for i, name in enumerate(answered) if name == "little"]
        assert len(asked) > 20 and max(b - a for a, b in pairwise(asked[1:])) <= 3

    asyncio.run(test())
