"""How often one client is answered, on a clock of the test's own."""

from __future__ import annotations

from typing import Any

import pytest

from stillcal.daemon.settings import SocketSettings
from stillcal.daemon.varlink.connection import Connection
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
