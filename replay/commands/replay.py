"""`stillcal replay` and `stillcal apply`: calibrate from a recording, and correct a recording."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from stillcal.calib_core.codec import plain
from stillcal.calib_core.engine.actions import Publish, Reject
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.streams.resample import median_rate_hz
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.streams.smoothing import RollingMean
from stillcal.daemon.cli.exits import TOO_LITTLE
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import FiniteRange, config_option, quiet_option
from stillcal.daemon.cli.progress import progress
from stillcal.daemon.settings import load_settings
from stillcal.daemon.store.document import calibration_json, pretty
from stillcal.daemon.system.files import STANDARD_INPUT, input_name, short_name
from stillcal.replay.commands.outputs import (
    files,
    new_recording_files,
    recording_files,
    refuse_collisions,
    say,
    store_files,
    write_output,
)
from stillcal.replay.commands.reading import Reading, reading_options, show_notes
from stillcal.replay.corrector import Corrector
from stillcal.replay.formats.conversion.by_name import writer_class
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import Chunk, Trace
from stillcal.replay.formats.writer import STANDARD_OUTPUT
from stillcal.replay.outcome import (
    current_in_store,
    from_recording,
    full,
    keep_in_store,
    outcome_rows,
    why_not,
)
from stillcal.replay.runner import Outcome, calibrated_by_faces, replay, replay_rests, with_choices

_existing = click.Path(path_type=Path)

RATE_ROWS = 1000
"""Rows at the beginning of a recording that its sampling rate is taken from."""


@click.command(
    "replay",
    short_help="Calibrate from a recording, with the daemon's engine.",
    epilog=examples(
        "stillcal replay sample:lab --store store.json     # a recording that comes with stillcal",
        "stillcal replay walk.csv --store store.json",
        "stillcal replay esgi.csv --gravity 9.81 --json -  # a table of rests",
        "stillcal replay export.zip                        # of phyphox or Sensor Logger",
        "stillcal replay flight.ulg --sensor sensor_accel0 --from 60 --to 600",
        "zcat walk.csv.gz | stillcal replay -",
    ),
)
@click.argument("trace", type=_existing)
@click.option("--store", "store_path", type=_existing, help="Store the calibration in this file.")
@click.option(
    "--json", "json_path", type=_existing, help="Write the calibration as JSON ('-': standard output)."
)
@reading_options()
@config_option
@click.option("--gravity", type=float, help="Local gravity in m/s^2, if it is known.")
@click.option(
    "--watch", type=click.Choice(["auto", "continuous", "probing"]), help="Override when the sensors are on."
)
@click.option(
    "--faces",
    is_flag=True,
    help="The phone lay once on each of its six faces, on a level surface: also fixes the common rotation.",
)
@quiet_option
def replay_command(  # noqa: PLR0917 - click hands every option over by name
    trace: Path,
    store_path: Path | None,
    json_path: Path | None,
    reading: Reading,
    config: Path | None,
    gravity: float | None,
    watch: str | None,
    faces: bool,
    quiet: bool,
) -> None:
    """Calibrate from a recording with the daemon's own engine, as fast as possible.

    The store is the same as after a live run. Exit code 3: the recording does not allow a calibration; the
    message says why and which attitude is missing.

    With --faces the recording shows the phone lying on each of its six faces, in any order, on a level
    surface, for some ten seconds each. Only that fixes the rotation common to all axes, and later
    calibrations of the store keep it. Other attitudes may come between; they improve bias and scale.
    """
    refuse_collisions(
        _output_files(store_path, json_path), [*recording_files(trace), *reading.files, *files(config)]
    )
    settings = load_settings(config)
    calibrations: list[Publish | Reject] = []
    beginning = None
    watch = "continuous" if faces and watch is None else watch
    if reading.is_rest_table(trace):
        engine = Engine(with_choices(settings.engine, gravity, watch))
        table = reading.rest_table(trace)
        outcome = replay_rests(table.rests, engine, calibrations.append)
        show_notes([*table.notes, *outcome.warnings], quiet)
    else:
        opened = reading.open(trace)
        beginning = opened.beginning
        engine = Engine(with_choices(settings.engine, gravity, watch, opened.claimed_gravity))
        outcome = _replayed(opened, engine, calibrations.append, quiet)
    calibrations = [*calibrated_by_faces(outcome, settings.engine)] if faces else full(calibrations)
    name = short_name(trace)
    if store_path is not None and calibrations:
        kept = [replace(a, record=from_recording(a.record, name, beginning)) for a in calibrations]
        for note in keep_in_store(store_path, kept, settings.store):
            click.echo(f"stillcal: {note}", err=True)
    if json_path is not None:
        _write_json(json_path, outcome)
    if not quiet and json_path != STANDARD_OUTPUT:
        _print_outcome(outcome, name, store_path if calibrations else None)
    if outcome.record is None or outcome.record.accelerometer is None:
        click.echo(f"stillcal: {input_name(trace)}: no calibration: {why_not(outcome)}", err=True)
        sys.exit(TOO_LITTLE)


@click.command(
    "apply",
    short_help="Correct a recording with a stored calibration.",
    epilog=examples("stillcal apply walk.csv --store store.json --out walk-true.csv"),
)
@click.argument("trace", type=_existing)
@click.option("--store", "store_path", type=_existing, required=True, help="The store ('-': standard input).")
@click.option(
    "--out",
    type=_existing,
    required=True,
    help="The corrected recording (.csv, .csv.gz, .parquet; '-': print CSV).",
)
@reading_options()
@click.option(
    "--smooth",
    is_flag=True,
    help="Also remove noise by a rolling mean of 3 to 20 samples, by rate; the values then come late.",
)
@click.option(
    "--on-for",
    type=FiniteRange(0),
    metavar="SECONDS",
    help="How long the phone had been switched on when the recording began; a warm-up counts from there"
    " [default: 0].",
)
@quiet_option
def apply_command(  # noqa: PLR0917 - click hands every option over by name
    trace: Path,
    store_path: Path,
    out: Path,
    reading: Reading,
    smooth: bool,
    on_for: float | None,
    quiet: bool,
) -> None:
    """Write the recording with its sensor errors corrected: scale @ (raw - bias).

    With --smooth each value is the mean of the newest samples: 3 up to 20 Hz, 5 up to 80 Hz, 10 up to 120 Hz
    and 20 above. Time stamps stay, so values come late by half of that; the command says by how much.
    """
    if str(trace) == str(store_path) == STANDARD_INPUT:
        raise UserError("standard input cannot be both the recording and the store: give a path for one")
    record = current_in_store(store_path)
    refuse_collisions(
        new_recording_files(out), [*recording_files(trace), *reading.files, *store_files(store_path)]
    )
    opened = reading.open(trace)
    corrector = Corrector(record, opened.beginning, on_for)
    means = _rolling_means(opened) if smooth else {}
    with (
        progress(short_name(opened.path), opened.size_bytes, quiet) as step,
        _writer(opened, out, corrector, means) as write,
    ):
        for chunk in opened.chunks():
            write(chunk)
            step(opened.bytes_read)
    show_notes(opened.notes, quiet)
    for warning in corrector.warnings():
        click.echo(f"stillcal: {input_name(trace)}: {warning}", err=True)
    if not quiet:
        say(out, f"corrected with calibration {record.id}")
        for sensor, mean in means.items():
            say(out, f"{sensor}: {mean.words()}")


def _rolling_means(opened: Trace) -> dict[Sensor, RollingMean]:
    """Return the rolling mean of each sensor, by its rate at the recording's beginning. Raises TraceError."""
    first = next(iter(opened.chunks(max_rows=RATE_ROWS)))
    present = [first.accelerometer, *([first.gyroscope] if opened.has_gyroscope else [])]
    try:
        return {samples.sensor: RollingMean(median_rate_hz(samples)) for samples in present}
    except ValueError as error:
        raise TraceError(opened.path, f"cannot be smoothed: {error}", "apply without --smooth") from None


