"""`stillcal fleet`, `fleet-report` and `fleet-first`: many recordings at once, and a fleet's prior."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console
from rich.table import Table

from stillcal._version import __version__
from stillcal.daemon.cli.exits import TOO_LITTLE
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import quiet_option
from stillcal.daemon.cli.progress import progress
from stillcal.daemon.store.document import pretty
from stillcal.daemon.store.store import Store
from stillcal.daemon.system.files import input_name, is_read_once, short_name
from stillcal.replay.commands.outputs import (
    files,
    recording_files,
    refuse_collisions,
    store_files,
    write_output,
)
from stillcal.replay.commands.reading import Reading, reading_options
from stillcal.replay.formats.writer import STANDARD_OUTPUT

if TYPE_CHECKING:
    from distributed import Client

    from stillcal.calib_core.calibration.record import CalibrationRecord
    from stillcal.replay.fleet.summary.sections import Section
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
@click.option(
    "--format",
    "format_",
    default="auto",
    show_default=True,
    help="Format of RECORDINGS (docs/formats.md), or a column map (.toml); auto: by the content of each.",
)
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

    A folder is searched for recordings in every format that is recognised by content, whatever the files are
    called; of a pattern all files are taken. What phyphox, Sensor Logger, ROS 2 and KITTI write as a folder
    is one recording.

    Writes recordings.parquet (one row per recording: device, parameters with standard deviations, verdict)
    and findings.parquet into the folder of results. Called again, it continues with recordings that are new
    or have changed. A recording that cannot be used becomes a row with the reason; the exit code is 0 all the
    same.
    """
    if is_read_once(format_):
        raise click.UsageError(f"--format {format_}: each recording is read by it anew: give a file")
    try:
        from stillcal.replay.fleet import discovery, results_folder  # noqa: PLC0415 - an extra
        from stillcal.replay.fleet.worker import Task  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise click.UsageError(_LACKING.format(error)) from error
    try:
        listing = discovery.find(recordings, format_)
    except discovery.NoRecordingsError as error:
        raise click.UsageError(str(error)) from error
    made_by = f"stillcal {__version__} {format_} {watch}{'' if no_diagnosis else ' diagnosed'}"
    results = results_folder.Results(out, made_by)
    tasks = [Task(recording, format_, watch, not no_diagnosis) for recording in listing.recordings]
    todo = results.todo(tasks)
    if not quiet:
        click.echo(f"{len(tasks)} recordings, {len(tasks) - len(todo)} of them already done")
        if listing.passed_over:
            shown = ", ".join(listing.passed_over[:8]) + (", ..." if len(listing.passed_over) > 8 else "")
            click.echo(f"passed over, since they are no recordings: {shown}")
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
    short_help="Summarise a fleet: changes, spread, outliers, priors.",
    epilog=examples(
        "stillcal fleet-report results",
        "stillcal fleet-report results --json report.json --report report.html",
    ),
)
@click.argument("results", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option(
    "--json", "json_path", type=click.Path(path_type=Path), help="Write the summary as JSON ('-': print it)."
)
@click.option(
    "--report",
    "page_path",
    type=click.Path(path_type=Path),
    help="Write a page for a browser (.html; '-': print it).",
)
def report_command(results: Path, json_path: Path | None, page_path: Path | None) -> None:
    """Summarise the RESULTS of stillcal fleet: what got worse, spread by model, outliers, clusters, priors.

    A device with several recordings is judged by the first and the last of them, in the order of their
    names. The JSON has the priors: mean and covariance of a new phone's parameters, by model. Exit code 3:
    no device was calibrated.
    """
    try:
        from stillcal.replay.fleet.summary.page import fleet_page  # noqa: PLC0415 - an extra
        from stillcal.replay.fleet.summary.report import report  # noqa: PLC0415 - an extra
        from stillcal.replay.fleet.summary.sections import sections  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise click.UsageError(_LACKING.format(error)) from error
    if page_path not in (None, STANDARD_OUTPUT) and page_path.suffix not in (".html", ".htm"):
        raise click.UsageError(f"{page_path}: a report is an HTML page; choose a name that ends in .html")
    refuse_collisions(files(json_path, page_path), results.rglob("*.parquet"))
    fleet = report(results)
    if json_path is not None:
        write_output(json_path, (pretty(fleet.document()) + "\n").encode())
    if page_path is not None:
        write_output(page_path, fleet_page(fleet, results.name).encode())
    if STANDARD_OUTPUT not in (json_path, page_path):
        click.echo(", ".join(f"{n} {status}" for status, n in fleet.recordings.items()) or "no recordings")
        for section in sections(fleet):
            Console().print(_table(section))
        for limit in fleet.limits:
            click.echo(f"Note: {limit}")
    if not fleet.spreads:
        click.echo(f"stillcal: {results}: no device was calibrated", err=True)
        sys.exit(TOO_LITTLE)


def _table(section: Section) -> Table:
    table = Table(*section.heads, title=section.title, title_justify="left", box=None, pad_edge=False)
    for row in section.rows:
        table.add_row(*row)
    return table


@click.command(
    "fleet-first",
    short_help="Calibrate a new phone from few rests and a fleet's prior.",
    epilog=examples(
        "stillcal fleet-report results --json fleet.json",
        "stillcal fleet-first new-phone.csv --prior fleet.json --store store.json",
        "stillcal fleet-first new-phone.csv --prior fleet.json --model 'LG Nexus 4' --json first.json",
    ),
)
@click.argument("trace", type=click.Path(path_type=Path))
@click.option(
    "--prior", "report_path", type=click.Path(path_type=Path), required=True, help="A fleet's report."
)
@click.option("--model", help="The phone's model [default: what its maker claims].")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write it there ('-': print it).")
@click.option(
    "--store", "store_path", type=click.Path(path_type=Path), help="Store the calibration, for apply and run."
)
@reading_options()
def first_command(  # noqa: PLR0917 - click hands every option over by name
    trace: Path,
    report_path: Path,
    model: str | None,
    json_path: Path | None,
    store_path: Path | None,
    reading: Reading,
) -> None:
    """Calibrate a new phone's accelerometer from any number of rests and the fleet's prior of its model.

    Parameters that the rests do not determine keep the prior's value; the share that comes from the rests is
    printed beside each. Rests that contradict the prior are refused. Exit code 3: no rest was found.
    """
    from stillcal.calib_core.errors import NotSupported  # noqa: PLC0415 - only this command
    from stillcal.replay.fleet.first_calibration import (  # noqa: PLC0415 - only this command
        document,
        first_calibration,
        record_of,
    )
    from stillcal.replay.fleet.prior_file import few_devices, read_prior  # noqa: PLC0415 - only this command

    outputs = [*files(json_path), *([] if store_path is None else store_files(store_path))]
    refuse_collisions(outputs, [*recording_files(trace), *reading.files, report_path])
    opened = reading.open(trace)
    prior = read_prior(report_path, model, opened.claims.device)
    try:
        fit, rests = first_calibration(opened, prior)
    except NotSupported as refusal:
        click.echo(f"stillcal: {refusal}", err=True)
        sys.exit(TOO_LITTLE)
    calibration = document(fit, rests, prior)
    if json_path is not None:
        write_output(json_path, (pretty(calibration) + "\n").encode())
    if store_path is not None:
        _store(store_path, lambda before: record_of(fit, rests, prior, before), short_name(trace))
    if warning := few_devices(prior):
        click.echo(f"stillcal: {warning}", err=True)
    if json_path == STANDARD_OUTPUT:
        return
    states = calibration["accelerometer"]["n_states"]
    click.echo(
        f"{input_name(trace)}: {len(rests)} rests in {states} attitudes,"
        f" prior of {prior.model or 'any model'}"
    )
    sds = fit.covariance.diagonal() ** 0.5
    for name, value, sd, share in zip(prior.names, fit.values, sds, fit.shown, strict=True):
        click.echo(parameter_line(name, value, sd, share))
    click.echo(f"  norm at rest is known to {fit.worst_norm_uncertainty:.2g} m/s² along the worst direction")
    if store_path is not None:
        click.echo(f"  stored in {store_path}")


def parameter_line(name: str, value: float, sd: float, share: float) -> str:
    """Return a parameter of a first calibration in a line. share: what of its information the rests gave."""
    return f"  {name:5} {value:+10.5f} ± {sd:<7.2g}   {share:4.0%} from the rests"


def _store(path: Path, made: Callable[[CalibrationRecord | None], CalibrationRecord], source: str) -> None:
    """Make a calibration current in a store, made from the one that was."""
    with Store(path) as store:
        document = store.load()
        record = made(None if document is None else document.current)
        record = replace(record, provenance=replace(record.provenance, source=source))
        for note in store.publish(record, record.acceptance.reason, record.fitted_at).notes:
            click.echo(f"stillcal: {note}", err=True)
