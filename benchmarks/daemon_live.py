"""Item 2: the daemon itself, `stillcal run` on a pseudo-terminal, watched from outside through /proc.

A simulated phone sends in real time, a sample when it is due; the daemon is a process of its own. Shares of
a core are of its processor time, its children's with it.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from subject import phone
from timing import Row

from stillcal.daemon.api_place import NAME
from stillcal.daemon.cli_query import replies
from stillcal.replay.phone import Simulation, load_scenario, simulate
from stillcal.replay.phone_link import LinkSettings, serve_phone

CONFIG = """[store]
path = "{0}/store.json"
[source]
port = "{0}/tty"
[socket]
path = "{0}/socket"
[engine.schedule]
watch = "{1}"
"""
SETTLE_S, WATCH_S, ASKED = 4.0, 25.0, 400
_TICK = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class Usage:
    """What /proc says: processor seconds with children's, times a thread went to sleep, resident MB."""

    seconds: float
    sleeps: int
    resident: float
    at: float

    @classmethod
    def of(cls, pid: int) -> Usage:
        """Read them."""
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        sleeps = 0
        for task in Path(f"/proc/{pid}/task").iterdir():
            status = (task / "status").read_text()
            sleeps += int(status.split("voluntary_ctxt_switches:")[1].split()[0])
        resident = Path(f"/proc/{pid}/status").read_text().split("VmRSS:")[1].split()[0]
        cpu = sum(int(f) for f in fields[11:15]) / _TICK
        return cls(cpu, sleeps, int(resident) / 1024, time.monotonic())


@dataclass(slots=True)
class Daemon:
    """A daemon under watch. started: monotonic s. said: its log so far with when each line came."""

    process: subprocess.Popen[str]
    folder: Path
    started: float
    said: list[tuple[float, str]]

    def until(self, word: str, patience: float = 60.0) -> float:
        """Return when the log first said `word`, s after the start."""
        while time.monotonic() - self.started < patience:
            for at, line in list(self.said):
                if word in line:
                    return at - self.started
            time.sleep(0.005)
        raise TimeoutError(f"the daemon never said {word!r}: {self.said[-3:]}")

    def latencies(self, count: int) -> np.ndarray:
        """Ask so often, and return how long each answer took, s."""
        taken = []
        for _ in range(count):
            began = time.perf_counter()
            list(replies(self.folder / "socket", {"method": f"{NAME}.GetStatus", "parameters": {}}))
            taken.append(time.perf_counter() - began)
            time.sleep(0.01)
        return np.array(taken)


@contextlib.contextmanager
def daemon(watch: str, simulation: Simulation, speed: float) -> Iterator[Daemon]:
    """Start a daemon with a phone on its line; both have ended afterwards."""
    with tempfile.TemporaryDirectory(prefix="stillcal-") as name:
        folder = Path(name)
        (folder / "config.toml").write_text(CONFIG.format(folder, watch))
        settings = LinkSettings(speed=speed, credit=speed == float("inf"), step_s=0.02)
        plugged = threading.Event()
        thread = threading.Thread(
            target=_serve, args=(simulation, settings, folder / "tty", plugged), daemon=True
        )
        thread.start()
        plugged.wait(30)
        command = [Path(sys.executable).with_name("stillcal"), "run", "--config", folder / "config.toml"]
        began = time.monotonic()
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            found = Daemon(process, folder, began, [])
            reader = threading.Thread(target=_read, args=(process, found.said), daemon=True)
            reader.start()
            try:
                yield found
            finally:
                process.terminate()
                process.wait(20)


def _serve(simulation: Simulation, settings: LinkSettings, path: Path, plugged: threading.Event) -> None:
    with contextlib.suppress(OSError, RuntimeError):
        asyncio.run(
            serve_phone(
                simulation.chunks(), simulation.phone.claimed(), settings, path, lambda _: plugged.set()
            )
        )


def _read(process: subprocess.Popen[str], said: list[tuple[float, str]]) -> None:
    assert process.stderr is not None
    for line in process.stderr:
        said.append((time.monotonic(), line))


def _at(rate_hz: float, scenario: str) -> Simulation:
    own = phone()
    sensors: dict[str, Any] = {
        k: msgspec.structs.replace(getattr(own, k), rate_hz=rate_hz) for k in ("accel", "gyro")
    }
    return simulate(load_scenario(scenario), msgspec.structs.replace(own, **sensors), 0)


def run(quick: bool) -> Iterator[Row]:
    """Yield the rows of item 2."""
    seconds = 8.0 if quick else WATCH_S
    for rate in (100.0, 400.0):
        for watch in ("continuous", "probing"):
            yield from _live(rate, watch, seconds, 100 if quick else ASKED)
    yield from _memory()


def _live(rate: float, watch: str, seconds: float, asked: int) -> Iterator[Row]:
    with daemon(watch, _at(rate, "desk"), 1.0) as found:
        first = found.until("connected")
        time.sleep(SETTLE_S)
        before = Usage.of(found.process.pid)
        time.sleep(seconds)
        after = Usage.of(found.process.pid)
        waits = found.latencies(asked)
    span = after.at - before.at
    share = 100.0 * (after.seconds - before.seconds) / span
    what = f"daemon live at {rate:.0f} Hz, {watch}"
    goal = ("under 0.5 %", share < 0.5) if watch == "probing" else ("", None)
    yield Row("2", f"{what}: share of a core", share, "%", goal=goal[0], met=goal[1])
    yield Row("2", f"{what}: wake-ups", (after.sleeps - before.sleeps) / span, "1/s")
    p99 = float(np.quantile(waits, 0.99)) * 1e3
    half = f"median {np.median(waits) * 1e3:.2f} ms"
    yield Row("2", f"{what}: answer, 99 of 100 within", p99, "ms", accuracy=half, goal="5 ms", met=p99 < 5.0)
    if watch == "probing" and rate == 100.0:
        yield Row("2", "start to first sample read", first, "s", goal="0.3 s", met=first <= 0.3)


def _memory() -> Iterator[Row]:
    """Resident memory before the first calibration, and after ten minutes as fast as they are taken."""
    with daemon("continuous", _at(100.0, "lab"), 1.0) as found:
        found.until("connected")
        time.sleep(SETTLE_S)
        before = Usage.of(found.process.pid).resident
    with daemon("continuous", _at(100.0, "lab"), float("inf")) as found:
        found.until("calibrated", 120.0)
        time.sleep(1.0)
        after = Usage.of(found.process.pid)
    yield Row(
        "2", "resident memory before the first calibration", before, "MB", goal="45 MB", met=before <= 45.0
    )
    yield Row(
        "2",
        "resident memory after it",
        after.resident,
        "MB",
        goal="back near it",
        met=after.resident < 1.2 * before,
        accuracy=f"{after.seconds:.2f} s of processor time for ten minutes of both sensors",
    )
