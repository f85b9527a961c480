"""`stillcal diagnose`: where a recording differs from a simulation, and why."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import click
from rich.console import Console

from stillcal.calib_core.codec import jsonable
from stillcal.calib_core.errors import NotSupported
from stillcal.daemon.cli.exits import TOO_LITTLE
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import format_option, gyro_option, quiet_option
from stillcal.daemon.store.atomic import write_atomically
from stillcal.daemon.store.document import pretty
from stillcal.replay.commands.outputs import STANDARD_OUTPUT, files, recording_files, refuse_collisions
from stillcal.replay.diagnosis.diagnose import (
    answer_of,
    bins_of,
    claims_of,
    diagnose_rests,
    diagnosis_of,
    facts,
)
from stillcal.replay.diagnosis.judge_phone import PhoneJudgement, judge_phone
from stillcal.replay.diagnosis.report.comparison import compare, side_of
from stillcal.replay.diagnosis.report.inputs import Case, case_of, resimulate_before_and_after
from stillcal.replay.diagnosis.report.page import page
from stillcal.replay.diagnosis.report.phone_file import phone_text
from stillcal.replay.diagnosis.report.summary import summary
from stillcal.replay.formats.trace import read_all, read_rest_table
from stillcal.replay.phone.phone import load_phone

_path = click.Path(path_type=Path)


@click.command(
    "diagnose",
    short_help="Say what physics a recording shows beyond its twin.",
    epilog=examples(
        "stillcal diagnose walk.csv",
        "stillcal diagnose walk.csv --report walk.html --json walk.diagnosis.json",
        "stillcal diagnose walk.csv --phone-out better.toml",
        "stillcal simulate day --phone better.toml --out day.csv",
        "stillcal diagnose walk.csv --phone mpu6050        # what does this simulation leave out?",
        "stillcal diagnose walk.csv --simulated day.csv    # two recordings side by side",
        "stillcal diagnose Phones_accelerometer.csv --format hhar --json -",
        "stillcal diagnose esgi.csv --format rest",
    ),
)
@click.argument("trace", type=_path)
@click.option("--phone", help="The simulation to be judged: a ready phone, or a phone.toml.")
@click.option("--simulated", type=_path, help="A simulated recording to be compared with TRACE.")
@click.option("--json", "json_path", type=_path, help="Write the findings ('-': print them).")
@click.option("--report", type=_path, help="Write a page to be read in a browser (.html).")
@click.option(
    "--phone-out", type=_path, help="Write the better phone (.toml), for stillcal simulate --phone."
)
@format_option(rests=True)
@gyro_option
@quiet_option
def diagnose_command(  # noqa: PLR0917 - click hands every option over by name
    trace: Path,
    phone: str | None,
    simulated: Path | None,
    json_path: Path | None,
    report: Path | None,
    phone_out: Path | None,
    format_: str,
    gyro: Path | None,
    quiet: bool,
) -> None:
    """Say where a recording differs from its simulated twin, and what physics was left out.

    Silence is an answer: most recordings differ in nothing. What could not be checked is said. Exit code 3
    where there is too little data.
    """
    request = Request(phone, simulated, report, phone_out)
    _check(request, trace, gyro, json_path, format_)
    try:
        with _stages(quiet) as show_stage:
            answer = (
                diagnose_table(trace)
                if format_ == "rest"
                else diagnose_trace(trace, format_, gyro, request, show_stage)
            )
    except NotSupported as refusal:
        click.echo(f"stillcal: {trace}: too little data: {refusal}", err=True)
        sys.exit(TOO_LITTLE)
    _write(answer, request, json_path)
    if not quiet and json_path != STANDARD_OUTPUT:
        click.echo("\n".join(summary(answer.answer)))


def _check(request: Request, trace: Path, gyro: Path | None, json_path: Path | None, format_: str) -> None:
    """Refuse early what would fail late. Raises UsageError."""
    if request.report is not None and request.report.suffix not in (".html", ".htm"):
        raise click.UsageError(f"{request.report} is no name of a page: let it end in .html")
    if request.phone_out is not None and request.phone_out.suffix != ".toml":
        raise click.UsageError(f"{request.phone_out} is no name of a phone file: let it end in .toml")
    if format_ == "rest" and any(x is not None for x in request):
        raise click.UsageError(
            "a rest table holds no samples: --phone, --simulated, --report and --phone-out need them"
        )
    reads = [*recording_files(trace), *files(gyro)]
    reads += [] if request.simulated is None else recording_files(request.simulated)
    reads += [Path(request.phone)] if request.phone and request.phone.endswith(".toml") else []
    refuse_collisions(files(request.report, request.phone_out, json_path), reads)


@contextmanager
def _stages(quiet: bool) -> Iterator[Callable[[str], None]]:
    """Give a function that says on standard error what is being done."""
    if quiet:
        yield lambda stage: None
        return
    with Console(stderr=True).status("reading") as status:
        yield status.update


def _write(answer: Answer, request: Request, json_path: Path | None) -> None:
    """Write what was asked for, each file whole or not at all."""
    if request.report is not None and answer.page is not None:
        write_atomically(request.report, answer.page.encode())
    if request.phone_out is not None and answer.phone is not None:
        write_atomically(request.phone_out, answer.phone.encode())
    text = pretty(jsonable(answer.answer)) + "\n"
    if json_path == STANDARD_OUTPUT:
        click.echo(text, nl=False)
    elif json_path is not None:
        write_atomically(json_path, text.encode())


class Request(NamedTuple):
    """What was asked for beside the findings; None for not."""

    phone: str | None
    simulated: Path | None
    report: Path | None
    phone_out: Path | None


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer as plain values, and the files' text where they were asked for."""

    answer: dict[str, Any]
    page: str | None = None
    phone: str | None = None


