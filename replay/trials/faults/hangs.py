"""A daemon whose parts hang: SIGTERM is obeyed whatever does.

Its engine computes without end, or its disk does not answer; beside either, a publisher hangs and nobody
reads the log.
"""

from __future__ import annotations

import asyncio
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from stillcal.replay.trials.faults.endure import RUN, on_trial, write
from stillcal.replay.trials.faults.wire import Figures

HANGING = {
    "the engine": (
        "from stillcal.calib_core.engine.engine import Engine\n"
        "def spin(self, *items):\n"
        "    while True: pass\n"
        "Engine.feed = spin\n"
    ),
    "the disk": "import os, time\nos.fsync = lambda descriptor: time.sleep(1e6)\n",
}
"""What hangs, and what makes it."""

PUBLISHER = (
    "import time\n"
    "from stillcal.daemon.publish.mcap_files import McapFiles\n"
    "McapFiles.take = lambda self, items: time.sleep(1e6)\n"
)
SAMPLES = b"A0,0,0,0,9.8\nG0,0,0,0,0\nA1,10000,0,0,9.8\nG1,10000,0,0,0\n"
SETTLING_S = {"the engine": 1.5, "the disk": 0.5}
"""After which the samples have reached engine and publisher, or the publisher alone, s."""

PIPE_BYTES = 4096


def hangs(folder: Path) -> Iterator[Figures]:
    """Let one of HANGING hang, the publisher and the log beside it, and end the daemon."""
    for what, prelude in HANGING.items():
        own = folder / what.split()[-1]
        own.mkdir()
        yield asyncio.run(_hanging(what, prelude, own))


async def _hanging(what: str, prelude: str, folder: Path) -> Figures:
    unread, full = os.pipe()
    try:
        fcntl.fcntl(full, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        os.write(full, bytes(PIPE_BYTES))
        publish = ["--publish", str(folder / "live.mcap")]
        async with on_trial(folder, prelude + PUBLISHER + RUN, publish, full) as trial:
            await write(trial.line, SAMPLES)
            await asyncio.sleep(SETTLING_S[what])
    finally:
        os.close(unread)
        os.close(full)
    counts = {"states saved": int((folder / "store.state").exists())}
    return trial.figures(f"{what}, a publisher and the log hang", counts, not counts["states saved"])
