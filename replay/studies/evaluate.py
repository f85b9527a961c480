"""Running the studies one after the other, and writing the page: what `stillcal evaluate` does."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

import click

from stillcal.daemon.cli.progress import progress
from stillcal.daemon.store.atomic import write_atomically
from stillcal.replay.studies import page
from stillcal.replay.studies import registry as studies
from stillcal.replay.studies.claim import Progress, Study


def listing() -> str:
    """Return the studies' names and titles, a line each."""
    width = max(map(len, studies.STUDIES))
    return "\n".join(f"{name:{width}}  {studies.title(name)}" for name in studies.STUDIES)


def chosen(names: Sequence[str]) -> tuple[str, ...]:
    """Return the studies to run: those named, or all. Raises UsageError for a name that is none."""
    for name in names:
        if name not in studies.STUDIES:
            raise click.UsageError(studies.UNKNOWN.format(name=name, known=", ".join(studies.STUDIES)))
    return tuple(names) or tuple(studies.STUDIES)


FOLDERS = ("hhar", "hhar_still", "imu_tk", "mikoff", "sunsided", "ucihar")
"""Folders of real recordings that studies read."""

REMEDY = (
    "docs/data.md lists the recordings and where they come from; without --data (and STILLCAL_DATA) the"
    " claims that need them are not tested"
)


@contextmanager
def _recordings(data: Path | None) -> Iterator[None]:
    """Say what to do where the folder of recordings holds none, or not one that a study reads."""
    if data is not None and not any((data / name).is_dir() for name in FOLDERS):
        raise click.UsageError(f"--data {data}: none of {', '.join(FOLDERS)} is there; {REMEDY}")
    try:
        yield
    except FileNotFoundError as error:
        if data is None or not str(error.filename).startswith(str(data)):
            raise
        raise click.UsageError(f"{error.filename} is missing; {REMEDY}") from error


def run(names: Sequence[str], out: Path, data: Path | None, seed: int, quiet: bool, *, jobs: int = 1) -> None:
    """Run studies and write the page and its figures into `out`. data: the folder of real recordings.

    jobs: number of processes; a study is run by one of them. Raises UsageError where a recording is missing,
    or what an earlier study left there is damaged.
    """
    folder = out / page.FOLDER
    begin, used = time.monotonic(), 0.0
    with _recordings(data), progress("evaluating", float(len(names)), quiet) as step:
        folder.mkdir(parents=True, exist_ok=True)
        results = (
            _each(names, data, folder, seed, step) if jobs == 1 else _pooled(names, data, folder, seed, jobs)
        )
        for done, (study, wall, processor) in enumerate(results):
            write_atomically(page.kept_at(folder, study.name), page.encoded(study))
            used += processor
            step(done + 1.0)
            if not quiet:
                click.echo(
                    f"{study.name}: {len(study.claims)} claims, {wall:.0f} s ({processor:.0f} s of processor)"
                )
    write_atomically(out / page.PAGE, page.page(_kept_studies(folder)).encode())
    if not quiet:
        wall = time.monotonic() - begin
        click.echo(f"{out / page.PAGE}: {wall / 60.0:.1f} min, {used / 60.0:.1f} min of processor")


Timed = tuple[Study, float, float]
"""A study with the seconds that it took, by the clock and of processor."""


def _timed(
    name: str, data: Path | None, folder: Path, seed: int, tell: Progress = lambda share: None
) -> Timed:
    begin, used = time.monotonic(), time.process_time()
    study = studies.run(name, data, folder, seed, tell)
    return study, time.monotonic() - begin, time.process_time() - used


def _each(
    names: Sequence[str], data: Path | None, folder: Path, seed: int, step: Callable[[float], None]
) -> Iterator[Timed]:
    for done, name in enumerate(names):
        yield _timed(name, data, folder, seed, _within(step, done))


def _pooled(names: Sequence[str], data: Path | None, folder: Path, seed: int, jobs: int) -> Iterator[Timed]:
    """Yield studies as they are done, each run in a process of its own."""
    context = get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, max_tasks_per_child=1) as pool:
        runs = [pool.submit(_timed, name, data, folder, seed) for name in names]
        yield from (run.result() for run in as_completed(runs))


def _within(step: Callable[[float], None], done: int) -> Callable[[float], None]:
    return lambda share: step(done + share)


def _kept_studies(folder: Path) -> list[Study]:
    """Read what every study left. Raises UsageError where that is damaged."""
    try:
        return page.kept(folder)
    except page.KeptError as error:
        raise click.UsageError(str(error)) from error