def diagnose_table(table: Path) -> Answer:
    """Diagnose a table of rests. Raises TraceError, NotSupported."""
    return Answer(diagnose_rests(read_rest_table(table), table.name))


def diagnose_trace(
    trace: Path, format_: str, gyro: Path | None, request: Request, show_stage: Callable[[str], None]
) -> Answer:
    """Diagnose a recording and make what is wanted of it. Raises TraceError, NotSupported, UsageError."""
    show_stage(f"reading {trace.name}")
    recording = read_all(trace, format_, gyro)
    show_stage("judging: stamps, noise, bias, motion")
    if request.phone is None:
        judgement = PhoneJudgement(diagnosis_of(recording, trace.name))
    else:
        judgement = judge_phone(recording, trace.name, _loaded(request.phone))
    show_stage("mapping where it departs")
    case = case_of(recording, judgement.diagnosis, judgement.known())
    answer = answer_of(judgement.diagnosis, facts(recording, case.bins))
    answer |= {"map": case.departure_map.plain(), **judgement.plain()}
    if request.phone is not None:
        answer["judged_phone"] = request.phone
    if request.simulated is not None:
        show_stage(f"comparing with {request.simulated.name}")
        answer["comparison"] = _compared(case, request.simulated)
    resimulated = None
    if request.report is not None and len(case.bins):
        resimulated = resimulate_before_and_after(case, show_stage)
        answer |= {
            "comparison_before": resimulated[0].comparison.plain(),
            "comparison_after": resimulated[1].comparison.plain(),
        }
    show_stage("drawing" if request.report is not None else "writing")
    phone = None if request.phone_out is None else phone_text(case.phone(), case.mapped, trace.name)
    return Answer(answer, None if request.report is None else page(case, answer, resimulated), phone)


def _loaded(name: str) -> Any:
    try:
        return load_phone(name)
    except ValueError as error:
        raise click.UsageError(str(error)) from error


def _compared(case: Case, simulated: Path) -> dict[str, Any]:
    other = read_all(simulated)
    gravity = claims_of(other).gravity
    return compare(case.side(), side_of(other, bins_of(other), gravity)).plain()
