"""A year of a phone before the daemon itself, as fast as it goes: `python -m stillcal.replay.trials.year`.

`stillcal run` in a process of its own, on a pseudo-terminal, with a phone that waits for grants and leaves
out what is not asked for. At every midnight of the phone's it notes memory, descriptors, threads, and bytes
of state, store and log. Each day a client asks and one listens and leaves; each week the phone is pulled out
and comes back as a new session; each month the settings are read again. What grows shows by the quarters: the
level of the last must not exceed that of the second by more than SLACK and by more than chance, or the exit
code is 1. A level is what three days in four keep below: one day with a self-diagnosis at midnight is none.

State and store both hold the rests that the calibration in use was fitted to: 53 of them or 189, as it came,
and until another calibration is accepted. They are counted by themselves, against the most that the daemon
gathers, and not in the bytes of state and store.
"""

from __future__ import annotations

import asyncio
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.calibration.rest_pool import PoolSettings
from stillcal.daemon.cli.query import replies
from stillcal.daemon.service.saved_state import decode, state_path
from stillcal.daemon.store.document import StoreDocument, parse, render
from stillcal.daemon.store.msgpack_arrays import encoded
from stillcal.daemon.varlink.address import NAME
from stillcal.daemon.wire.messages import Hello
from stillcal.replay.serial_phone.link import LinkSettings, PhoneLink
from stillcal.replay.serial_phone.stream import PhoneStream
from stillcal.replay.trials.faults.endure import RUN
from stillcal.replay.trials.faults.target import question
from stillcal.replay.trials.year.phone import YEAR_DAYS, YearPhone

SLACK = 0.05
"""Share by which a figure's level may be higher in the last quarter than in the second."""

LEVEL = 0.75
"""Share of a quarter's days that keep below its level. A leak that began 23 days before the end raises it."""

CHANCE = 0.01
"""Probability that the days of two alike quarters differ as much (Mann and Whitney 1947)."""

SELDOM = """
[engine.schedule]
check_interval_s = 86400.0
recalibrate_interval_s = 86400.0
[engine.energy]
on_time_fraction = 0.002
[engine.detector]
w_spread_s = 2.0
probe_min_s = 1200.0
probe_max_s = 6000.0
"""
"""Settings under which a year passes sooner: looked at, checked and calibrated less often.

Looks and calibrations are what a day costs. History, pool, log and sessions fill as they do with the settings
of every day, only later.
"""

UNLIMITED = "from stillcal.daemon.system import log; log.REFILL_S = 1e-9; "
"""The log's limit on repeated lines goes by the host's time, in which a year is over too soon for them."""

WEEK, MONTH = 7, 30
PATIENCE_S = 60.0

MIDNIGHT = np.dtype(
    [
        (name, np.int64)
        for name in ("day", "memory", "descriptors", "threads", "state", "store", "log", "files", "rests")
    ]
)
"""How things stood at a midnight. memory, state, store: bytes; log: of the day; files: in the folder.

rests: those of the calibration in use, whose bytes are not in those of state and store.
"""

MOST_RESTS = PoolSettings().attitudes * PoolSettings().rests_per_attitude
"""Rests that the daemon gathers at most, and so the most that a calibration can be fitted to."""

JUDGED = ("memory", "descriptors", "threads", "state", "store", "log", "files")


@dataclass(frozen=True, slots=True)
class Lived:
    """What came of it. midnights: (n,) of MIDNIGHT. status: the daemon's last answer."""

    midnights: NDArray[np.void]
    status: Mapping[str, object]
    exit_code: int


@dataclass(frozen=True, slots=True)
class Growth:
    """How a figure went. second, last: the levels of those quarters of the time.

    chance: probability that the last quarter's days are as much larger than the second's where nothing grows.
    """

    name: str
    first_day: int
    second: float
    last: float
    chance: float

    @property
    def flat(self) -> bool:
        """Whether it is no larger at the end than after half the time."""
        return self.last <= self.second * (1 + SLACK) or self.chance > CHANCE


def live(days: int, phone: YearPhone, folder: Path, told: Callable[[str], None], settings: str) -> Lived:
    """Let the daemon live for so many days in an empty folder; told: is given a line for each week."""
    (folder / "stillcal.toml").write_text(f"[source]\nrate_hz = {phone.rate_hz}\n{settings}")
    return asyncio.run(_live(days, phone, folder, told))


async def _live(days: int, phone: YearPhone, folder: Path, told: Callable[[str], None]) -> Lived:
    names = {"config": "stillcal.toml", "port": "tty", "store": "store.json", "socket": "socket"}
    options = [part for option, name in names.items() for part in (f"--{option}", str(folder / name))]
    with (folder / "log").open("wb") as log:
        daemon = subprocess.Popen([sys.executable, "-c", UNLIMITED + RUN, "run", *options], stderr=log)
    rows: list[tuple[int, ...]] = []
    loop = asyncio.get_running_loop()
    link: PhoneLink

    def midnight(day: int) -> None:
        if daemon.poll() is not None:
            raise RuntimeError(f"the daemon ended with exit code {daemon.returncode}")
        _ask(folder / "socket")
        rows.append(_looked(day, daemon.pid, folder, sum(row[6] for row in rows)))
        if day % WEEK == 0:
            told(_line(rows[-1]))
            loop.call_soon(_come_back, link, day, folder / "tty")
        if day % MONTH == 0:
            daemon.send_signal(signal.SIGHUP)

    try:
        stream = PhoneStream(phone.chunks(days + 1, midnight))
        hello = Hello(session=1, flow="credit", claims={"device": "year"})
        settings = LinkSettings(credit=True, stride_s=600.0, repeat_s=0.2)
        async with PhoneLink(stream, hello, settings) as link:
            link.plug(folder / "tty")
            await link.serve()
        (answer,) = replies(folder / "socket", {"method": f"{NAME}.GetStatus"})
    finally:
        daemon.terminate()
        code = await asyncio.to_thread(daemon.wait, PATIENCE_S)
    return Lived(np.array(rows, MIDNIGHT), answer["parameters"]["status"], code)


