"""`stillcal evaluate`: what the papers claim, beside what comes out here, as a page with figures."""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Callable
from pathlib import Path

import click

from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import quiet_option
from stillcal.daemon.cli.progress import progress
from stillcal.daemon.store.atomic import write_atomically
from stillcal.replay.studies import page
from stillcal.replay.studies import registry as studies
from stillcal.replay.studies.claim import Study

NEEDED = {"matplotlib": "matplotlib", "sklearn": "scikit-learn"}


@click.command(
    "evaluate",
    short_help="Try four papers' claims and write the page.",
    epilog=examples(
        "stillcal evaluate --list",
        "stillcal evaluate --data ~/recordings",
        "stillcal evaluate laboratory --out report",
    ),
)
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--list", "listing", is_flag=True, help="Name the studies and stop.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("docs"),
    show_default=True,
    help="Where evaluation.md and the folder of figures go.",
)
@click.option(
    "--data",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    envvar="STILLCAL_DATA",
    help="The folder of real recordings (default: STILLCAL_DATA); without it some claims cannot be tested.",
)
@click.option("--seed", default=0, type=click.IntRange(0), show_default=True, help="For all that is drawn.")
@quiet_option
def evaluate_command(  # noqa: PLR0917 - click hands every option over by name
    names: tuple[str, ...], listing: bool, out: Path, data: Path | None, seed: int, quiet: bool
) -> None:
    """Run the studies (all, or each NAME) and write the page: claim, paper, ours, data, verdict.

    What each study found is kept beside its figures: one may be run anew, and the page still holds all.
    """
    if listing:
        width = max(map(len, studies.STUDIES))
        click.echo("\n".join(f"{name:{width}}  {studies.title(name)}" for name in studies.STUDIES))
        return
    chosen = _chosen(names)
    _require_extra()
    folder = out / page.FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    with progress("evaluating", float(len(chosen)), quiet) as step:
        for done, name in enumerate(chosen):
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


def _chosen(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the studies to run. Raises UsageError for a name that is none."""
    for name in names:
        if name not in studies.STUDIES:
            raise click.UsageError(studies.UNKNOWN.format(name=name, known=", ".join(studies.STUDIES)))
    return names or tuple(studies.STUDIES)


def _require_extra() -> None:
    """Raise UsageError where what the extra `evaluation` brings is missing; keep libraries to one core."""
    missing = [name for module, name in NEEDED.items() if importlib.util.find_spec(module) is None]
    if missing:
        raise click.UsageError(
            f"{' and '.join(missing)} not installed: pip install 'stillcal[evaluation]' has what this needs"
        )
    os.environ.setdefault("MPLBACKEND", "Agg")
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # small fits: more threads wait for each other
