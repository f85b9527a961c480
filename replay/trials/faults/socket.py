"""Clients that mean no good against a running daemon, counted: nonsense, stalling, flooding.

The daemon is a process of its own with a phone in real time on a pseudo-terminal. While it is attacked,
its samples are counted and the lateness of its event loop is measured from inside (daemon.py).
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import select
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from stillcal.daemon.cli.exits import TRY_AGAIN
from stillcal.daemon.settings import SocketSettings
from stillcal.daemon.varlink.address import NAME
from stillcal.replay.trials.faults.target import START_S, Target, ask, lateness, question, running, status
from stillcal.replay.trials.faults.wire import Figures

SETTINGS = SocketSettings(stall_s=2.0)
"""The defaults, but for patience: a stalling client is to be seen dropped in reasonable time."""

QUIET_S = 1.0
QUESTIONS = 5
"""That each client of the crowd which does not stall asks."""

ATTEMPTS = 50
SETTLED_S = 10.0
OVERSIZED = 20
DESCRIBE = (
    json.dumps(
        {"method": "org.varlink.service.GetInterfaceDescription", "parameters": {"interface": NAME}}
    ).encode()
    + b"\0"
)
"""The question with the longest answer: a hundred of them fill every buffer on the way."""


def attacked(
    messages: int, clients: int, seed: int, folder: Path, settings: SocketSettings = SETTINGS
) -> list[Figures]:
    """Start a daemon in `folder`, attack it by every means, and end it."""
    return asyncio.run(_attacked(messages, clients, seed, folder, settings))


def nonsense(number: int, seed: int) -> Iterator[bytes]:
    """Yield messages, none of which can be meant: bytes, broken JSON, wrong types, unknown names."""
    rng = np.random.default_rng(seed)
    good = question("Correct", sensor="gyroscope", samples=[[1, 2, 3]])[:-1]
    shapes: list[Callable[[], bytes]] = [
        lambda: rng.bytes(int(rng.integers(1, 300))),
        lambda: good[: int(rng.integers(1, len(good)))],
        lambda: [b"null", b"3", b'"x"', b"[]", b"true"][int(rng.integers(5))],
        lambda: b'{"method": ' + b"[" * 5000,
        lambda: b'{"method": "%s", "more": 3}' % (b"." * int(rng.integers(0, 9))),
        lambda: question("GetHistory", limit=-int(rng.integers(1, 9)))[:-1],
        lambda: question("__init__", daemon=1)[:-1],
        lambda: question("Monitor")[:-1],
        lambda: good.replace(b"[1", b"[NaN"),
    ]
    for i in range(number):
        yield shapes[i % len(shapes)]() + b"\0"


# Attacks


async def _attacked(
    messages: int, clients: int, seed: int, folder: Path, settings: SocketSettings
) -> list[Figures]:
    async with running(folder, settings) as target:
        await asyncio.sleep(QUIET_S)
        own = target.sockets()
        began, before = time.monotonic(), await status(target)
        figures = [
            await malformed(target, messages, seed),
            await crowd(target, clients, own),
            await idle(target, clients, own),
            await oversized(target),
            await flood(target),
        ]
        ended, after = time.monotonic(), await status(target)
        second = await asyncio.to_thread(second_daemon, target)
    wire = {name: after["wire"][name] - before["wire"][name] for name in ("samples", "lost_samples")}
    sampling = {**wire, "samples per s": round(wire["samples"] / (ended - began))}
    held = wire["samples"] > 0 and wire["lost_samples"] == 0
    noted = np.load(folder / "lateness.npy")
    return [
        *figures,
        Figures("samples meanwhile", held, sampling),
        lateness(noted, began, ended, "attacked"),
        second,
    ]


async def malformed(target: Target, number: int, seed: int) -> Figures:
    """Send nonsense, each piece over a connection of its own; none may be accepted."""
    counts = Counter({"accepted": 0, "answered by an error": 0, "hung up on": 0})
    for message in nonsense(number, seed):
        with contextlib.suppress(ConnectionError):
            reader, writer = await asyncio.open_unix_connection(target.socket)
            writer.write(message)
            writer.write_eof()
            answers = (await reader.read()).split(b"\0")[:-1]
            writer.close()
        counts["accepted"] += any("error" not in json.loads(a) for a in answers)
        counts["answered by an error" if answers else "hung up on"] += 1
    answers_on = int("wire" in await status(target))
    holds = counts["accepted"] == 0 and bool(answers_on)
    return Figures(f"{number} malformed messages", holds, {**counts, "answers on": answers_on})


async def crowd(target: Target, clients: int, own: int) -> Figures:
    """Come all at once; half stall, in questions or in taking answers, the others ask.

    own: sockets that the daemon has open without clients.
    """
    stalling = [_stalling(target, half_asked=bool(i % 2)) for i in range(clients // 2)]
    asking = [_asking(target) for _ in range(clients - clients // 2)]
    came = asyncio.gather(*asking)
    most = 0
    while not came.done():
        await asyncio.sleep(0.05)
        most = max(most, target.sockets() - own)
    hung_up = await _hung_up_on(stalling, target.settings.stall_s + SETTLED_S)
    counts = {
        "questions": QUESTIONS * len(asking),
        "answered": sum(answered for answered, _ in await came),
        "connections more": sum(more for _, more in await came),
        "stalling": len(stalling),
        "hung up on": hung_up,
        "most open at a moment": most,
    }
    holds = counts["answered"] == counts["questions"] and hung_up == len(stalling)
    return Figures(f"{clients} clients at once, half stall", holds, counts)


async def idle(target: Target, clients: int, own: int) -> Figures:
    """Connect and, but for the last, say nothing: no more than there are places may stay."""
    limit = target.settings.connections
    came = [await asyncio.open_unix_connection(target.socket) for _ in range(clients)]
    await ask(*came[-1])  # it came last: by its answer all have been let in
    until = time.monotonic() + SETTLED_S
    while (open_now := target.sockets() - own) > limit and time.monotonic() < until:
        await asyncio.sleep(0.01)
    for _, writer in came:
        writer.close()
    return Figures(f"{clients} idle clients", open_now <= limit, {"places": limit, "stay": open_now})


async def oversized(target: Target) -> Figures:
    """Send questions larger than allowed; each is hung up on before it ends."""
    hung_up = 0
    for _ in range(OVERSIZED):
        reader, writer = await asyncio.open_unix_connection(target.socket)
        with contextlib.suppress(ConnectionError):
            writer.write(b"x" * (target.settings.message_bytes + 1))
            await writer.drain()
            hung_up += await reader.read() == b""
            writer.close()
            continue
        hung_up += 1
    counts = {"hung up on": hung_up}
    return Figures(f"{OVERSIZED} messages over the limit", hung_up == OVERSIZED, counts)


async def flood(target: Target) -> Figures:
    """Ask twice as much as a second allows, at once; after the first second's worth, it waits."""
    rate = target.settings.calls_per_s
    number, began = int(2 * rate), time.monotonic()
    reader, writer = await asyncio.open_unix_connection(target.socket)
    writer.write(question("GetStatus") * number)
    for _ in range(number):
        await reader.readuntil(b"\0")
    took = time.monotonic() - began
    writer.close()
    per_s = (number - rate) / took
    counts = {"answered": number, "per s": round(per_s)}
    return Figures(f"{number} questions at once", per_s <= rate, counts)


