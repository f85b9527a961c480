"""How much memory this process has in use, and giving back what it has not.

glibc's allocator is made for speed: each thread has an arena of its own, and once large blocks were freed it
keeps such sizes for itself (mallopt(3)). The daemon has little to allocate and months to keep it.
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8  # malloc.h
LARGE_BYTES = 1 << 17
"""Blocks of this size on are the kernel's as soon as they are freed; glibc's own first choice."""


def resident_bytes() -> int:
    """Return the resident set of this process (proc_pid_statm(5)), bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def limit_arenas() -> None:
    """Have threads to come share one arena, and large blocks given back, where the allocator is glibc's."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_ARENA_MAX, 1)
        mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)
        mallopt(M_TRIM_THRESHOLD, LARGE_BYTES)


def release_free_pages() -> None:
    """Give pages that hold nothing any more back to the kernel (malloc_trim(3)), where that is known."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
