"""Kill -9 of the whole daemon at random moments, counted: a phone on a pseudo-terminal, everything real.

The phone goes on from life to life and is turned over all the time; the settings make a day's work of half
an hour: a full calibration every few minutes of its time, which is two a second of ours, each with store
and state written. What a life is heard to have stored, and what earlier lives left, must be there after it.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
import subprocess
import sys
from collections import Counter
from collections.abc import AsyncIterator
from dataclasses import dataclass, replace
from pathlib import Path

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.state import EngineState
from stillcal.daemon.cli.query import NoDaemonError, replies
from stillcal.daemon.service import saved_state
from stillcal.daemon.store.store import Store
from stillcal.daemon.varlink.address import NAME
from stillcal.replay.phone import simulate
from stillcal.replay.phone.activities.resting import Poses
from stillcal.replay.phone.scenario import Scenario
from stillcal.replay.serial_phone.link import LinkSettings, serve_phone
from stillcal.replay.trials.demo.tour import phone_at
from stillcal.replay.trials.faults.kill import NAMES
from stillcal.replay.trials.faults.wire import Figures

SPEED, RATE_HZ = 200.0, 25.0
POSES = 3_000
"""That the phone is laid in before it ends: more than thousands of lives see."""

LIFE_S = 3.0
"""Longest life after the daemon has begun to answer, s; a third of the lives end before that."""

START_S = 60.0
ASK_S = 0.05
SETTINGS = f"""\
[engine.schedule]
watch = "continuous"
check_interval_s = 100.0
review_interval_s = 10.0
recalibrate_interval_s = 100.0
[source]
rate_hz = {RATE_HZ}
[log]
level = "error"
"""


@dataclass(frozen=True, slots=True)
class Left:
    """What is stored after a kill: time of the newest calibration, s, and number of rests in the state."""

    fitted_at: float = -1.0
    rests: int = 0


def killed_live(kills: int, seed: int, folder: Path, life_s: float = LIFE_S) -> Figures:
    """Let `kills` daemons follow one another in an empty `folder`, each killed at random within `life_s`."""
    return asyncio.run(_killed(kills, seed, folder, life_s))


async def _killed(kills: int, seed: int, folder: Path, life_s: float) -> Figures:
    chance, counts, left = random.Random(seed), Counter[str](), Left()
    (folder / "stillcal.toml").write_text(SETTINGS)
    async with _phone(folder, seed):
        for _ in range(kills):
            heard = await _life(folder, chance, life_s)
            counts["calibrations heard to be stored"] += heard.fitted_at > left.fitted_at
            counts["half-written temporaries"] += any(p.suffix == ".tmp" for p in folder.iterdir())
            known = replace(left, fitted_at=max(left.fitted_at, heard.fitted_at))
            found, left = _examined(folder / "store.json", known)
            counts.update(found)
    judged = ("torn stores", "torn states", "lost calibrations", "lost rests", "state ahead", "strange files")
    judged_counts = {name: counts[name] for name in judged}
    more = {n: counts[n] for n in ("half-written temporaries", "calibrations heard to be stored")}
    holds = not any(judged_counts.values()) and left.rests > 0
    return Figures(
        f"{kills} times kill -9 of the daemon", holds, judged_counts | more | {"rests kept": left.rests}
    )


@contextlib.asynccontextmanager
async def _phone(folder: Path, seed: int) -> AsyncIterator[None]:
    scenario = Scenario(segments=(Poses(count=POSES, rest_s=(4.0, 6.0), charging=True),))
    settings = LinkSettings(speed=SPEED, credit=False)
    chunks = simulate(scenario, phone_at(RATE_HZ), seed).chunks()
    phone = asyncio.create_task(serve_phone(chunks, {"device": "turned"}, settings, folder / "tty"))
    try:
        yield
    finally:
        phone.cancel()
        await asyncio.gather(phone, return_exceptions=True)


async def _life(folder: Path, chance: random.Random, lasts: float) -> Left:
    """Start a daemon, kill it `lasts` s after it answers at most; return what it was heard to have stored."""
    names = {"config": "stillcal.toml", "port": "tty", "store": "store.json", "socket": "socket"}
    options = [part for option, name in names.items() for part in (f"--{option}", str(folder / name))]
    command = [sys.executable, "-c", "from stillcal.daemon.cli.main import main; main()", "run", *options]
    daemon = subprocess.Popen(command)
    heard = Left()
    try:
        if chance.random() < 1 / 3:
            await asyncio.sleep(chance.uniform(0.0, lasts))
            return heard
        async with asyncio.timeout(START_S):
            while not await asyncio.to_thread(_answers, folder):
                await asyncio.sleep(ASK_S)
        until = asyncio.get_running_loop().time() + chance.uniform(0.0, lasts)
        while asyncio.get_running_loop().time() < until:
            heard = await asyncio.to_thread(_stored, folder, heard)
            await asyncio.sleep(min(ASK_S, max(until - asyncio.get_running_loop().time(), 0.0)))
    finally:
        daemon.kill()
        await asyncio.to_thread(daemon.wait)
    return heard


def _answers(folder: Path) -> bool:
    with contextlib.suppress(NoDaemonError):
        return bool(list(replies(folder / "socket", {"method": f"{NAME}.GetStatus"})))
    return False


def _stored(folder: Path, heard: Left) -> Left:
    """Ask for the calibration; what is said to be stored is acknowledged."""
    (reply,) = replies(folder / "socket", {"method": f"{NAME}.GetCalibration"})
    found = (reply.get("parameters") or {}).get("calibration") or {}
    return replace(heard, fitted_at=found["fitted_at_s"]) if found.get("stored") else heard


def _examined(path: Path, known: Left) -> tuple[Counter[str], Left]:
    """Count what is wrong on the disk, and return how things stand now."""
    wrong, found = Counter[str](), Store(path).verify()
    wrong["torn stores"] = sum(part.problem is not None for part in (found.store, found.last_good))
    fitted_at = _fitted_at(found.store.document.current if found.store.document else None)
    wrong["lost calibrations"] = fitted_at < known.fitted_at
    loaded = saved_state.load(saved_state.state_path(path))
    wrong["torn states"] = bool(loaded.note)
    engine = loaded.state.engine if loaded.state else EngineState()
    wrong["lost rests"] = max(known.rests - engine.counters.rests, 0)
    wrong["state ahead"] = _fitted_at(engine.record) > fitted_at
    left = {p.name for p in path.parent.iterdir() if p.suffix != ".tmp" and not p.name.startswith(".socket")}
    wrong["strange files"] = len(left - NAMES - {"stillcal.toml", "tty", "socket"})
    return wrong, Left(fitted_at, engine.counters.rests)


def _fitted_at(record: CalibrationRecord | None) -> float:
    return -1.0 if record is None or record.fitted_at is None else record.fitted_at
