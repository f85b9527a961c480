"""A daemon for faults to be played on: a process of its own, with a phone in real time, that notes how it is.

What is done to it is socket.py's and fit.py's.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import subprocess
import sys
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stillcal.calib_core.arrays import Array
from stillcal.daemon.settings import SocketSettings
from stillcal.daemon.varlink.address import NAME
from stillcal.replay.phone import load_phone, load_scenario, simulate
from stillcal.replay.serial_phone.link import LinkSettings, serve_phone
from stillcal.replay.trials.faults.waiting import LATE_S, slowest
from stillcal.replay.trials.faults.wire import Figures

START_S = 60.0


@dataclass(frozen=True, slots=True)
class Target:
    """A running daemon. folder: where its files are; settings: its limits; process: itself."""

    folder: Path
    settings: SocketSettings
    process: subprocess.Popen[bytes]

    @property
    def socket(self) -> str:
        """Where it answers."""
        return str(self.folder / "socket")

    @property
    def arguments(self) -> list[str]:
        """Its settings, port, store and socket."""
        return [str(self.folder / name) for name in ("stillcal.toml", "tty", "store.json", "socket")]

    def sockets(self) -> int:
        """Count the sockets that it has open (proc_pid_fd(5))."""
        links = Path(f"/proc/{self.process.pid}/fd").iterdir()
        return sum(_link(link).startswith("socket:") for link in links)


def question(method: str, **parameters: Any) -> bytes:
    """Return a whole question to the daemon's interface."""
    return json.dumps({"method": f"{NAME}.{method}", "parameters": parameters}).encode() + b"\0"


@contextlib.asynccontextmanager
async def running(folder: Path, settings: SocketSettings) -> AsyncIterator[Target]:
    """Run a daemon with a phone in real time; it ends cleanly, or RuntimeError is raised."""
    names = ("connections", "message_bytes", "calls_per_s", "stall_s")
    lines = [f"{name} = {getattr(settings, name)}" for name in names]
    (folder / "stillcal.toml").write_text("\n".join(["[socket]", *lines, ""]))
    chunks = simulate(load_scenario("lab"), load_phone("typical"), 1).chunks()
    phone = asyncio.create_task(
        serve_phone(chunks, {}, LinkSettings(speed=1.0, credit=False), folder / "tty")
    )
    target = Target(folder, settings, _started(folder))
    try:
        await asyncio.wait_for(_sampling(target), START_S)
        yield target
    finally:
        target.process.terminate()
        code = await asyncio.to_thread(target.process.wait, START_S)
        phone.cancel()
    if code:
        raise RuntimeError(f"the daemon ended with exit code {code}")


def _started(folder: Path) -> subprocess.Popen[bytes]:
    names = ("stillcal.toml", "tty", "store.json", "socket", "lateness.npy")
    command = [
        sys.executable,
        "-m",
        "stillcal.replay.trials.faults.daemon",
        *(str(folder / name) for name in names),
    ]
    return subprocess.Popen(command)


async def _sampling(target: Target) -> None:
    """Wait until the daemon answers and samples come."""
    while True:
        with contextlib.suppress(OSError, EOFError):
            if (await status(target))["wire"]["samples"] > 0:
                return
        await asyncio.sleep(0.05)


async def status(target: Target) -> dict[str, Any]:
    """Ask how the daemon is."""
    reader, writer = await asyncio.open_unix_connection(target.socket)
    try:
        found: dict[str, Any] = (await ask(reader, writer))["parameters"]["status"]
    finally:
        writer.close()
    return found


async def ask(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, method: str = "GetStatus"
) -> dict[str, Any]:
    """Ask over a connection and return the answer."""
    writer.write(question(method))
    answer: dict[str, Any] = json.loads((await reader.readuntil(b"\0"))[:-1])
    return answer


def lateness(noted: Array, began: float, ended: float, what: str) -> Figures:
    """Return how late the event loop woke during `what` and before; noted: rows (n, 4) as Notes takes them.

    Holds where its own share was never more than LATE_S.
    """
    during = (noted[:, 0] >= began) & (noted[:, 0] <= ended)
    counts = {"wake-ups": int(during.sum())}
    for name, part in (("quiet", noted[noted[:, 0] < began]), (what, noted[during])):
        found = slowest(part[:, 1], part[:, 1] - part[:, 2])
        counts |= {f"{name} {key}": us for key, us in found.items()}
    holds = counts[f"{what} slowest own, us"] <= 1e6 * LATE_S
    return Figures(f"the loop's lateness, {what}", holds, counts)


def _link(path: Path) -> str:
    try:
        return str(path.readlink())
    except OSError:
        return ""
