"""A daemon that measures its own event loop, for faults to be played on: what faults_socket.py starts.

It is `stillcal run` with one job more, which notes by how much later than asked it is woken.
"""

from __future__ import annotations

import asyncio
import sys
import time
from pathlib import Path

import numpy as np

from stillcal.daemon import log
from stillcal.daemon.notify import Notifier
from stillcal.daemon.service import Service
from stillcal.daemon.service_given import Given

STEP_S = 0.01
KEPT = 100_000
"""Wake-ups noted, more than a quarter of an hour of them."""


async def noting_lateness(into: list[tuple[float, float]]) -> None:
    """Wake every STEP_S and note when (s, CLOCK_MONOTONIC) and by how much too late (s)."""
    while len(into) < KEPT:
        due = time.monotonic() + STEP_S
        await asyncio.sleep(STEP_S)
        now = time.monotonic()
        into.append((now, now - due))


async def _serve(given: Given, told: Path) -> None:
    service = Service(given.settings(), given, Notifier({}))
    service.open()
    noted: list[tuple[float, float]] = []
    noting = asyncio.create_task(noting_lateness(noted))
    await service.run()
    noting.cancel()
    np.save(told, np.array(noted))


def main() -> None:
    """Serve until SIGTERM; arguments: settings, port, store, socket, and where lateness goes (.npy)."""
    config, port, store, socket, told = sys.argv[1:]
    log.set_up("warning")
    asyncio.run(_serve(Given(Path(config), port, store, socket), Path(told)))


if __name__ == "__main__":
    main()
