"""Running the studies one after the other, and writing the page: what `stillcal evaluate` does."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import click

from stillcal.daemon.cli.progress import progress
from stillcal.daemon.store.atomic import write_atomically
from stillcal.replay.studies import page
from stillcal.replay.studies import registry as studies
from stillcal.replay.studies.claim import Study


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


def run(names: Sequence[str], out: Path, data: Path | None, seed: int, quiet: bool) -> None:
    """Run studies and write the page and its figures into `out`. data: the folder of real recordings.

    Raises UsageError where what an earlier study left there is damaged.
    """
    folder = out / page.FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    with progress("evaluating", float(len(names)), quiet) as step:
        for done, name in enumerate(names):
            begin = time.monotonic()
            study = studies.run(name, data, folder, seed, _within(step, done))
            write_atomically(page.kept_at(folder, name), page.encoded(study))
            if not quiet:
                click.echo(f"{name}: {len(study.claims)} claims, {time.monotonic() - begin:.0f} s")
    write_atomically(out / page.PAGE, page.page(_kept_studies(folder)).encode())
    if not quiet:
        click.echo(f"{out / page.PAGE}")


def _within(step: Callable[[float], None], done: int) -> Callable[[float], None]:
    return lambda share: step(done + share)


def _kept_studies(folder: Path) -> list[Study]:
    """Read what every study left. Raises UsageError where that is damaged."""
    try:
        return page.kept(folder)
    except page.KeptError as error:
        raise click.UsageError(str(error)) from error
