"""Measure the memory of this process and of others, and return freed memory to the kernel.

glibc's allocator is made for speed: each thread has its own arena, and freed blocks are kept for later
(mallopt(3)). The daemon allocates little and runs for months, so that it wants neither.
"""

from __future__ import annotations

import ctypes
import gc
import os
from pathlib import Path

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8  # malloc.h
LARGE_BYTES = 1 << 17
"""Blocks of this size and above are returned to the kernel when freed; glibc's own initial threshold."""


def resident_bytes() -> int:
    """Return the resident set of this process (proc_pid_statm(5)), bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def process_usage(pid: int) -> tuple[float, int]:
    """Return the processor time, s, and the resident set, bytes, of a process (proc_pid_stat(5)).

    Raises OSError or IndexError where it has just ended.
    """
    after_name = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    user, system, pages = (int(after_name[k]) for k in (11, 12, 21))
    return (user + system) / os.sysconf("SC_CLK_TCK"), pages * os.sysconf("SC_PAGE_SIZE")


def limit_arenas() -> None:
    """With glibc: let new threads share one arena, and return large blocks when they are freed."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_ARENA_MAX, 1)
        mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)
        mallopt(M_TRIM_THRESHOLD, LARGE_BYTES)


def exempt_from_collection() -> None:
    """Exempt all objects that are there now from the search for garbage, which looks at every one of them.

    A search among the daemon's modules and settings holds up its loop for 20 to 30 ms, and finds nothing.
    """
    gc.collect()
    gc.freeze()


def release_free_pages() -> None:
    """With glibc: return free pages to the kernel (malloc_trim(3))."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
