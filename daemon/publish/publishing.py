"""Hand corrected samples to a publisher, in a thread of its own, so that no disk or device delays the daemon.

A publisher that falls behind loses samples, and one that fails is opened again after a while. Both are
logged, and the daemon goes on.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Protocol

from stillcal.daemon.service.live_stream import Live
from stillcal.daemon.service.subscribers import Subscriber
from stillcal.daemon.system.log import say
from stillcal.daemon.system.worker import Worker

RETRY_S = 30.0
"""Pause before a publisher that failed is opened again, s."""


class Publisher(Protocol):
    """Takes live samples. name: for the log. patience_s: how long samples may gather before it gets them."""

    name: str
    patience_s: float

    def open(self) -> None:
        """Open it, or see that it can be. Raises OSError, and SettingsError where it never can."""

    def take(self, items: Sequence[Live]) -> None:
        """Publish samples, opened now where it is not. Where that raises, it is closed."""

    def close(self) -> None:
        """Close it; twice does no harm."""


Subscribe = Callable[[float], AbstractContextManager[Subscriber[Live]]]
"""Subscribes to live samples that may gather for so long, s."""


async def publishing(publisher: Publisher, subscribe: Subscribe) -> None:
    """Publish until cancelled, and once more where closing hangs.

    The publisher is open, or opens itself when samples come.
    """
    worker = Worker("publish")
    try:
        while True:
            try:
                await _handed_on(publisher, subscribe, worker)
                say("warning", "publish", f"{publisher.name} is too slow: samples are left out")
            except Exception as error:  # whatever it meets, the daemon goes on
                reason = getattr(error, "strerror", None) or str(error) or repr(error)
                say("warning", "publish", f"{publisher.name}: {reason}: opened again later")
                await _opened_again(publisher, worker)
    finally:
        with contextlib.closing(worker), contextlib.suppress(Exception):
            await worker.run(publisher.close)


async def _opened_again(publisher: Publisher, worker: Worker) -> None:
    """Close a publisher that failed, and open it as soon as that can be."""
    with contextlib.suppress(Exception):
        await worker.run(publisher.close)
    while True:
        await asyncio.sleep(RETRY_S)
        with contextlib.suppress(Exception):
            await worker.run(publisher.open)
            return


async def _handed_on(publisher: Publisher, subscribe: Subscribe, worker: Worker) -> None:
    """Hand on samples until the subscription ends because the publisher was too slow. Raises OSError."""
    with subscribe(publisher.patience_s) as listener:
        while (item := await listener.queue.get()) is not None:
            items = [item]
            while not listener.queue.empty() and (item := listener.queue.get_nowait()) is not None:
                items.append(item)
            await worker.run(publisher.take, items)
            if item is None:
                return
