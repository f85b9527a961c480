"""Full calibrations in a running daemon, counted: what they delay, and what memory they keep.

The daemon is given twice the rests that it holds after a simulated week, and asked to calibrate again and
again while its phone sends in real time and clients ask. Every fit meets all of them, and all but the first
also hold every attitude out in turn.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.rest_pool import HeldRest, Pool
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.static.rest import RestState
from stillcal.daemon.service import saved_state
from stillcal.daemon.settings import SocketSettings
from stillcal.replay.phone import draw_rests, load_phone
from stillcal.replay.trials.faults.target import Target, ask, lateness, running
from stillcal.replay.trials.faults.waiting import LATE_S, Waits, slowest
from stillcal.replay.trials.faults.wire import Figures

QUIET_S = 3.0
"""How long nothing is asked of the daemon before the first calibration, and after the last, s."""

PAUSE_S = 0.02
"""Between the questions of one client, s."""

CLIENTS = 4
LATER_S = 1e6
"""When the pool's rests are said to begin, s: after every fit, so that each counts as held out."""

ATTITUDES, EACH = 40, 6
"""What the pool holds: attitudes, and rests in each."""

KEPT_MIB = 10.0
"""Memory that calibrating may leave in use, MiB."""


def calibrating(times: int, seed: int, folder: Path, quiet_s: float = QUIET_S) -> list[Figures]:
    """Calibrate so many times in a daemon that runs in `folder`, which is empty, with quiet around it."""
    return asyncio.run(_calibrating(times, seed, folder, quiet_s))


async def _calibrating(times: int, seed: int, folder: Path, quiet_s: float) -> list[Figures]:
    state = EngineState(pool=gathered(seed))
    data = saved_state.encode(saved_state.SavedState(state))
    saved_state.save(saved_state.state_path(folder / "store.json"), data)
    async with running(folder, SocketSettings(calls_per_s=1000.0)) as target:
        await asyncio.sleep(quiet_s)
        began = time.monotonic()
        asking = [asyncio.create_task(_asking(target)) for _ in range(CLIENTS)]
        took = [await _calibrate(target) for _ in range(times)]
        ended = time.monotonic()
        for client in asking:
            client.cancel()
        waits = [await client for client in asking]
        await asyncio.sleep(quiet_s)
    noted = np.load(folder / "lateness.npy")
    fits = Figures(
        f"{times} calibrations",
        True,
        {"rests held": len(state.pool.held), "longest, ms": round(1e3 * max(took))},
    )
    return [
        fits,
        lateness(noted, began, ended, "calibrating"),
        _answers(waits),
        _memory(noted, began, ended),
    ]


def gathered(seed: int, attitudes: int = ATTITUDES, each: int = EACH) -> Pool:
    """Return rests of a phone, `each` in so many attitudes all over the sphere."""
    up = np.random.default_rng(seed).normal(size=(attitudes, 3))
    up = np.repeat(up / np.linalg.norm(up, axis=1, keepdims=True), each, axis=0)
    drawn = draw_rests(load_phone("typical"), len(up), seed, duration_s=(10.0, 60.0), attitudes=up)
    rows = zip(drawn.t, drawn.duration, drawn.forces, drawn.white_uncertainties, strict=True)
    rests = (
        RestState(LATER_S + t, LATER_S + t + d, int(100 * d), frozen(f), frozen(30 * u), frozen(u), 0.01)
        for t, d, f, u in rows
    )
    gravity = Gravity(drawn.gravity, 0.0, "given")
    return Pool(tuple(HeldRest(rest, gravity) for rest in rests))


async def _calibrate(target: Target) -> float:
    """Have a calibration tried, whatever comes of it; return how long it took, s."""
    began = time.monotonic()
    reader, writer = await asyncio.open_unix_connection(target.socket)
    with contextlib.closing(writer):
        answer = await ask(reader, writer, "Calibrate")
    if answer.get("error", "Refused").rpartition(".")[2] != "Refused":
        raise RuntimeError(f"the daemon does not calibrate: {json.dumps(answer)}")
    return time.monotonic() - began


async def _asking(target: Target) -> Waits:
    """Ask how things stand until told to stop; return how long the answers took."""
    waits = Waits(target.process.pid)
    reader, writer = await asyncio.open_unix_connection(target.socket)
    with contextlib.closing(writer), contextlib.suppress(asyncio.CancelledError):
        await waits.repeat(lambda: ask(reader, writer), PAUSE_S)
    return waits


def _answers(waits: list[Waits]) -> Figures:
    took, own = [s for w in waits for s in w.took], [s for w in waits for s in w.own]
    counts = {"answers": len(took), **slowest(took, own)}
    return Figures("answers meanwhile", counts["slowest own, us"] <= 1e6 * LATE_S, counts)


def _memory(noted: Array, began: float, ended: float) -> Figures:
    """Return the memory in use before the first, at most, and after the last, KiB."""
    t, used = noted[:, 0], noted[:, 3] / 1024
    before, after = (round(float(np.median(used[part]))) for part in (t < began, t > ended))
    counts = {"before, KiB": before, "most, KiB": round(float(used.max())), "after, KiB": after}
    return Figures("memory of the daemon", after - before <= 1024 * KEPT_MIB, counts)