@contextmanager
def _writer(
    opened: Trace, out: Path, corrector: Corrector, means: Mapping[Sensor, RollingMean]
) -> Iterator[Callable[[Chunk], None]]:
    """Give a function that writes corrected and perhaps smoothed chunks; an error leaves no file behind.

    The first chunk shows which optional columns there are. The maker's claims about range stay true to first
    order, and about noise where it is not smoothed; those about raw counts do not.
    """
    first = next(iter(opened.chunks(max_rows=64)))
    claims = opened.claims.without_counts()
    with writer_class(out)(
        out,
        gyroscope=opened.has_gyroscope,
        temperature=first.accelerometer.temperature is not None,
        arrival=first.accelerometer.t_arrival is not None,
        claims=claims.without_noise() if means else claims,
    ) as writer:

        def write(chunk: Chunk) -> None:
            gyroscope = chunk.gyroscope if opened.has_gyroscope else None
            accel, gyro = corrector.corrected(chunk.accelerometer, gyroscope, chunk.events)
            if means:
                accel = means[accel.sensor].smoothed_samples(accel)
                gyro = None if gyro is None else means[gyro.sensor].smoothed_samples(gyro)
            writer.write(accel, gyro, chunk.events)

        yield write


def _print_outcome(outcome: Outcome, name: str, store: Path | None) -> None:
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0), title=name, title_justify="left")
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    for label, value in outcome_rows(outcome, store):
        table.add_row(label, value)
    Console().print(table)


def _output_files(store: Path | None, json_path: Path | None) -> list[Path]:
    return [*([] if store is None else store_files(store)), *files(json_path)]


def _replayed(
    opened: Trace, engine: Engine, keep: Callable[[Publish | Reject], None], quiet: bool
) -> Outcome:
    with progress(short_name(opened.path), opened.size_bytes, quiet) as step:
        outcome = replay(opened.chunks(), engine, keep, lambda: step(opened.bytes_read))
    show_notes([*opened.notes, *outcome.warnings], quiet)
    return outcome


def _write_json(path: Path, outcome: Outcome) -> None:
    text = pretty(calibration_json(outcome.record) | {"run": _run_figures(outcome)}) + "\n"
    write_output(path, text.encode())


def _run_figures(outcome: Outcome) -> dict[str, Any]:
    """Return what the engine did, and how long the sensors were on for it (their energy)."""
    counters = {} if outcome.state is None else plain(outcome.state.counters)
    return {
        "duration": outcome.duration,
        "samples": outcome.samples,
        "refusal": None if outcome.refusal is None else plain(outcome.refusal),
        "counters": counters,
        "ledger": plain(outcome.ledger),
    }
