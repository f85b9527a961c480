"""The host's clocks. Whoever needs the time is given one of them, so that a test can give it another."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

Clock = Callable[[], float]
"""Returns a time in s; only differences mean anything."""


BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
"""Changes at each boot, when CLOCK_BOOTTIME starts at zero again."""


def host_time() -> float:
    """Return the time since boot, s; it goes on while the host is suspended (CLOCK_BOOTTIME, time(7))."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)
