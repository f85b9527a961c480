"""Kill -9 in the middle of saving, counted: a real process, the daemon's own storage, any moment.

A life is a forked process that opens store and state as the daemon does, and then gathers a rest,
publishes a calibration and saves the state, over and over, telling of each write when it begins and when
it is acknowledged. It is killed after a random delay, two times of three counted from when it has opened
them, and what lies on the disk is held against what it told.
"""

from __future__ import annotations

import asyncio
import os
import random
import select
import signal
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.resources import as_file, files
from pathlib import Path

import msgspec

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.actions import Publish, Reject
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.static.rest import RestState
from stillcal.daemon.service import saved_state
from stillcal.daemon.service.storage import Storage
from stillcal.daemon.store.store import Store
from stillcal.replay.formats.rest_table import read_rest_table
from stillcal.replay.runner import replay_rests
from stillcal.replay.trials.faults.wire import Figures

LIFE_S = 0.15
"""Longest life before it is killed, s: several rounds of saving."""

OPENED, OPEN_S = "opened", 60.0
"""What a life tells when it has opened store and state, and the longest that this may take, s."""

NAMES = {"store.json", "store.json.last-good", "store.json.lock", "store.state"}
REST_S = 10.0

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Known:
    """What a life has had acknowledged: number of the newest calibration, rests in the saved state."""

    published: int = 0
    rests: int = 0


def example() -> tuple[CalibrationRecord, list[RestState]]:
    """Return a calibration of a real phone and the rests it stands on (ESGI'95, Table 1)."""
    with as_file(files("stillcal.config") / "esgi" / "dataset1.csv") as path:
        rests = read_rest_table(path)
    kept: list[Publish | Reject] = []
    replay_rests(rests, Engine(), kept.append)
    return kept[-1].record, rests


def killed(kills: int, seed: int, folder: Path, life_s: float = LIFE_S) -> Figures:
    """Let `kills` lives follow one another in an empty `folder`, each killed at random within `life_s`."""
    record, rests = example()
    chance, counts, known, path = random.Random(seed), Counter[str](), Known(), folder / "store.json"
    for _ in range(kills):
        opened, lasts = chance.random() < 2 / 3, chance.uniform(0.0, life_s)
        child, heard = in_child(lambda tell: asyncio.run(_saving(path, record, rests, tell)))
        known, writing = _ended(child, heard, known, lasts, opened)
        counts["killed inside a write"] += writing
        counts["half-written temporaries"] += any(p.suffix == ".tmp" for p in folder.iterdir())
        found, known = _examined(path, known)
        counts.update(found)
    judged = ("torn stores", "torn states", "lost calibrations", "lost rests", "state ahead", "strange files")
    judged_counts = {name: counts[name] for name in judged}
    holds = not any(judged_counts.values())
    more = ("killed inside a write", "half-written temporaries")
    saved = {"calibrations acknowledged": known.published, "rests acknowledged": known.rests}
    return Figures(f"{kills} times kill -9", holds, judged_counts | {n: counts[n] for n in more} | saved)


def in_child(action: Callable[[Tell], object]) -> tuple[int, int]:
    """Fork and return (the child's process id, a descriptor to read what `action` tells of, line by line)."""
    receive, send = os.pipe()
    child = os.fork()
    if child:
        os.close(send)
        return child, receive
    try:
        os.close(receive)
        action(lambda line: _told(send, line))
    except BaseException:  # a child must not run its parent's cleaning up
        os._exit(1)
    os._exit(0)


def _told(to: int, line: str) -> None:
    os.write(to, f"{line}\n".encode())


def _ended(child: int, heard: int, known: Known, lasts: float, opened: bool) -> tuple[Known, bool]:
    """End a life after `lasts` s, counted from when it has opened its files if `opened`.

    Return what was acknowledged, and whether a write was going on at the end.
    """
    if opened:
        select.select([heard], [], [], OPEN_S)
    time.sleep(lasts)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    with os.fdopen(heard, encoding="ascii") as lines:
        reports = [line.split() for line in lines]
    for what, *number in reports:
        if what == "published":
            known = replace(known, published=int(number[0]))
        elif what == "saved":
            known = replace(known, rests=int(number[0]))
    return known, bool(reports) and reports[-1][0] == "writing"


async def _saving(path: Path, record: CalibrationRecord, rests: list[RestState], tell: Tell) -> None:
    """Gather, publish and save without end, as the daemon does between its pauses."""
    storage = Storage(Store(path), tell)
    saved = storage.open().state or saved_state.SavedState(EngineState())
    tell(OPENED)
    engine, current = Engine(state=saved.engine), storage.document.current
    number = _number(current)
    while True:
        number += 1
        count = engine.state.counters.rests
        begin = REST_S * count
        rest = rests[count % len(rests)]
        engine.add_rests([msgspec.structs.replace(rest, t_start=begin, t_end=begin + REST_S)])
        newest = replace(record, fitted_at=float(number))
        engine.state.record = newest
        storage.enqueue(Publish(begin, newest, "newer"))
        tell("writing")
        if await storage.flush():
            tell(f"published {number}")
        tell("writing")
        if await storage.save(saved_state.encode(replace(saved, engine=engine.state))):
            tell(f"saved {engine.state.counters.rests}")


def _number(record: CalibrationRecord | None) -> int:
    """Return the number that a calibration was published under, 0 for none."""
    return 0 if record is None else int(record.fitted_at or 0)


def _examined(path: Path, known: Known) -> tuple[Counter[str], Known]:
    """Count what is wrong on the disk, and return how things stand now."""
    wrong = Counter[str]()
    found = Store(path).verify()
    wrong["torn stores"] = sum(part.problem is not None for part in (found.store, found.last_good))
    current = found.store.document.current if found.store.document else None
    number = _number(current)
    wrong["lost calibrations"] = max(known.published - number, 0)
    loaded = saved_state.load(saved_state.state_path(path))
    wrong["torn states"] = bool(loaded.note)
    engine = loaded.state.engine if loaded.state else EngineState()
    wrong["lost rests"] = max(known.rests - engine.counters.rests, 0)
    wrong["state ahead"] = max(_number(engine.record) - number, 0)
    strange = {p.name for p in path.parent.iterdir() if p.suffix != ".tmp"} - NAMES
    wrong["strange files"] = len(strange)
    return wrong, Known(number, engine.counters.rests)
