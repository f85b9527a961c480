"""Run a coroutine so that SIGTERM and SIGHUP end it as Ctrl-C does, with its cleanup."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Coroutine
from typing import Any, TypeVar

T = TypeVar("T")

ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals that end a command; Windows has no SIGHUP."""


def run_until_signalled(job: Coroutine[Any, Any, T]) -> T:
    """Run `job`; SIGINT, SIGTERM and SIGHUP cancel it, unless they are ignored (nohup(1)).

    Raises KeyboardInterrupt where one of them did.
    """
    try:
        return asyncio.run(_listening(job))
    except asyncio.CancelledError:
        raise KeyboardInterrupt from None


async def _listening(job: Coroutine[Any, Any, T]) -> T:
    task = asyncio.current_task()
    assert task is not None
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    return await job
