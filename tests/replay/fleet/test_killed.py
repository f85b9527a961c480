"""A real scheduler and workers as processes of their own; one is killed half-way and nothing is lost."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from stillcal.replay.fleet import dask_jobs, discovery, results_folder
from stillcal.replay.fleet.worker import CALIBRATED, Examined, Task, examine

COPIES = 24


@contextmanager
def process(*arguments: str, until: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run `dask ...` and give it with the line it says when it is ready."""
    command = [sys.executable, "-m", "dask", *arguments]
    env = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    running_ = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=env)
    assert running_.stderr is not None
    try:
        line = next(line for line in running_.stderr if re.search(until, line))
        yield running_, line
    finally:
        running_.kill()
        running_.communicate()


@contextmanager
def cluster(workers: int) -> Iterator[tuple[str, list[subprocess.Popen[str]]]]:
    with process(
        "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", until="Scheduler at"
    ) as (_, line):
        address = re.search(r"tcp://[\d.:]+", line)
        assert address is not None
        started, opened = [], []
        try:
            for _ in range(workers):
                worker = process(
                    "worker",
                    address[0],
                    "--nthreads",
                    "1",
                    "--no-nanny",
                    "--no-dashboard",
                    until="Registered to",
                )
                started.append(worker.__enter__()[0])
                opened.append(worker)
            yield address[0], started
        finally:
            for worker in opened:
                worker.__exit__(None, None, None)


@pytest.fixture
def many(phones: Path, tmp_path: Path) -> list[Task]:
    """Many recordings of few phones."""
    one = sorted(p.parent for p in phones.rglob("recording.csv") if "Spoilt" not in str(p))
    for i in range(COPIES):
        shutil.copytree(one[i % len(one)], tmp_path / "fleet" / f"model-{i % 3}" / f"phone-{i:03d}")
    return [Task(found, diagnose=False) for found in discovery.find(str(tmp_path / "fleet")).recordings]


@pytest.mark.slow
def test_nothing_is_lost_with_a_worker(many: list[Task], tmp_path: Path) -> None:
    results = results_folder.Results(tmp_path / "results", "this test")
    killed: list[int] = []
    with cluster(2) as (address, workers), dask_jobs.remote(address) as client:

        def keep(task: Task, outcome: Examined) -> None:
            results.keep(task, outcome)
            if not killed and len(results._fresh) == COPIES // 4:
                workers[0].send_signal(signal.SIGKILL)
                killed.append(workers[0].wait())

        dask_jobs.run(client, many, keep)
        left = len(client.scheduler_info()["workers"])
    rows, _ = results.finish()
    assert killed == [-signal.SIGKILL] and left == 1
    assert [row["name"] for row in rows] == [task.recording.name for task in many]
    assert {(row["status"], row["reason"]) for row in rows} == {(CALIBRATED, None)}
    ours = examine(many[-1]).row
    assert all(rows[-1][k] == ours[k] for k in ours if k not in ("calibrate_s", "missing"))


def test_no_scheduler_is_one_line(many: list[Task]) -> None:
    with (
        pytest.raises(dask_jobs.SchedulerError, match="no scheduler answers"),
        dask_jobs.remote("tcp://127.0.0.1:9", timeout=1),
    ):
        pass
