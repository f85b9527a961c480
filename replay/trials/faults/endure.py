"""A daemon on trial: a phone that sends anything, clients that leave at any stage, tables without end.

`stillcal run` in a process of its own on a pseudo-terminal whose other end is played here. Meanwhile one more
client asks on and on, and notes how long it waits. Each trial ends with SIGTERM, whose answer is timed.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
import time
import tty
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stillcal.calib_core.engine.state import EngineState
from stillcal.daemon.service import saved_state
from stillcal.daemon.service.saved_state import SavedState
from stillcal.daemon.settings import SocketSettings
from stillcal.daemon.store.store import Store
from stillcal.daemon.varlink.interface import MAX_ENTRIES
from stillcal.daemon.varlink.rows import MAX_ROWS
from stillcal.daemon.wire.encoder import WireEncoder
from stillcal.daemon.wire.messages import Hello
from stillcal.replay.phone import simulate
from stillcal.replay.phone.activities.resting import Poses
from stillcal.replay.phone.scenario import Scenario
from stillcal.replay.serial_phone.link import LinkSettings, serve_phone
from stillcal.replay.trials.demo.tour import phone_at
from stillcal.replay.trials.faults.fit import gathered
from stillcal.replay.trials.faults.hostile import runs
from stillcal.replay.trials.faults.kill import example
from stillcal.replay.trials.faults.target import START_S, Target, ask, question, status
from stillcal.replay.trials.faults.waiting import LATE_S, Waits, slowest
from stillcal.replay.trials.faults.wire import Figures

STOP_S = 2.0
"""Within which a daemon must end after SIGTERM, s."""

ASK_EVERY_S = 0.02
FLOODING = 8
"""Clients that ask for tables without end."""

FULLEST = 48, 24
"""Attitudes of the fullest pool, and rests in each."""

BYTES_AT_ONCE = 4096

GOOD, GOOD_POSES, GOOD_RATE_HZ, GOOD_SPEED = "a good phone", 12, 25.0, 50.0
"""The phone that comes after hostile ones: its name, its attitudes, its rate, and s of its time in a s."""

SERVED_S = 60.0
"""Within which it must have been heard to its end and calibrated, s."""

SETTLED_S = 10.0
LOG_BYTES = 200_000
"""What a trial may make the daemon write to its log."""

RUN = "from stillcal.daemon.cli.entry import main; main()"


@dataclass(slots=True)
class Trial:
    """A daemon on trial, and what was measured. line: the phone's end of its terminal, -1 once closed."""

    target: Target
    line: int
    waits: Waits
    stopped_s: float = float("inf")
    exit_code: int = -1
    log_bytes: int = 0

    def figures(self, name: str, counts: dict[str, int], holds: bool) -> Figures:
        """Return what a trial came to. Of the waits, the daemon's own share is judged, by its 99 % point."""
        answers = slowest(self.waits.took, self.waits.own)
        measured = {
            "answers to another client": len(self.waits.took),
            **{f"their {name}": us for name, us in answers.items()},
            "exit code": self.exit_code,
            "ms from SIGTERM to its end": round(1e3 * self.stopped_s),
            "bytes of log": self.log_bytes,
        }
        sound = self.exit_code == 0 and self.stopped_s <= STOP_S and self.log_bytes <= LOG_BYTES
        sound &= answers["p99 own, us"] <= 1e6 * LATE_S
        return Figures(name, holds and sound, {**counts, **measured})


@contextlib.asynccontextmanager
async def on_trial(
    folder: Path, run: str = RUN, more: Sequence[str] = (), log: int | None = None
) -> AsyncIterator[Trial]:
    """Run a daemon with a calibration in its store; another client asks it meanwhile; end it by SIGTERM.

    run: the program; more: of its arguments; log: a descriptor, for one that is not read.
    """
    Store(folder / "store.json").publish(example()[0])
    (folder / "stillcal.toml").write_text("")
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    (folder / "tty").symlink_to(os.ttyname(slave))
    names = {"--config": "stillcal.toml", "--port": "tty", "--store": "store.json", "--socket": "socket"}
    arguments = [word for option, name in names.items() for word in (option, str(folder / name))]
    command = [sys.executable, "-c", run, "run", *arguments, *more]
    with (folder / "log").open("wb") as file:
        process = await asyncio.create_subprocess_exec(*command, stderr=file if log is None else log)
    target = Target(folder, SocketSettings(), process)  # type: ignore[arg-type]  # its pid is enough
    trial = Trial(target, master, Waits(process.pid))
    try:
        async with asyncio.timeout(START_S):
            await _connected(trial.target)
        asking = asyncio.create_task(_asking(trial))
        yield trial
        asking.cancel()
        await asyncio.gather(asking, return_exceptions=True)
    finally:
        began = time.monotonic()
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        trial.exit_code = await asyncio.wait_for(process.wait(), START_S)
        trial.stopped_s = time.monotonic() - began
        trial.log_bytes = (folder / "log").stat().st_size
        if trial.line >= 0:
            os.close(trial.line)
        os.close(slave)


