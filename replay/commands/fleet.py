"""`stillcal fleet`, `fleet-report` and `fleet-first`: many recordings at once, and a fleet's prior."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console
from rich.table import Table

from stillcal._version import __version__
from stillcal.daemon.cli.exits import TOO_LITTLE
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import format_option, quiet_option
from stillcal.daemon.cli.progress import progress
from stillcal.daemon.store.atomic import write_atomically
from stillcal.daemon.store.document import pretty
from stillcal.replay.commands.outputs import files, recording_files, refuse_collisions
from stillcal.replay.formats.writer import STANDARD_OUTPUT

if TYPE_CHECKING:
    from distributed import Client

    from stillcal.replay.fleet.report import Report
    from stillcal.replay.fleet.worker import Task

_BAD, _NAMED = ("error", "lost"), 3
"""Statuses of recordings that could not be used, and how many such recordings are named."""

_LACKING = "this needs the extra `fleet`: pip install '.[fleet]' ({})"


@click.command(
    "fleet",
    short_help="Calibrate and diagnose many recordings in parallel.",
    epilog=examples(
        "stillcal fleet recordings/ --out results",
        "stillcal fleet 'logs/**/*_accelerometer.csv' --format hhar --out results",
        "stillcal fleet recordings/ --out results --scheduler tcp://10.0.0.1:8786",
        "stillcal fleet-report results",
    ),
)
@click.argument("recordings")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder of results."
)
@click.option("--scheduler", help="Address of a Dask scheduler; its workers read the same paths.")
@click.option("--workers", type=click.IntRange(1), help="Number of local processes [default: one per core].")
@format_option("RECORDINGS", rests=True)
@click.option(
    "--watch",
    type=click.Choice(["auto", "continuous", "probing"]),
    default="continuous",
    show_default=True,
    help="When the sensors are on; a recording costs no energy.",
)
@click.option("--no-diagnosis", is_flag=True, help="Calibrate only.")
@quiet_option
def fleet_command(  # noqa: PLR0917 - click hands every option over by name
    recordings: str,
    out: Path,
    scheduler: str | None,
    workers: int | None,
    format_: str,
    watch: str,
    no_diagnosis: bool,
    quiet: bool,
) -> None:
    """Calibrate and diagnose all RECORDINGS, a folder or a pattern in quotes, in parallel.

    Writes recordings.parquet (one row per recording: device, parameters with standard deviations, verdict)
    and findings.parquet into the folder of results. Called again, it continues with recordings that are new
    or have changed. A recording that cannot be used becomes a row with the reason; the exit code is 0 all the
    same.
    """
    try:
        from stillcal.replay.fleet import discovery, results_folder  # noqa: PLC0415 - an extra
        from stillcal.replay.fleet.worker import Task  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise click.UsageError(_LACKING.format(error)) from error
    try:
        recordings_found = discovery.find(recordings, format_)
    except discovery.NoRecordingsError as error:
        raise click.UsageError(str(error)) from error
    made_by = f"stillcal {__version__} {format_} {watch}{'' if no_diagnosis else ' diagnosed'}"
    results = results_folder.Results(out, made_by)
    tasks = [Task(recording, format_, watch, not no_diagnosis) for recording in recordings_found]
    todo = results.todo(tasks)
    if not quiet:
        click.echo(
            f"{len(recordings_found)} recordings, {len(recordings_found) - len(todo)} of them already done"
        )
    began = time.monotonic()
    if todo:
        _examine(todo, results, _client(scheduler, workers), quiet)
    rows, findings = results.finish()
    if not quiet:
        counts = ", ".join(f"{n} {status}" for status, n in _counted(rows).items())
        for line in _bad(rows):
            click.echo(line)
        click.echo(f"{out}: {counts}; {len(findings)} findings; {time.monotonic() - began:.1f} s")


def _client(scheduler: str | None, workers: int | None) -> AbstractContextManager[Client]:
    from stillcal.replay.fleet import dask_jobs  # noqa: PLC0415 - Dask takes its time

    return dask_jobs.local(workers) if scheduler is None else dask_jobs.remote(scheduler)


def _examine(todo: list[Task], results: object, opened: AbstractContextManager[Client], quiet: bool) -> None:
    """Examine the recordings; however this ends, finished ones are on the disk."""
    from stillcal.replay.fleet import dask_jobs, results_folder  # noqa: PLC0415 - Dask takes its time
    from stillcal.replay.fleet.worker import Examined  # noqa: PLC0415 - with Dask

    assert isinstance(results, results_folder.Results)
    done = 0
    try:
        with opened as client, progress("recordings", len(todo), quiet) as step:

            def keep(task: Task, outcome: Examined) -> None:
                nonlocal done
                results.keep(task, outcome)
                done += 1
                step(done)

            dask_jobs.run(client, todo, keep)
    except dask_jobs.SchedulerError as error:
        raise click.UsageError(f"{error} ({done} of {len(todo)} finished and stored)") from error
    except KeyboardInterrupt:
        click.echo(
            f"stillcal: {done} of {len(todo)} finished and stored; repeat the command to continue", err=True
        )
        raise
    finally:
        results.flush()


def _bad(rows: list[dict[str, object]]) -> list[str]:
    """Return a line for each of the first recordings that could not be used, with the reason."""
    failures = [[str(row[k]) for k in ("status", "name", "reason")] for row in rows if row["status"] in _BAD]
    bad = [f"{status}: {why if name in why else f'{name}: {why}'}" for status, name, why in failures]
    more = (
        [f"and {len(bad) - _NAMED} more: see the column `reason` in recordings.parquet"]
        if len(bad) > _NAMED
        else []
    )
    return bad[:_NAMED] + more


def _counted(rows: list[dict[str, object]]) -> dict[str, int]:
    counts: dict[str, int] = {}
    for row in rows:
        counts[str(row["status"])] = counts.get(str(row["status"]), 0) + 1
    return dict(sorted(counts.items()))


@click.command(
    "fleet-report",
    short_help="Summarise a fleet: spread, outliers, clusters, priors.",
    epilog=examples("stillcal fleet-report results", "stillcal fleet-report results --json report.json"),
)
@click.argument("results", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option(
    "--json", "json_path", type=click.Path(path_type=Path), help="Write the summary as JSON ('-': print it)."
)
def report_command(results: Path, json_path: Path | None) -> None:
    """Summarise the RESULTS of stillcal fleet: spread by model, outliers, clusters, priors.

    The JSON has the priors: mean and covariance of a new phone's parameters, by model. Exit code 3: no device
    was calibrated.
    """
    try:
        from stillcal.replay.fleet.report import report  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise click.UsageError(_LACKING.format(error)) from error
    refuse_collisions(files(json_path), results.rglob("*.parquet"))
    fleet = report(results)
    text = pretty(fleet.document()) + "\n"
    if json_path == STANDARD_OUTPUT:
        click.echo(text, nl=False)
    else:
        if json_path is not None:
            write_atomically(json_path, text.encode())
        click.echo(", ".join(f"{n} {status}" for status, n in fleet.recordings.items()) or "no recordings")
        for table in _tables(fleet):
            Console().print(table)
        for limit in fleet.limits:
            click.echo(f"Note: {limit}")
    if not fleet.spreads:
        click.echo(f"stillcal: {results}: no device was calibrated", err=True)
        sys.exit(TOO_LITTLE)


def _tables(report: Report) -> Iterator[Table]:
    """Yield the tables that have rows."""
    for title, columns, rows in (
        ("All devices", ("quantity", "unit", "devices", "median", "middle half"), _spreads(report)),
        ("Bias by model, m/s²", ("model", "devices", "x", "y", "z"), _biases(report)),
        ("Effects found", ("model", "effect", "sensor", "recordings", "size"), _effects(report)),
        ("Outlier devices", ("device", "model", "distance", "limit", "most"), _outliers(report)),
        ("Clusters", ("exemplar", "devices", "bias, m/s²", "rate, Hz", "models"), _clusters(report)),
        ("Priors: bias, m/s²", ("model", "x", "y", "z", "± each"), _priors(report)),
    ):
        if rows:
            table = Table(*columns, title=title, title_justify="left", box=None, pad_edge=False)
            for row in rows:
                table.add_row(*row)
            yield table


def _spreads(report: Report) -> list[tuple[str, ...]]:
    return [
        (s.quantity, s.unit, str(s.devices), f"{s.median:.3g}", f"{s.low:.3g} to {s.high:.3g}")
        for s in report.spreads
        if s.of_all_models
    ]


def _biases(report: Report) -> list[tuple[str, ...]]:
    models = dict.fromkeys(s.model for s in report.spreads if not s.of_all_models)
    rows = []
    for model in models:
        own = [s for s in report.spreads if s.model == model and s.quantity.startswith("accelerometer bias")]
        cells = (f"{s.median:+.3f} ({s.low:+.3f} to {s.high:+.3f})" for s in own)
        rows.append((model, str(own[0].devices), *cells))
    return rows


def _effects(report: Report) -> list[tuple[str, ...]]:
    return [
        (
            e.model,
            e.effect,
            e.sensor,
            f"{e.found} of {e.diagnosed}",
            f"{e.parameter} {e.median:.3g} ({e.low:.3g} to {e.high:.3g}) {e.unit}",
        )
        for e in report.effects
    ]


def _outliers(report: Report) -> list[tuple[str, ...]]:
    return [
        (
            o.device,
            o.model,
            f"{o.distance:.1f}",
            f"{o.limit:.1f}",
            f"{o.parameter} {o.value:+.4g}, the others {o.median:+.4g}",
        )
        for o in report.outliers
    ]


def _clusters(report: Report) -> list[tuple[str, ...]]:
    return [
        (
            c.exemplar,
            str(c.devices),
            f"{c.bias:.3f}",
            f"{c.rate_hz:.1f}",
            ", ".join(f"{n} {model}" for model, n in c.models.items()),
        )
        for c in report.clusters
    ]


def _priors(report: Report) -> list[tuple[str, ...]]:
    return [
        (
            p.model or "any",
            *(f"{m:+.3f}" for m in p.mean[:3]),
            ", ".join(f"{v**0.5:.3f}" for v in p.covariance.diagonal()[:3]),
        )
        for p in report.priors
    ]


@click.command(
    "fleet-first",
    short_help="Calibrate a new phone from few rests and a fleet's prior.",
    epilog=examples(
        "stillcal fleet-report results --json fleet.json",
        "stillcal fleet-first new-phone.csv --prior fleet.json",
        "stillcal fleet-first new-phone.csv --prior fleet.json --model 'LG Nexus 4' --json first.json",
    ),
)
@click.argument("trace", type=click.Path(path_type=Path))
@click.option(
    "--prior", "report_path", type=click.Path(path_type=Path), required=True, help="A fleet's report."
)
@click.option("--model", help="The phone's model [default: what its maker claims].")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write it there ('-': print it).")
@format_option(rests=False)
def first_command(
    trace: Path, report_path: Path, model: str | None, json_path: Path | None, format_: str
) -> None:
    """Calibrate a new phone's accelerometer from any number of rests and the fleet's prior of its model.

    Parameters that the rests do not determine keep the prior's value; the share that comes from the rests is
    printed beside each. Rests that contradict the prior are refused. Exit code 3: no rest was found.
    """
    from stillcal.calib_core.errors import NotSupported  # noqa: PLC0415 - only this command
    from stillcal.replay.fleet.first_calibration import document, first_calibration  # noqa: PLC0415 - only this command
    from stillcal.replay.fleet.prior_file import read_prior  # noqa: PLC0415 - only this command
    from stillcal.replay.formats.trace import open_trace  # noqa: PLC0415 - only this command

    refuse_collisions(files(json_path), [*recording_files(trace), report_path])
    opened = open_trace(trace, format_)
    prior = read_prior(report_path, model, opened.claims.device)
    try:
        fit, rests = first_calibration(opened, prior)
    except NotSupported as refusal:
        click.echo(f"stillcal: {refusal}", err=True)
        sys.exit(TOO_LITTLE)
    calibration = document(fit, rests, prior)
    text = pretty(calibration) + "\n"
    if json_path == STANDARD_OUTPUT:
        click.echo(text, nl=False)
        return
    if json_path is not None:
        write_atomically(json_path, text.encode())
    states = calibration["accelerometer"]["n_states"]
    click.echo(f"{trace}: {len(rests)} rests in {states} attitudes, prior of {prior.model or 'any model'}")
    sds = fit.covariance.diagonal() ** 0.5
    for name, value, sd, share in zip(prior.names, fit.values, sds, fit.shown, strict=True):
        click.echo(f"  {name:5} {value:+9.4f} ± {sd:.4f}   {share:4.0%} from the rests")
    click.echo(f"  norm at rest is known to {fit.worst_norm_uncertainty:.3f} m/s² along the worst direction")
