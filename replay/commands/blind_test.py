"""`stillcal challenge …` and `stillcal prove`: the blind test of the diagnosis."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from stillcal.calib_core.codec import plain
from stillcal.daemon.cli.exits import BAD_INPUT, NOT_MET
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.store.document import pretty
from stillcal.replay.blind_test import answer as answering
from stillcal.replay.blind_test import reveal as revealing
from stillcal.replay.blind_test import run as proof
from stillcal.replay.blind_test.keys import SealError
from stillcal.replay.blind_test.make import ChallengeError, commit, make, read_manifest
from stillcal.replay.blind_test.score_lines import Line
from stillcal.replay.blind_test.scores import Score
from stillcal.replay.commands.outputs import write_output

_folder = click.Path(path_type=Path)
_trials = click.option(
    "--trials", default=1000, show_default=True, type=click.IntRange(1), help="Number of recordings."
)
_seed = click.option(
    "--seed", default=1, show_default=True, type=click.IntRange(0), help="Seed of all random draws."
)
_jobs = click.option(
    "--jobs", default=1, show_default=True, type=click.IntRange(1), help="Number of processes."
)
STAGES = {"recordings": None, "simulations": "simulated", "phone-files": "phone_file"}
"""Stages of the proof, with the kind of case that each has beside the trials."""

_stages = click.option(
    "--stage",
    "stages",
    type=click.Choice(list(STAGES)),
    multiple=True,
    help="Only this stage; may be given several times. Simulations are 30, phone files 4 for 100 trials.",
)
_reserve = click.option(
    "--reserve", is_flag=True, help="Also draw the effects in reserve, 12 for 100 trials; scored apart."
)
_json = click.option(
    "--json", "json_path", type=_folder, help="Write all scores there ('-': standard output)."
)


@click.group("challenge", short_help="Test the diagnosis on recordings with hidden effects.")
def challenge_group() -> None:
    """Test the diagnosis blind: make recordings with hidden effects, diagnose them, reveal and score.

    See docs/proof.md, also for a test with recordings of your own.
    """


@challenge_group.command(
    "make",
    short_help="Write recordings with hidden effects, and sealed keys.",
    epilog=examples("stillcal challenge make blind --keys sealed --trials 200"),
)
@click.argument("recordings", type=_folder)
@click.option("--keys", type=_folder, required=True, help="Folder for the sealed keys; do not publish it.")
@_trials
@_seed
@_jobs
@_reserve
@_stages
def make_command(  # noqa: PLR0917 - click hands every option over by name
    recordings: Path,
    keys: Path,
    trials: int,
    seed: int,
    jobs: int,
    reserve: bool,
    stages: tuple[str, ...],
) -> None:
    """Write recordings with hidden effects and the manifest of seals into RECORDINGS, the keys elsewhere."""
    with _refusals(), _progress() as tick:
        manifest = make(
            recordings,
            keys,
            trials,
            seed,
            jobs=jobs,
            beside=_beside(stages, reserve),
            trials_too=_asked(stages, "recordings"),
            tick=lambda done, of: tick("making", done, of),
        )
    click.echo(f"{recordings}: {len(manifest.seals)} recordings and their manifest; keys in {keys}")


@challenge_group.command(
    "commit",
    short_help="Seal your own keys.",
    epilog=examples("stillcal challenge commit mine --keys my-keys"),
)
@click.argument("recordings", type=_folder)
@click.option("--keys", type=_folder, required=True, help="Folder of your keys, NAME.json each.")
def commit_command(recordings: Path, keys: Path) -> None:
    """Seal your own keys and write the manifest of their seals into RECORDINGS."""
    with _refusals():
        manifest = commit(recordings, keys)
    click.echo(f"{recordings}: manifest of {len(manifest.seals)} seals; sealed keys in {keys}")


@challenge_group.command(
    "answer",
    short_help="Diagnose the recordings without the keys.",
    epilog=examples("stillcal challenge answer blind --out answers"),
)
@click.argument("recordings", type=_folder)
@click.option("--out", type=_folder, required=True, help="Folder for the answers, NAME.json each.")
@click.option("--solver", type=click.Choice(answering.SOLVERS), default="diagnosis", show_default=True)
@_jobs
def answer_command(recordings: Path, out: Path, solver: str, jobs: int) -> None:
    """Diagnose all of RECORDINGS in processes that can read this folder only."""
    with _refusals(), _progress() as tick:
        names = answering.answerable(recordings, read_manifest(recordings).seals, solver)
        answering.answer_all(
            recordings, out, names, solver, jobs=jobs, tick=lambda n: tick(solver, n, len(names))
        )
    click.echo(f"{out}: {len(names)} answers")


@challenge_group.command(
    "reveal",
    short_help="Check the seals, open the keys, score the answers.",
    epilog=examples("stillcal challenge reveal blind --keys sealed --answers answers"),
)
@click.argument("recordings", type=_folder)
@click.option("--keys", type=_folder, required=True, help="Folder of the keys.")
@click.option(
    "--answers",
    type=_folder,
    required=True,
    multiple=True,
    help="Folder of answers; the first one is judged.",
)
@_json
def reveal_command(recordings: Path, keys: Path, answers: tuple[Path, ...], json_path: Path | None) -> None:
    """Check the seals, open the keys, score the answers. Exit code 1: a required score is missed."""
    with _refusals():
        opened = revealing.open_keys(read_manifest(recordings), keys)
        verdict = proof.judged(opened, {folder.name: folder for folder in answers})
    _show_verdict(verdict, json_path)


@click.command(
    "prove",
    short_help="Run the whole blind test of the diagnosis and score it.",
    epilog=examples("stillcal prove --trials 200 --seed 7 --json proof.json --jobs 2"),
)
@_trials
@_seed
@_jobs
@_json
@click.option("--keep", type=_folder, help="Keep recordings, keys and answers in this new folder.")
@_reserve
@_stages
def prove_command(  # noqa: PLR0917 - click hands every option over by name
    trials: int,
    seed: int,
    jobs: int,
    json_path: Path | None,
    keep: Path | None,
    reserve: bool,
    stages: tuple[str, ...],
) -> None:
    """Run the whole blind test: hide effects, seal the keys, diagnose, reveal, score.

    Exit code 0: every required score is reached; 1: one is missed. Takes about 6 s a recording and process,
    and 3 MB of disk a recording.
    """
    with _refusals(), _working_folder(keep) as folder, _progress() as tick:
        verdict = proof.prove(
            folder,
            trials,
            seed,
            jobs=jobs,
            beside=_beside(stages, reserve),
            trials_too=_asked(stages, "recordings"),
            tick=tick,
        )
    _show_verdict(verdict, json_path)


def _beside(stages: tuple[str, ...], reserve: bool) -> list[str]:
    """Return the kinds of case that are made beside the trials. stages: those asked for, none for all."""
    return ["reserve"] * reserve + [kind for stage, kind in STAGES.items() if kind and _asked(stages, stage)]


def _asked(stages: tuple[str, ...], stage: str) -> bool:
    return not stages or stage in stages


@contextmanager
def _working_folder(keep: Path | None) -> Iterator[Path]:
    if keep is not None:
        yield keep
        return
    with tempfile.TemporaryDirectory(prefix="stillcal-proof-") as folder:
        yield Path(folder)


@contextmanager
def _refusals() -> Iterator[None]:
    """Turn expected errors into one line and an exit code."""
    try:
        yield
    except (ChallengeError, SealError, answering.AnswerError, OSError) as error:
        click.echo(f"stillcal: {error}", err=True)
        sys.exit(BAD_INPUT)


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show one bar a stage of the work on a terminal; elsewhere a line for each tenth of a stage."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines()
        return
    columns = (TextColumn("{task.description:20}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bars:
        tasks = {}

        def tick(stage: str, done: int, of: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=of)
            bars.update(tasks[stage], completed=done)

        yield tick


def _lines() -> Callable[[str, int, int], None]:
    tenths: dict[str, int] = {}

    def tick(stage: str, done: int, of: int) -> None:
        tenth = 10 * done // max(of, 1)
        if tenth > tenths.get(stage, 0):
            tenths[stage] = tenth
            click.echo(f"{stage}: {done} of {of}", err=True)

    return tick


def _show_verdict(verdict: proof.Verdict, json_path: Path | None) -> None:
    """Print the table, write the JSON, and leave with the exit code."""
    console = Console(stderr=json_path == Path("-"), width=None if sys.stdout.isatty() else 150)
    console.print(_table(verdict.scores))
    if verdict.comparison:
        console.print(_comparison(verdict.comparison))
        console.print(_confusion(verdict.scores[0]))
    console.print(
        "All required scores are reached." if verdict.holds else "Not all required scores are reached."
    )
    text = pretty({"schema": 1, **plain(verdict)}) + "\n"
    if json_path is not None:
        write_output(json_path, text.encode())
    sys.exit(0 if verdict.holds else NOT_MET)


def _table(scores: list[Score]) -> Table:
    """Return all scores, one column a solver; the requirements are for the first one."""
    table = Table(title="Scores with 95 % bounds")
    table.add_column("score")
    for score in scores:
        table.add_column(score.solver, justify="right")
    table.add_column("n", justify="right")
    table.add_column("required")
    table.add_column("reached")
    others = [{line.what: line for line in score.lines} for score in scores[1:]]
    for line in scores[0].lines:
        cells = [_cell(line), *(_cell(lines.get(line.what)) for lines in others)]
        table.add_row(line.what, *cells, str(line.n), line.bar, _holds(line))
    return table


def _cell(line: Line | None) -> str:
    if line is None or line.value is None or line.low is None or line.high is None:
        return "-" if line is None or line.value is None else f"{line.value:.2f}"
    if line.what.endswith(", s") or line.what.startswith("d'"):
        return f"{line.value:.1f} ({line.low:.1f} to {line.high:.1f})"
    return f"{line.value:.1%} ({line.low:.1%} to {line.high:.1%})"


def _holds(line: Line) -> str:
    if line.holds is None:
        return ""
    return "yes" if line.holds else ("NO" if line.value is not None else "NO (not tried)")


def _comparison(lines: list[Line]) -> Table:
    table = Table(title="Against the baselines")
    for heading in ("score", "share", "n", "required", "reached"):
        table.add_column(heading)
    for line in lines:
        table.add_row(line.what, _cell(line), str(line.n), line.bar, _holds(line))
    return table


def _confusion(score: Score) -> Table:
    table = Table(title="Names given to clear effects (d' >= 8)")
    table.add_column("true effect")
    table.add_column("names given, and how often")
    for effect, answers in score.confusion.items():
        table.add_row(
            effect, ", ".join(f"{name} {n}" for name, n in sorted(answers.items(), key=lambda i: -i[1]))
        )
    return table
