"""`stillcal evaluate`: the papers' claims beside the results here, as a page with figures."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import click

from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import quiet_option

FROM_A_CHECKOUT = (
    "the studies come with the source, not with the installed package: "
    "clone the repository and run pip install --editable '.[evaluation]' there"
)

NEEDED = {"matplotlib": "matplotlib", "sklearn": "scikit-learn"}


@click.command(
    "evaluate",
    short_help="Test the claims of four papers and write the results.",
    epilog=examples(
        "stillcal evaluate --list",
        "stillcal evaluate --data ~/recordings --jobs 2",
        "stillcal evaluate laboratory --out report",
    ),
)
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--list", "listing", is_flag=True, help="List the studies and stop.")
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
@click.option(
    "--seed", default=0, type=click.IntRange(0), show_default=True, help="Seed of all random draws."
)
@click.option("--jobs", default=1, show_default=True, type=click.IntRange(1), help="Number of processes.")
@quiet_option
def evaluate_command(  # noqa: PLR0917 - click hands every option over by name
    names: tuple[str, ...], listing: bool, out: Path, data: Path | None, seed: int, jobs: int, quiet: bool
) -> None:
    """Run the studies (all, or each NAME) and write the page: claim, paper, ours, data, verdict.

    What each study found is kept beside its figures: one may be run anew, and the page still holds all.
    """
    if importlib.util.find_spec("stillcal.replay.studies") is None:
        raise click.UsageError(FROM_A_CHECKOUT)
    from stillcal.replay.studies import evaluate  # noqa: PLC0415 - not part of the installed package

    if listing:
        click.echo(evaluate.listing())
        return
    chosen = evaluate.chosen(names)
    _require_extra()
    evaluate.run(chosen, out, data, seed, quiet, jobs=jobs)


def _require_extra() -> None:
    """Raise UsageError where what the extra `evaluation` brings is missing; keep libraries to one core."""
    missing = [name for module, name in NEEDED.items() if importlib.util.find_spec(module) is None]
    if missing:
        raise click.UsageError(
            f"{' and '.join(missing)} not installed: pip install '.[evaluation]' in the source folder"
        )
    os.environ.setdefault("MPLBACKEND", "Agg")
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # small fits: more threads wait for each other
