"""One thread that does jobs in order and never keeps the process from ending.

concurrent.futures waits for its threads when the interpreter ends, and so for a computation without end or a
disk that does not answer. This thread is a daemon thread: it ends with the process.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any, TypeVar

T = TypeVar("T")


class Worker:
    """A thread called `name`; a job waits for those before it."""

    def __init__(self, name: str) -> None:
        self._jobs: SimpleQueue[tuple[Future[Any], Callable[..., Any], tuple[object, ...]] | None] = (
            SimpleQueue()
        )
        threading.Thread(target=self._work, name=name, daemon=True).start()

    async def run(self, job: Callable[..., T], *arguments: object) -> T:
        """Do a job in the thread and return what it returns, or raise what it raises."""
        future: Future[T] = Future()
        self._jobs.put((future, job, arguments))
        return await asyncio.wrap_future(future)

    def close(self) -> None:
        """Take no more jobs; the thread ends after those at hand."""
        self._jobs.put(None)

    def _work(self) -> None:
        while (item := self._jobs.get()) is not None:
            future, job, arguments = item
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(job(*arguments))
            except BaseException as error:  # belongs to whoever waits for the job
                future.set_exception(error)
            del item, future, job, arguments
