"""How long a client waits for its answers, and how much of that a busy machine is to blame for.

Linux counts for how long a thread was ready to run and had no processor (schedstat, proc(5)). What is left of
a wait without that is the daemon's own doing, on whatever machine, and is what is judged.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array

LATE_S = 0.05
"""Within which the daemon must wake and answer, s."""


def withheld_s(pid: int | str = "self") -> float:
    """Return for how long a process's first thread was ready and had no processor, s; 0 if nobody counts."""
    with contextlib.suppress(OSError, IndexError):
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / 1e9
    return 0.0


@dataclass(frozen=True, slots=True)
class Waits:
    """The answers to one client. pid: the daemon's; took, own: s, as it was and without the machine's share.

    Client and daemon may wait for a processor at the same time: the longer one's wait is taken off.
    """

    pid: int
    took: list[float] = field(default_factory=list)
    own: list[float] = field(default_factory=list)

    async def time(self, question: Callable[[], Awaitable[object]]) -> None:
        """Note how long a question takes."""
        before, began = self._withheld(), time.monotonic()
        await question()
        took = time.monotonic() - began
        shares = (after - b for after, b in zip(self._withheld(), before, strict=True))
        self.took.append(took)
        self.own.append(max(took - max(shares), 0.0))

    async def repeat(self, question: Callable[[], Awaitable[object]], pause_s: float) -> None:
        """Ask on and on, until cancelled."""
        while True:
            await self.time(question)
            await asyncio.sleep(pause_s)

    def _withheld(self) -> tuple[float, float]:
        return withheld_s(), withheld_s(self.pid)


def slowest(took: Sequence[float] | Array, own: Sequence[float] | Array) -> dict[str, int]:
    """Return the 99 % point and the largest of some times (s), and of their own shares, in us.

    Raises IndexError where there are none.
    """
    counts: dict[str, int] = {}
    for name, values in (("", took), (" own", own)):
        p99, most = np.quantile(np.asarray(values), (0.99, 1.0))
        counts |= {f"p99{name}, us": round(1e6 * p99), f"slowest{name}, us": round(1e6 * most)}
    return counts