def second_daemon(target: Target) -> Figures:
    """Start another daemon on the same store: it must refuse in one line that names the first."""
    start = [sys.executable, "-c", "from stillcal.daemon.cli.main import main; main()", "run"]
    config, port, store, where = target.arguments
    command = [*start, "--config", config, "--port", port, "--store", store, "--socket", where]
    ran = subprocess.run(command, check=False, capture_output=True, text=True, timeout=START_S)
    lines = ran.stderr.splitlines()
    named = int(len(lines) == 1 and f"in use by process {target.process.pid}" in lines[0])
    counts = {"exit code": ran.returncode, "lines": len(lines), "that name the first": named}
    return Figures("a second daemon", ran.returncode == TRY_AGAIN and bool(named), counts)


# Clients


def _stalling(target: Target, *, half_asked: bool) -> socket.socket:
    """Connect, and either stop in the middle of a question or never take an answer."""
    line = socket.socket(socket.AF_UNIX)
    line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    line.connect(target.socket)
    asks = b'{"method": "half a question' if half_asked else DESCRIBE * 200
    line.setblocking(False)
    with contextlib.suppress(OSError):
        line.send(asks)
    return line


async def _asking(target: Target) -> tuple[int, int]:
    """Ask a few questions; return how many were answered, and how many connections more that took.

    A daemon with more clients than it has places drops the longest idle: who is dropped comes again.
    """
    answered = 0
    for again in range(ATTEMPTS):
        with contextlib.suppress(OSError, EOFError):
            reader, writer = await asyncio.open_unix_connection(target.socket)
            with contextlib.closing(writer):
                while answered < QUESTIONS:
                    answered += "status" in (await ask(reader, writer))["parameters"]
            return answered, again
    return answered, ATTEMPTS


async def _hung_up_on(lines: list[socket.socket], within_s: float) -> int:
    """Wait until the daemon has hung up on all, but not for long; return on how many it has."""
    poll, closed = select.poll(), set[int]()
    for line in lines:
        poll.register(line, 0)
    until = time.monotonic() + within_s
    while len(closed) < len(lines) and time.monotonic() < until:
        for number, _ in poll.poll(0):
            closed.add(number)
            poll.unregister(number)
        await asyncio.sleep(0.02)
    for line in lines:
        line.close()
    return len(closed)