def _come_back(link: PhoneLink, session: int, path: Path) -> None:
    """Pull the phone out, and plug it in as one that was started again."""
    link.unplug()
    link.hello = Hello(session=session, flow="credit", claims={"device": "year"})
    link.plug(path)


def _ask(path: Path) -> None:
    """Ask for all there is as one client, listen as another, and leave both without a word."""
    for method in ("GetStatus", "GetHistory", "GetEnergy"):
        list(replies(path, {"method": f"{NAME}.{method}"}))
    with socket.socket(socket.AF_UNIX) as line:
        line.connect(str(path))
        line.sendall(question("Monitor").replace(b"}", b', "more": true}', 1))


def _looked(day: int, pid: int, folder: Path, logged: int) -> tuple[int, ...]:
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    store = folder / "store.json"
    rests, in_store, in_state = _evidence(store)
    return (
        day,
        int(status["VmRSS"].split()[0]) * 1024,
        len(list(Path(f"/proc/{pid}/fd").iterdir())),
        int(status["Threads"]),
        _size(state_path(store)) - in_state,
        _size(store) - in_store,
        _size(folder / "log") - logged,
        len(list(folder.iterdir())),
        rests,
    )


def _evidence(store: Path) -> tuple[int, int, int]:
    """Return how many rests the calibration in use was fitted to, and their bytes in store and state."""
    document = parse(store.read_bytes())[0] if store.exists() else StoreDocument()
    known = document.current
    if known is None:
        return 0, 0, 0
    bare = replace(document, current=replace(known, states=()))
    state = state_path(store)
    held = decode(state.read_bytes()).engine.record if state.exists() else None
    in_state = 0 if held is None else len(encoded(held.states))
    return len(known.states), len(render(document)) - len(render(bare)), in_state


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _line(row: tuple[int, ...]) -> str:
    day, memory, descriptors, threads, state, store, log, files, rests = row
    return (
        f"{day:4} {memory / 2**20:8.2f} {descriptors:6} {threads:8} {state / 1024:10.1f}"
        f" {store / 1024:10.1f} {log:8} {files:6} {rests:6}"
    )


def growth(midnights: NDArray[np.void]) -> list[Growth]:
    """Return how each figure went. Raises ValueError for less than four days."""
    n = len(midnights)
    if n < 4:
        raise ValueError(f"{n} days: four are needed, for quarters")
    second, last = midnights[n // 4 : n // 2], midnights[n - n // 4 :]
    return [
        Growth(
            name,
            int(midnights[name][0]),
            _level(second[name]),
            _level(last[name]),
            _chance(second[name], last[name]),
        )
        for name in JUDGED
    ]


def _level(values: NDArray[np.int64]) -> float:
    return float(np.quantile(values, LEVEL, method="higher"))


def _chance(before: NDArray[np.int64], after: NDArray[np.int64]) -> float:
    """Return the one-sided p value of Mann and Whitney's test; with few days it is never small."""
    from scipy.stats import mannwhitneyu  # noqa: PLC0415 - once, at the end

    return float(mannwhitneyu(after, before, alternative="greater").pvalue)


@click.command()
@click.option("--days", type=click.IntRange(4), default=YEAR_DAYS, show_default=True)
@click.option("--seed", default=1, show_default=True)
@click.option("--rate", default=10.0, show_default=True, help="Hz of both sensors.")
@click.option("--often", is_flag=True, help="The daemon's own settings: ten times as long.")
@click.option(
    "--keep", type=click.Path(path_type=Path), help="Folder for store, state and log; else thrown away."
)
def main(days: int, seed: int, rate: float, often: bool, keep: Path | None) -> None:
    """Let the daemon live for a year of a phone's time; exit code 1 where something grows."""
    click.echo(" day  RSS MiB  files  threads  state KiB  store KiB  log B/d folder  rests")
    with tempfile.TemporaryDirectory(prefix="stillcal-") as scratch:
        folder = Path(scratch) if keep is None else keep
        folder.mkdir(parents=True, exist_ok=True)
        lived = live(days, YearPhone(seed, rate), folder, click.echo, "" if often else SELDOM)
    found = growth(lived.midnights)
    click.echo(f"\n{'':12} {'first day':>12} {'2nd quarter':>12} {'last quarter':>12}")
    for g in found:
        judged = "flat" if g.flat else "GROWS"
        click.echo(f"{g.name:12} {g.first_day:12} {g.second:12.0f} {g.last:12.0f} {judged}")
    rests = int(lived.midnights["rests"].max())
    click.echo(f"the calibration in use was fitted to {rests} rests at most (can be {MOST_RESTS})")
    counters = lived.status["counts"]
    click.echo(f"exit code {lived.exit_code}; {counters}")
    sys.exit(not all(g.flat for g in found) or rests > MOST_RESTS or lived.exit_code != 0)


if __name__ == "__main__":
    main()