async def _connected(target: Target) -> None:
    while True:
        with contextlib.suppress(OSError, EOFError):
            if (await status(target))["connected"]:
                return
        await asyncio.sleep(0.05)


async def _asking(trial: Trial) -> None:
    """Ask on and on as one who means well, and note how long each answer took."""
    reader, writer = await asyncio.open_unix_connection(trial.target.socket)
    await trial.waits.repeat(lambda: ask(reader, writer), ASK_EVERY_S)


# The phone


def hostile_messages(number: int, seed: int, folder: Path) -> Figures:
    """Send so many well-formed messages with any values in their fields.

    The daemon must answer on, and then serve a good phone.
    """
    return asyncio.run(_sent(f"{number} hostile well-formed messages", list(runs(number, seed)), folder))


def hostile_bytes(
    number: int, seed: int, folder: Path, run: str = RUN, served_s: float = SERVED_S
) -> Figures:
    """Send so many random bytes over the line. run: the program; served_s: how long a good phone may take."""
    rng = np.random.default_rng(seed)
    pieces = [rng.bytes(min(BYTES_AT_ONCE, number - at)) for at in range(0, number, BYTES_AT_ONCE)]
    return asyncio.run(_sent(f"{number} random bytes over the line", pieces, folder, run, served_s))


async def _sent(
    name: str, pieces: Iterable[bytes], folder: Path, run: str = RUN, served_s: float = SERVED_S
) -> Figures:
    count = size = 0
    async with on_trial(folder, run) as trial:
        for piece in pieces:
            await write(trial.line, piece)
            count, size = count + 1, size + len(piece)
        async with asyncio.timeout(START_S):
            while (wire := (await status(trial.target))["wire"])["bytes"] < size:
                await asyncio.sleep(0.05)
        served = await _served_afterwards(trial, folder, served_s)
    counts = {"pieces": count, "bytes": size, "samples taken": wire["samples"]}
    counts |= {"bad frames": wire["bad_frames"], "bad lines": wire["bad_lines"], **served}
    holds = all(served.values()) and Store(folder / "store.json").verify().whole
    return trial.figures(name, counts, holds)


async def _served_afterwards(trial: Trial, folder: Path, seconds: float) -> dict[str, int]:
    """Count what becomes of good phones: one on the hostile one's line, and one that is plugged in instead.

    Each count is 0 where it is not served within so many seconds.
    """
    calibrations = (await status(trial.target))["counts"]["calibrations"]
    known = False
    same = f"{GOOD} on the same line"
    await write(trial.line, b"\0" + WireEncoder().encode(Hello(session=1, claims={"device": same})))
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            while not (known := (await status(trial.target))["phone"] == same):
                await asyncio.sleep(0.05)
    os.close(trial.line)
    trial.line = -1
    scenario = Scenario(segments=(Poses(count=GOOD_POSES, rest_s=(8.0, 12.0), charging=True),))
    chunks = simulate(scenario, phone_at(GOOD_RATE_HZ), 1).chunks()
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await serve_phone(chunks, {"device": GOOD}, LinkSettings(speed=GOOD_SPEED), folder / "tty")
    now = await status(trial.target)
    return {
        "a good phone is known then": int(known),
        "rests of another one": now["rests_held"] if now["phone"] == GOOD else 0,
        "its calibrations": now["counts"]["calibrations"] - calibrations,
    }


async def write(line: int, data: bytes) -> None:
    """Write to the phone's end as fast as it is taken; what the daemon says is read and thrown away."""
    view = memoryview(data)
    while view:
        with contextlib.suppress(BlockingIOError):
            os.read(line, 65_536)
        try:
            view = view[os.write(line, view[:BYTES_AT_ONCE]) :]
        except BlockingIOError:
            await asyncio.sleep(0.001)


# Clients


def leavers(number: int, folder: Path) -> Figures:
    """Let so many clients come and leave, in turn at every stage of a call; all places must be free again."""
    return asyncio.run(_left(number, folder))


