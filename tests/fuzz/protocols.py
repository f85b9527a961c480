"""What the daemon hears: the wire and the socket."""

from __future__ import annotations

import asyncio
import functools
import logging
import socket
from types import SimpleNamespace
from typing import Any

import numpy as np

from stillcal.calib_core.streams import limits
from stillcal.calib_core.streams.events import Charging, Location, Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.settings import SocketSettings
from stillcal.daemon.store.document import StoreDocument
from stillcal.daemon.varlink.connection import Connection
from stillcal.daemon.varlink.server import Server
from stillcal.daemon.wire.cobs import MAX_FRAME, framed
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.encoder import Form, WireEncoder, WireSettings
from stillcal.daemon.wire.messages import Hello, Status
from stillcal.replay.trials.faults.kill import example
from stillcal.replay.trials.faults.target import question
from tests.fuzz.target import Target

# The wire


def _messages() -> list[Any]:
    block = Samples(Sensor.ACCELEROMETER, np.arange(3) / 100, np.full((3, 3), 5.6), np.full(3, 21.0))
    messages = [
        block,
        Charging(1.0, True),
        Location(2.0, 48.0, 11.0, 500.0),
        Tick(3.0),
        Status(4.0, 1.0, True, 2),
    ]
    return [*messages, Hello(session=7, claims={"device": "phone", "nominal_rate_hz": 100.0})]


def _wire_seeds(form: Form) -> list[bytes]:
    return [WireEncoder(WireSettings(form=form)).encode(message) for message in _messages()]


def _payload_seeds() -> list[bytes]:
    frames = _wire_seeds(Form.BINARY)
    return [frame[2:-1] for frame in frames]


def _feed_wire(data: bytes) -> None:
    decoder = WireDecoder()
    for message in [*decoder.feed(data), *decoder.feed(b"\n\0"), *decoder.end()]:
        if isinstance(message, Samples):
            assert limits.usable(message.t, message.xyz).all()
    assert sum(map(len, decoder._parts)) <= MAX_FRAME
    assert decoder.feed(b"\0" + _wire_seeds(Form.BINARY)[3]) == [Tick(3.0)]


def _feed_payload(data: bytes) -> None:
    """Feed what a right CRC lets through to the readers of payloads."""
    _feed_wire(b"".join((framed(data), framed(b"\x20\0\0\0\0\0\0\0" + data))))


# The socket


class _Line(asyncio.Transport):
    """A connection that forgets what is written to it."""

    def __init__(self, end: socket.socket) -> None:
        super().__init__({"socket": end})
        self.closed = False

    def write(self, data: Any) -> None:
        """Take an answer."""

    def is_closing(self) -> bool:
        """Say whether the daemon has hung up."""
        return self.closed

    def close(self) -> None:
        """Hang up."""
        self.closed = True

    abort = close

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """Take limits."""

    def pause_reading(self) -> None:
        """Go on."""

    resume_reading = pause_reading


def _varlink_seeds() -> list[bytes]:
    calls = [question("GetHistory", limit=3), question("GetStatus"), question("Rollback", to="1")]
    table = question("Correct", sensor="gyroscope", samples=[[1, 2.5, -3e300]], force=[[0, 0, 9.8]])
    return [*calls, table, question("Monitor").replace(b"}", b', "more": true}', 1)]


def _feed_varlink(data: bytes) -> None:
    logging.disable()  # calls that get as far as the daemon, of which there is none here, are logged
    try:
        asyncio.run(_answered(data))
    finally:
        logging.disable(logging.NOTSET)


async def _answered(data: bytes) -> None:
    """Let a connection of the real server take the bytes; an answer may be an error, but none is raised."""
    raised: list[Any] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: raised.append(context))
    record, _ = example_record()
    view = SimpleNamespace(record=record, refusal=None)
    server = Server(SimpleNamespace(view=view, document=StoreDocument(current=record)), SocketSettings())
    ours, theirs = socket.socketpair()
    with ours, theirs:
        client = Connection(server._registry, server)
        client.connection_made(_Line(ours))
        for piece in (data[: len(data) // 2], data[len(data) // 2 :], b"\0"):
            client.data_received(piece)
            await asyncio.sleep(0)
        client.eof_received()
        await asyncio.sleep(0)
        client.connection_lost(None)
    await asyncio.sleep(0)
    assert not raised, raised


@functools.cache
def example_record() -> Any:
    """Return a calibration of a real phone and the rests it stands on."""
    return example()


TARGETS = {
    "wire-binary": Target(lambda: _wire_seeds(Form.BINARY), _feed_wire),
    "wire-payload": Target(_payload_seeds, _feed_payload),
    "wire-text": Target(lambda: _wire_seeds(Form.TEXT), _feed_wire),
    "varlink": Target(_varlink_seeds, _feed_varlink),
}
