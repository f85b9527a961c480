"""A daemon that measures itself, for faults to be played on: what socket.py and fit.py start.

It is `stillcal run` with one job more, which notes by how much later than asked it is woken, for how long of
that it had no processor, and how much memory the process has in use.
"""

from __future__ import annotations

import asyncio
import sys
import time
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.daemon.app import Service
from stillcal.daemon.app_launch import LaunchOptions
from stillcal.daemon.system import log
from stillcal.daemon.system.memory import exempt_from_collection, limit_arenas, resident_bytes
from stillcal.daemon.system.systemd import Notifier
from stillcal.replay.trials.faults.waiting import withheld_s

STEP_S = 0.01
KEPT = 100_000
"""Wake-ups noted, more than a quarter of an hour of them."""


class Notes:
    """Rows of when, by how much too late, for how long of that without a processor (s), and memory (bytes).

    When: by CLOCK_MONOTONIC.
    """

    def __init__(self) -> None:
        self._rows = np.zeros((KEPT, 4))
        self._filled = 0

    @property
    def rows(self) -> Array:
        """What has been noted, (n, 4)."""
        return self._rows[: self._filled]

    async def take(self) -> None:
        """Wake every STEP_S and note the time, the delay and the memory, until the table is full."""
        while self._filled < KEPT:
            due, before = time.monotonic() + STEP_S, withheld_s()
            await asyncio.sleep(STEP_S)
            now, late = time.monotonic(), time.monotonic() - due
            self._rows[self._filled] = now, late, min(withheld_s() - before, late), resident_bytes()
            self._filled += 1


async def _serve(given: LaunchOptions, report: Path) -> None:
    service = Service(given.settings(), given, Notifier({}))
    service.open()
    notes = Notes()
    exempt_from_collection()
    noting = asyncio.create_task(notes.take())
    await service.run()
    noting.cancel()
    np.save(report, notes.rows)


def main() -> None:
    """Serve until SIGTERM; arguments: settings, port, store, socket, and where the notes go (.npy)."""
    config, port, store, socket, report = sys.argv[1:]
    log.set_up("warning")
    limit_arenas()
    asyncio.run(_serve(LaunchOptions(Path(config), port, store, socket), Path(report)))


if __name__ == "__main__":
    main()
