"""Parsers tried with bytes that nobody meant: `make fuzz`, or `python -m stillcal.replay.trials.fuzz`.

Each target takes bytes and may raise only what its parser says it raises. Inputs are good ones that were cut,
spliced and changed (hypothesis), and bytes at random. What makes a target fail is kept in
tests/corpus/TARGET, which the test suite feeds to it for ever after.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import hashlib
import logging
import socket
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.streams import limits
from stillcal.calib_core.streams.events import Charging, Location, Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.service import saved_state
from stillcal.daemon.settings import SettingsError, SocketSettings, parse_settings
from stillcal.daemon.store.document import StoreDocument, StoreFormatError, parse, render
from stillcal.daemon.varlink.connection import Connection
from stillcal.daemon.varlink.server import Server
from stillcal.daemon.wire.cobs import MAX_FRAME, framed
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.encoder import Form, WireEncoder, WireSettings
from stillcal.daemon.wire.messages import Hello, Status
from stillcal.replay.formats.rest_table import read_rest_table
from stillcal.replay.formats.trace import read_all
from stillcal.replay.trials.faults.kill import example
from stillcal.replay.trials.faults.target import question

EXAMPLES = 200
"""Inputs of one round; rounds follow one another until the time is up."""

MOST_BYTES = 2000
FORMATS = ("csv", "hhar", "imu_tk", "mikoff", "imucal", "phyphox", "sensorlogger")


@dataclass(frozen=True, slots=True)
class Target:
    """A parser. seeds: inputs that it takes. feed: gives it bytes; raises where it does what it must not."""

    seeds: Callable[[], list[bytes]]
    feed: Callable[[bytes], None]


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


# Files


def _store_seeds() -> list[bytes]:
    return [render(StoreDocument()), render(StoreDocument(current=example_record()[0]))]


def _feed_store(data: bytes) -> None:
    for trusted in (False, True):
        with contextlib.suppress(StoreFormatError):
            document, _ = parse(data, trusted)
            render(document)


def _state_seeds() -> list[bytes]:
    return [saved_state.encode(saved_state.SavedState(EngineState()))[len(saved_state.HEAD) + 32 :]]


def _feed_state(data: bytes) -> None:
    """Feed a body under a checksum that is right, which damage by chance never is."""
    whole = saved_state.HEAD + hashlib.sha256(data).digest() + data
    with contextlib.suppress(saved_state.StateError):
        saved_state.decode(whole)


def _settings_seeds() -> list[bytes]:
    lines = ["[engine.schedule]", "check_interval_s = 60", "[store]", "mode = 0o640", '[source]\nport = "x"']
    return ["\n".join(lines).encode(), b"[socket]\nstall_s = 1e3\n[log]\nlevel = 'info'"]


def _feed_settings(data: bytes) -> None:
    with contextlib.suppress(SettingsError, UnicodeDecodeError):
        parse_settings(data.decode("utf-8"))


_ROWS = b"".join(b"%d.%02d,0.1,0.2,9.8,0.01,0.02,0.03\n" % (i // 100, i % 100) for i in range(40))


def _trace_seeds() -> list[bytes]:
    return [b"t,ax,ay,az,gx,gy,gz\n" + _ROWS, b"Index,Arrival_Time,Creation_Time,x,y,z,User\n0,1,2,3,4,5,a\n"]


def _feed_trace(format_: str, data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trace.csv"
        path.write_bytes(data)
        with contextlib.suppress(UserError):
            read_all(path, format_)


def _feed_rest_table(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rests.csv"
        path.write_bytes(data)
        with contextlib.suppress(UserError):
            read_rest_table(path)


def _beside_trace(name: str, data: bytes) -> None:
    """Feed a file that stands beside a recording: its events or its claims."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trace.csv"
        path.write_bytes(_trace_seeds()[0])
        (Path(folder) / name).write_bytes(data)
        with contextlib.suppress(UserError):
            read_all(path)


