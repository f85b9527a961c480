"""`stillcal diagnose`: where a recording and its simulated twin differ, and what physics was left out."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from stillcal.calib_core.record import jsonable
from stillcal.calib_core.refusals import NotSupported
from stillcal.daemon.atomic import write_atomically
from stillcal.daemon.cli_lazy import examples
from stillcal.daemon.exits import TOO_LITTLE
from stillcal.daemon.store_document import pretty
from stillcal.replay.diagnosing import diagnosed, diagnosed_rests
from stillcal.replay.trace import read_all

VERDICTS = {
    "adequate": "the twin already explains this recording",
    "explained": "it differs from its twin, and what was left out explains it",
    "partly_explained": "some of what differs from its twin has a name, some has none",
    "unexplained": "it differs from its twin, and nothing in the catalogue explains it",
}


@click.command(
    "diagnose",
    epilog=examples(
        "stillcal diagnose walk.csv",
        "stillcal diagnose walk.csv --json walk.diagnosis.json",
        "stillcal diagnose Phones_accelerometer.csv --format hhar --json -",
    ),
)
@click.argument("trace", type=click.Path(path_type=Path))
@click.option(
    "--json", "json_path", type=click.Path(path_type=Path), help="Write the findings ('-': print them)."
)
@click.option("--format", "format_", default="csv", show_default=True, help="As for stillcal replay.")
@click.option("--gyro", type=click.Path(path_type=Path), help="The gyroscope's own file, for formats of two.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
def diagnose_command(
    trace: Path, json_path: Path | None, format_: str, gyro: Path | None, quiet: bool
) -> None:
    """Say where a recording differs from its simulated twin, and what physics was left out.

    Silence is an answer: most recordings differ in nothing. Exit code 3 where there is too little data.
    """
    waiting = nullcontext() if quiet else Console(stderr=True).status(f"reading and judging {trace.name}")
    try:
        with waiting:
            answer = jsonable(diagnosed(read_all(trace, format_, gyro), trace.name))
    except NotSupported as refusal:
        click.echo(f"stillcal: {trace}: too little data: {refusal}", err=True)
        sys.exit(TOO_LITTLE)
    text = pretty(answer) + "\n"
    if json_path == Path("-"):
        click.echo(text, nl=False)
    elif json_path is not None:
        write_atomically(json_path, text.encode())
    if not quiet and json_path != Path("-"):
        click.echo("\n".join(_lines(answer)))


def _lines(answer: dict[str, Any]) -> Iterator[str]:
    """Tell the findings in a few lines."""
    yield f"{answer['recording']}: {answer['verdict'].replace('_', ' ')} - {VERDICTS[answer['verdict']]}"
    for finding in answer["findings"]:
        where = " ".join([finding["sensor"], *finding["axes"]])
        yield f"  {finding['effect']} ({where}): {finding['statement']}"
        alike = [a["effect"] for a in finding["alternatives"] if a["indistinguishable"]]
        if alike:
            yield f"    this recording cannot tell it from {', '.join(alike)}"
    for limit in answer.get("limits", ()):
        yield f"  not seen: {limit}"
