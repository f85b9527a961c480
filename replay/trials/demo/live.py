"""A daemon as a process of its own, on a simulated phone's pseudo-terminal, from its start to its SIGTERM.

What it says is taken from its log, what it knows from its socket; nothing of it is reached otherwise.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stillcal.daemon.cli.query import NoDaemonError, replies
from stillcal.daemon.service.saved_state import state_path
from stillcal.daemon.system.signals import run_until_signalled
from stillcal.daemon.varlink.address import NAME
from stillcal.replay.phone.simulation import Chunk, Simulation
from stillcal.replay.serial_phone.link import serve_phone

PATIENCE_S = 5.0
"""How long a daemon may take to stop before it is killed, s."""

SETTINGS = """\
[store]
path = "{store}"
[source]
port = "{folder}/tty"
[socket]
path = "{folder}/socket"
"""

Told = Callable[[str], None]
Progressed = Callable[[float], None]


class DaemonDiedError(Exception):
    """The daemon ended before it should."""


QUESTIONS = (("GetCalibration", "calibration"), ("GetStatus", "status"), ("GetEnergy", "days"))
"""Methods, and what their answers are called."""


@dataclass(frozen=True, slots=True)
class Lived:
    """What the daemon answered after the phone's last sample, as its interface describes it.

    calibration: None where there is none. news: every change of it, in order. lived_s, stopping_s: how
    long the phone's life and the daemon's end took, s of ours.
    """

    calibration: dict[str, Any] | None
    status: dict[str, Any]
    energy: list[dict[str, Any]]
    news: list[dict[str, Any]]
    lived_s: float
    stopping_s: float


@dataclass(frozen=True, slots=True)
class Files:
    """Where a run leaves what it wrote."""

    store: Path
    config: Path
    log: Path

    @classmethod
    def in_folder(cls, folder: Path) -> Files:
        """Name the files in `folder`, which is made, and remove those of an earlier run."""
        folder.mkdir(parents=True, exist_ok=True)
        files = cls(*((folder / f"live.{kind}").absolute() for kind in ("json", "toml", "log")))
        for old in (*folder.glob(f"{files.store.name}*"), state_path(files.store), files.log):
            old.unlink(missing_ok=True)
        return files


def live(simulation: Simulation, files: Files, told: Told, progressed: Progressed) -> Lived:
    """Let a daemon live through `simulation`; whatever happens, it has ended when this returns.

    told: is given each event that the daemon logs. progressed: is given the phone's time, s. Raises
    DaemonDiedError, and KeyboardInterrupt on SIGINT, SIGTERM and SIGHUP.
    """
    with tempfile.TemporaryDirectory(prefix="stillcal-") as folder:
        files.config.write_text(SETTINGS.format(store=files.store, folder=folder))
        return run_until_signalled(_live(simulation, files, Path(folder), told, progressed))


async def _live(
    simulation: Simulation, files: Files, folder: Path, told: Told, progressed: Progressed
) -> Lived:
    async with _daemon(files) as process:
        log = _log(process, files.log, told)
        await _until(log, "ready")
        monitor = replies(folder / "socket", _question("Monitor"))
        news = [await asyncio.to_thread(next, monitor)]
        listening = asyncio.create_task(asyncio.to_thread(_listen, monitor, news))
        lived_s = await _serve(simulation, folder / "tty", log, progressed)
        calibration, status, energy = [
            await asyncio.to_thread(_asked, folder / "socket", *q) for q in QUESTIONS
        ]
        began = time.monotonic()
        process.terminate()
        try:
            async with asyncio.timeout(PATIENCE_S):
                await _until(log, "stopped")
                await process.wait()
                await listening
        except TimeoutError:
            raise DaemonDiedError(f"the daemon has not stopped {PATIENCE_S:.0f} s after SIGTERM") from None
        stopping_s = time.monotonic() - began
    events = [reply["parameters"]["event"] for reply in news]
    return Lived(calibration, status, energy, events, lived_s, stopping_s)


async def _serve(
    simulation: Simulation, path: Path, log: AsyncIterator[str], progressed: Progressed
) -> float:
    """Let the phone live at `path` until the daemon has let go of it; return how long it took, s."""
    began = time.monotonic()
    phone = asyncio.create_task(
        serve_phone(_reported(simulation, progressed), simulation.phone.claimed(), path=path)
    )
    await _until(log, "disconnected")
    try:
        await asyncio.wait_for(phone, PATIENCE_S)
    except TimeoutError:
        raise DaemonDiedError("the daemon let go of the phone too early") from None
    return time.monotonic() - began


@contextlib.asynccontextmanager
async def _daemon(files: Files) -> AsyncIterator[asyncio.subprocess.Process]:
    """Start the daemon, and see that it has ended."""
    command = Path(sys.executable).with_name("stillcal")
    process = await asyncio.create_subprocess_exec(
        command, "run", "--config", files.config, stderr=asyncio.subprocess.PIPE
    )
    try:
        yield process
    finally:
        if process.returncode is None:
            process.terminate()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(process.wait(), PATIENCE_S)
        if process.returncode is None:
            process.kill()
            await process.wait()


async def _log(process: asyncio.subprocess.Process, path: Path, told: Told) -> AsyncIterator[str]:
    """Keep the daemon's log in `path`, tell its events, and yield the name of each."""
    if process.stderr is None:
        raise DaemonDiedError("its log cannot be read")
    with path.open("wb") as file:
        async for line in process.stderr:
            file.write(line)
            event = line.decode(errors="replace").rstrip().split(maxsplit=3)[-1]
            told(event)
            yield event.split()[0].rstrip(":")
    raise DaemonDiedError(f"the daemon ended with code {await process.wait()}: see {path}")


async def _until(log: AsyncIterator[str], what: str) -> None:
    """Read the log until the event `what`."""
    async for event in log:
        if event == what:
            return


def _question(method: str) -> dict[str, Any]:
    parameters = {"limit": 400} if method == "GetEnergy" else {}
    return {"method": f"{NAME}.{method}", "parameters": parameters, "more": method == "Monitor"}


def _asked(path: Path, method: str, key: str) -> Any:
    """Ask, and return what the answer holds under `key`; None from an error."""
    (reply,) = replies(path, _question(method))
    return (reply.get("parameters") or {}).get(key)


def _listen(monitor: Iterator[dict[str, Any]], news: list[dict[str, Any]]) -> None:
    """Gather the news until the daemon hangs up."""
    with contextlib.suppress(NoDaemonError):
        for reply in monitor:
            if "event" in (reply.get("parameters") or {}):
                news.append(reply)


def _reported(simulation: Simulation, progressed: Progressed) -> Iterator[Chunk]:
    for chunk in simulation.chunks():
        progressed(chunk.t_end)
        yield chunk
