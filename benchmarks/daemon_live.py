"""Item 2: the daemon itself, `stillcal run` on a pseudo-terminal, watched from outside.

A simulated phone sends in real time, every 20 ms what is due; the daemon is a process of its own. Shares of
a core are of its processor time by its own clock (clock_getcpuclockid(3)), its children's with it.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from subject import day, phone
from timing import Row, middle

from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings
from stillcal.calib_core.streams.events import End
from stillcal.daemon.cli.query import replies
from stillcal.daemon.varlink.address import NAME
from stillcal.replay.phone import Simulation, load_scenario, simulate
from stillcal.replay.serial_phone.link import LinkSettings, serve_phone

CONFIG = """[store]
path = "{0}/store.json"
[source]
port = "{0}/tty"
[socket]
path = "{0}/socket"
[engine.schedule]
watch = "{1}"
"""
SETTLE_S, WATCH_S, PARTS, ASKED = 4.0, 60.0, 5, 400
GOAL_MB = 45.0
_TICK = os.sysconf("SC_CLK_TCK")
_ALL_THREADS = 2  # of a process, what the scheduler counted


@dataclass(frozen=True, slots=True)
class Usage:
    """Processor seconds with children's, times a thread went to sleep, resident MB."""

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
        children = sum(int(f) for f in fields[13:15]) / _TICK
        cpu = time.clock_gettime((~pid << 3) | _ALL_THREADS) + children
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
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=_installed()) as process:
            found = Daemon(process, folder, began, [])
            reader = threading.Thread(target=_read, args=(process, found.said), daemon=True)
            reader.start()
            try:
                yield found
            finally:
                process.terminate()
                process.wait(20)


def _installed() -> dict[str, str]:
    """Return this environment as an installed daemon has it: code is compiled once, not at every start."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


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
    seconds, shares = (8.0 if quick else WATCH_S), dict[str, float]()
    for rate in (100.0, 400.0):
        for watch in ("continuous", "probing"):
            shares[watch] = yield from _live(rate, watch, seconds, 100 if quick else ASKED)
        yield _average(rate, shares)
    yield _start(3 if quick else 9)
    yield _socket_alone(100 if quick else ASKED)
    yield from _memory()


def _live(rate: float, watch: str, seconds: float, asked: int) -> Generator[Row, None, float]:
    """Watch a daemon for so long, then ask it; return its share of a core in %."""
    with daemon(watch, _at(rate, "desk"), 1.0) as found:
        found.until("connected")
        time.sleep(SETTLE_S)
        seen = [Usage.of(found.process.pid)]
        for _ in range(PARTS):
            time.sleep(seconds / PARTS)
            seen.append(Usage.of(found.process.pid))
        waits = found.latencies(asked)
    pairs = list(itertools.pairwise(seen))
    share = middle(np.array([100.0 * (b.seconds - a.seconds) / (b.at - a.at) for a, b in pairs]))
    woken = (seen[-1].sleeps - seen[0].sleeps) / (seen[-1].at - seen[0].at)
    whole = 100.0 * (seen[-1].seconds - seen[0].seconds) / (seen[-1].at - seen[0].at)
    what = f"daemon live at {rate:.0f} Hz, {watch}"
    goal = ("under 0.5 %", whole < 0.5) if watch == "probing" else ("", None)
    words, margin = f"{whole:.3f} % over all {seconds:.0f} s", 0.5 / max(whole, 1e-9)
    yield Row(
        "2", f"{what}: share of a core", share, "%", goal=goal[0], met=goal[1], accuracy=words, margin=margin
    )
    yield Row("2", f"{what}: wake-ups", woken, "1/s")
    p99 = float(np.quantile(waits, 0.99)) * 1e3
    half = f"median {np.median(waits) * 1e3:.2f} ms of {asked} questions"
    yield Row(
        "2",
        f"{what}: answer, 99 of 100 within",
        p99,
        "ms",
        accuracy=half,
        goal="5 ms",
        met=p99 < 5.0,
        margin=5.0 / p99,
    )
    return whole


def _start(count: int) -> Row:
    """Start it so often, by the clock, from the shell's call to the phone's first words being read."""
    taken = []
    for _ in range(count):
        with daemon("continuous", _at(100.0, "desk"), 1.0) as found:
            taken.append(found.until("connected"))
    spread, what = middle(np.array(taken)), "start to first sample read"
    return Row("2", what, spread, "s", goal="0.3 s", met=spread[0] <= 0.3, margin=0.3 / spread[0])


def _average(rate: float, shares: dict[str, float]) -> Row:
    """Weigh what was measured by how long a day's allowance has the sensors on (calibrating.py's day)."""
    subject = day()
    engine = Engine(EngineSettings())
    engine.feed(subject.accelerometer)
    engine.feed(End(float(subject.accelerometer.t[-1])))
    on = engine.ledger.asked_s / 86400.0
    share = on * shares["continuous"] + (1.0 - on) * shares["probing"]
    words = f"computed: sensors on {100.0 * on:.1f} % of the day, as continuous; else as probing"
    what = f"daemon at {rate:.0f} Hz, duty-cycled: share of a core on average"
    return Row("2", what, share, "%", goal="under 0.1 %", met=share < 0.1, accuracy=words, margin=0.1 / share)


def _socket_alone(asked: int) -> Row:
    """Time connecting to a socket, one byte there and one back, to another thread: the system's part."""
    with tempfile.TemporaryDirectory(prefix="stillcal-") as name, socket.socket(socket.AF_UNIX) as server:
        server.bind(f"{name}/socket")
        server.listen()
        threading.Thread(target=_echo, args=(server, asked), daemon=True).start()
        taken = []
        for _ in range(asked):
            began = time.perf_counter()
            with socket.socket(socket.AF_UNIX) as client:
                client.connect(f"{name}/socket")
                client.sendall(b"?")
                client.recv(1)
            taken.append(time.perf_counter() - began)
            time.sleep(0.01)
    p99 = float(np.quantile(taken, 0.99)) * 1e3
    half = f"median {np.median(taken) * 1e3:.2f} ms"
    return Row("2", "an empty answer at such a socket, 99 of 100 within: the limit", p99, "ms", accuracy=half)


def _echo(server: socket.socket, count: int) -> None:
    for _ in range(count):
        with server.accept()[0] as client:
            client.sendall(client.recv(1))


def _memory() -> Iterator[Row]:
    """Resident memory before the first calibration, and after ten minutes as fast as they are taken."""
    with daemon("continuous", _at(100.0, "lab"), 1.0) as found:
        found.until("connected")
        time.sleep(SETTLE_S)
        before = Usage.of(found.process.pid).resident
    with daemon("continuous", _at(100.0, "lab"), float("inf")) as found:
        found.until("calibrated", 120.0)
        time.sleep(SETTLE_S)
        after = Usage.of(found.process.pid)
    what = "resident memory before the first calibration"
    yield Row("2", what, before, "MB", goal="45 MB", met=before <= GOAL_MB, margin=GOAL_MB / before)
    near = 1.1 * GOAL_MB
    words = f"{after.seconds:.2f} s of processor time for ten minutes of both sensors"
    yield Row(
        "2",
        "resident memory after it",
        after.resident,
        "MB",
        goal="near 45 MB (within a tenth)",
        met=after.resident <= near,
        accuracy=f"{after.resident - before:+.1f} MB; {words}",
        margin=near / after.resident,
    )