async def _left(number: int, folder: Path) -> Figures:
    counts = {name: 0 for name, _ in STAGES}
    async with on_trial(folder) as trial:
        await asyncio.sleep(0.2)
        own = trial.target.sockets()
        for i in range(number):
            name, stage = STAGES[i % len(STAGES)]
            with contextlib.suppress(OSError, EOFError):
                await stage(trial.target.socket)
            counts[name] += 1
        until = time.monotonic() + SETTLED_S
        while (left := trial.target.sockets() - own) > 0 and time.monotonic() < until:
            await asyncio.sleep(0.05)
        answers = int("wire" in await status(trial.target))
    counts |= {"places not given back": left, "answers on": answers}
    return trial.figures(f"{number} clients that leave at every stage", counts, left <= 0 and bool(answers))


async def _says(path: str, data: bytes, answers: int = 0, half: bool = False, reset: bool = False) -> None:
    """Connect, say something, take so many answers, and leave: by closing, half closing or a reset."""
    reader, writer = await asyncio.open_unix_connection(path)
    try:
        if data:
            writer.write(data)
        for _ in range(answers):
            await asyncio.wait_for(reader.readuntil(b"\0"), SETTLED_S)
        if half:
            writer.write_eof()
            await asyncio.wait_for(reader.read(), SETTLED_S)
    finally:
        if reset:
            writer.transport.abort()
        writer.close()


def _stage(data: bytes, **how: Any) -> Callable[[str], Coroutine[Any, Any, None]]:
    return lambda path: _says(path, data, **how)


def _more(method: str) -> bytes:
    """Return a question whose answers go on without end."""
    return json.dumps(json.loads(question(method)[:-1]) | {"more": True}).encode() + b"\0"


_LISTEN = _more("Monitor")
STAGES: list[tuple[str, Callable[[str], Coroutine[Any, Any, None]]]] = [
    ("leaves at once", _stage(b"")),
    ("half a question", _stage(question("GetStatus")[:20])),
    ("a question, no answer taken", _stage(question("GetStatus"))),
    ("a question, the answer taken", _stage(question("GetStatus"), answers=1)),
    ("fifty questions", _stage(question("GetStatus") * 50, answers=3)),
    ("listens and leaves at once", _stage(_LISTEN)),
    ("listens, hears, and leaves", _stage(_LISTEN, answers=1)),
    ("listens and half closes", _stage(_LISTEN, answers=1, half=True)),
    ("listens and resets", _stage(_LISTEN, answers=1, reset=True)),
    ("streams and leaves at once", _stage(_more("Stream"))),
    ("streams, hears, and leaves", _stage(_more("Stream"), answers=1)),
    ("streams and resets", _stage(_more("Stream"), answers=1, reset=True)),
    ("records and half closes", _stage(_more("Record"), answers=1, half=True)),
    ("asks to calibrate and leaves", _stage(question("Calibrate"))),
    ("a table, and leaves", _stage(question("Correct", sensor="gyroscope", samples=[[1, 2, 3]] * MAX_ROWS))),
]


def tables(seconds: float, folder: Path) -> Figures:
    """Let FLOODING clients ask without pause for tables of 240 kB and for as many rests as there can be.

    Others are answered as ever.
    """
    return asyncio.run(_tables(seconds, folder))


async def _tables(seconds: float, folder: Path) -> Figures:
    over = question("Correct", sensor="gyroscope", samples=[[1, 1, 1]] * 20_000)
    full = question("Correct", sensor="gyroscope", samples=[[1.25, 2.5, 3.75]] * MAX_ROWS)
    rests = question("GetStillness", limit=MAX_ENTRIES)
    state = SavedState(EngineState(pool=gathered(1, *FULLEST)))
    saved_state.save(saved_state.state_path(folder / "store.json"), saved_state.encode(state))
    asked = [0]

    async def flood(path: str) -> None:
        reader, writer = await asyncio.open_unix_connection(path, limit=2**20)
        while True:
            for table in (over, full, rests):
                writer.write(table)
                await reader.readuntil(b"\0")
                asked[0] += 1

    async with on_trial(folder) as trial:
        floods = [asyncio.create_task(flood(trial.target.socket)) for _ in range(FLOODING)]
        await asyncio.sleep(seconds)
        for client in floods:
            client.cancel()
        ended = await asyncio.gather(*floods, return_exceptions=True)
    hung_up = sum(not isinstance(e, asyncio.CancelledError) for e in ended)
    counts = {"tables answered": asked[0], "hung up on": hung_up}
    return trial.figures(f"{FLOODING} clients that ask for tables", counts, not hung_up and asked[0] > 0)
