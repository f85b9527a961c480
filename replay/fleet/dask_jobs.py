"""Distributing recordings to Dask's workers: local processes, or those of a scheduler elsewhere.

A bounded number is under way at a time, so a fleet's length costs neither the scheduler nor this process
memory. A worker that dies costs the recordings it had in hand some time: they go to another.
"""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from typing import Any

import dask
from distributed import Client, Future, LocalCluster, as_completed

from stillcal.replay.fleet.worker import LOST, Examined, Task, examine, identity

AHEAD = 4
"""Recordings handed out per worker thread: enough that none waits, few enough that little is lost."""

_CONNECT_S = 10
"""How long a scheduler has to answer, s."""

_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}

Keep = Callable[[Task, Examined], None]


class SchedulerError(ValueError):
    """No scheduler, or none any more, at the address given."""


def cores() -> int:
    """Return how many processors this process may use; all there are, where the system does not say."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def local(workers: int | None = None) -> Iterator[Client]:
    """Give a client of worker processes on this machine, one a core unless told otherwise.

    They disregard Ctrl-C, which a terminal sends to all processes: this one decides what becomes of them.
    """
    os.environ.update({k: os.environ.get(k, v) for k, v in _ONE_THREAD.items()})
    with dask.config.set({"distributed.nanny.pre-spawn-environ": _ONE_THREAD}):
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            cluster = LocalCluster(
                n_workers=workers or cores(),
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
        finally:
            signal.signal(signal.SIGINT, before)
        with cluster, Client(cluster) as client:
            yield client


@contextmanager
def remote(address: str, timeout: float = _CONNECT_S) -> Iterator[Client]:
    """Give a client of the scheduler at `address`. Raises SchedulerError where none answers."""
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=timeout)
    except (OSError, ValueError) as error:
        raise SchedulerError(
            f"{address}: no scheduler answers ({error}); start one with: dask scheduler"
        ) from error
    with client:
        yield client


GONE = ("lost", "pending")
"""States of what was finished and went with its worker before it was fetched: it is computed again."""


def run(client: Client, tasks: Sequence[Task], keep: Keep) -> None:
    """Have every task examined; `keep` is handed each outcome as it comes.

    A recording that three workers died with (the scheduler's allowed-failures) is given up, and its row
    says so. Raises SchedulerError where the scheduler is lost; what was kept stays kept.
    """
    waiting, under_way = iter(tasks), dict[object, tuple[Task, Future[Examined]]]()
    room = max(AHEAD * sum(client.nthreads().values()), 2 * AHEAD)

    def submitted(most: int) -> Iterator[Future[Examined]]:
        for task in islice(waiting, most):
            future = client.submit(examine, task, pure=False)
            under_way[future.key] = task, future
            yield future

    try:
        queue = as_completed(list(submitted(room)), raise_errors=False)
        for future in queue:
            if future.status in GONE:
                queue.add(future)
                continue
            task, _ = under_way.pop(future.key)
            keep(task, _outcome(task, future))
            queue.update(list(submitted(1)))
    except BaseException:
        client.cancel([future for _, future in under_way.values()], force=True)
        raise


def _outcome(task: Task, future: Any) -> Examined:
    if future.status == "finished":
        outcome: Examined = future.result()
        return outcome
    if future.status == "cancelled":
        raise SchedulerError(
            "the connection to the scheduler is lost; start it again and repeat the command to continue"
        )
    error = future.exception()
    return Examined({**identity(task), "status": LOST, "reason": f"{type(error).__name__}: {error}"})