TARGETS: dict[str, Target] = {
    "wire-binary": Target(lambda: _wire_seeds(Form.BINARY), _feed_wire),
    "wire-payload": Target(_payload_seeds, _feed_payload),
    "wire-text": Target(lambda: _wire_seeds(Form.TEXT), _feed_wire),
    "varlink": Target(_varlink_seeds, _feed_varlink),
    "store": Target(_store_seeds, _feed_store),
    "state": Target(_state_seeds, _feed_state),
    "settings": Target(_settings_seeds, _feed_settings),
    "rests": Target(lambda: [b"ax,ay,az,t\n0,0,9.8,1\n9.8,0,0,2\n"], _feed_rest_table),
    "events": Target(
        lambda: [b'{"t": 0.1, "event": "charging", "on": true}\n'],
        functools.partial(_beside_trace, "trace.events.jsonl"),
    ),
    "claims": Target(
        lambda: [b'{"device": "x", "nominal_rate_hz": 100, "gravity": 9.81}'],
        functools.partial(_beside_trace, "trace.json"),
    ),
    **{name: Target(_trace_seeds, functools.partial(_feed_trace, name)) for name in FORMATS},
}


def inputs(seeds: list[bytes]) -> st.SearchStrategy[bytes]:
    """Return a strategy for changed seeds: pieces of them joined by anything, and anything alone."""
    anything = st.binary(max_size=40)

    def piece(data: bytes) -> st.SearchStrategy[bytes]:
        ends = st.tuples(st.integers(0, len(data)), st.integers(0, len(data)))
        return ends.map(lambda at: data[min(at) : max(at)])

    pieces = st.one_of([st.just(data) for data in seeds] + [piece(data) for data in seeds])
    return st.one_of(
        st.binary(max_size=MOST_BYTES),
        st.lists(pieces | anything, max_size=5).map(b"".join),
        st.tuples(st.sampled_from(seeds), st.integers(0, 1 << 20), st.binary(min_size=1, max_size=8)).map(
            _changed
        ),
    )


def _changed(change: tuple[bytes, int, bytes]) -> bytes:
    """Write some bytes over a seed at a place within it."""
    data, place, over = change
    at = place % (len(data) + 1)
    return data[:at] + over + data[at + len(over) :]


def fuzzed(target: Target, seconds: float, start: int, examples: int = EXAMPLES) -> tuple[int, bytes | None]:
    """Try a target for so long, one round at least; return how many inputs, and the least one that failed."""
    until, tried, failed = time.monotonic() + seconds, 0, [b""]
    strategy = inputs(target.seeds())
    while True:

        @seed(start)
        @settings(
            max_examples=examples,
            phases=[Phase.generate, Phase.shrink],
            deadline=None,
            database=None,
            suppress_health_check=list(HealthCheck),
        )
        @given(strategy)
        def round_(data: bytes) -> None:
            nonlocal tried
            tried, failed[0] = tried + 1, data
            target.feed(data)

        try:
            round_()
        except Exception:  # whatever it is, the input that did it is what is kept
            return tried, failed[0]
        start += 1
        if time.monotonic() >= until:
            return tried, None


def keep(name: str, data: bytes, corpus: Path) -> Path:
    """Keep an input that made a target fail; return where."""
    path = corpus / name / hashlib.sha256(data).hexdigest()[:16]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


@click.command()
@click.option("--seconds", default=600.0, show_default=True, help="How long to try each target.")
@click.option("--target", "chosen", type=click.Choice(list(TARGETS)), multiple=True, help="Only these.")
@click.option("--seed", "start", default=1, show_default=True)
@click.option("--corpus", type=click.Path(path_type=Path), default=Path("tests/corpus"), show_default=True)
def main(seconds: float, chosen: tuple[str, ...], start: int, corpus: Path) -> None:
    """Try every parser with inputs that nobody meant; exit code 1 where one failed."""
    failures = 0
    for name in chosen or TARGETS:
        tried, failed = fuzzed(TARGETS[name], seconds, start)
        outcome = "no failure" if failed is None else f"FAILED: {keep(name, failed, corpus)}"
        failures += failed is not None
        click.echo(f"{name:16}{tried:>9} inputs in {seconds:g} s: {outcome}")
    sys.exit(failures > 0)


if __name__ == "__main__":
    main()
