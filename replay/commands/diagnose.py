"""`stillcal diagnose`: where a recording differs from a simulation, and why."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from stillcal.calib_core.codec import jsonable
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.streams.time_series import TimeSeries
from stillcal.daemon.cli.exits import TOO_LITTLE, VERDICT
from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import quiet_option
from stillcal.daemon.cli.progress import stages
from stillcal.daemon.store.document import pretty
from stillcal.daemon.system.files import input_name, short_name
from stillcal.replay.commands.command_line import command_line
from stillcal.replay.commands.fix_for import Correction
from stillcal.replay.commands.outputs import (
    files,
    recording_files,
    refuse_collisions,
    settings_files,
    write_output,
)
from stillcal.replay.commands.reading import READING, Reading, reading_options, show_notes
from stillcal.replay.diagnosis.condense import read_condensed
from stillcal.replay.diagnosis.diagnose import Request, conflict, diagnose
from stillcal.replay.diagnosis.judged import ShowStage
from stillcal.replay.diagnosis.report.figures import require_matplotlib
from stillcal.replay.diagnosis.report.page import page
from stillcal.replay.diagnosis.residuals import residuals_csv
from stillcal.replay.diagnosis.rest_table import diagnose_kept, diagnose_rests, told_of_temperatures
from stillcal.replay.diagnosis.words.summary import VERDICTS, summary
from stillcal.replay.export.fix.fixers import FIXERS
from stillcal.replay.formats.covariates import columns_there, read_covariates
from stillcal.replay.formats.daemon_state import is_daemon_state
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.trace import Recording
from stillcal.replay.formats.writer import STANDARD_OUTPUT
from stillcal.replay.phone.phone import Phone, dump_phone, load_phone

_path = click.Path(path_type=Path)


class _Asked(NamedTuple):
    """What the command was called with."""

    trace: Path
    phone: str | None
    simulated: Path | None
    simulated_reading: Reading
    paired: bool
    witnesses: tuple[tuple[Path, str | None], ...]
    json: Path | None
    report: Path | None
    phone_out: Path | None
    fix_for: tuple[str, Path] | None
    covariates: tuple[str, ...]
    residuals: Path | None
    reading: Reading


@click.command(
    "diagnose",
    short_help="Find where a recording differs from a simulation, and why.",
    epilog=examples(
        "stillcal diagnose sample:lab",
        "stillcal diagnose walk.csv",
        "stillcal diagnose walk.csv --report walk.html --json walk.diagnosis.json",
        "stillcal diagnose walk.csv --phone-out better.toml",
        "stillcal simulate day --phone better.toml --out day.csv",
        "stillcal diagnose walk.csv --phone mpu6050        # compare with a simulated phone",
        "stillcal diagnose walk.csv --simulated sim.csv    # where does my simulator differ?",
        "stillcal diagnose walk.csv --simulated sim.csv --report difference.html",
        "stillcal diagnose walk.csv --simulated sim.csv --fix-for gazebo model.sdf",
        "stillcal diagnose walk.csv --simulated same.csv --paired   # of the same motion",
        "stillcal diagnose log.bin --sensor 2 --witness log.bin --witness-sensor 0",
        "stillcal diagnose Phones_accelerometer.csv --json -",
        "stillcal diagnose log.csv --covariate battery_v   # does a bias follow that column?",
        "stillcal diagnose esgi.csv                        # a table of rests",
    ),
)
@click.argument("trace", type=_path)
@click.option("--phone", help="The simulated phone to compare with: a ready one, or a phone.toml.")
@click.option(
    "--simulated", type=_path, metavar="SIM", help="The simulation to be judged: a recording that it made."
)
@reading_options("SIM", "simulated")
@click.option(
    "--paired", is_flag=True, help="SIM has the motion and the stamps of TRACE: judge what is between them."
)
@click.option(
    "--witness",
    "witnesses",
    type=_path,
    multiple=True,
    metavar="OTHER",
    help="A recording by another sensor on the same body at the same time; may be given several times.",
)
@click.option(
    "--witness-sensor",
    "witness_sensors",
    multiple=True,
    metavar="NAME",
    help="Which sensor of OTHER, one for each --witness; or several of one OTHER.",
)
@click.option(
    "--fail-on",
    type=click.Choice(list(VERDICTS)),
    multiple=True,
    help="Exit with 5 on this verdict; may be given several times.",
)
@click.option("--json", "json_path", type=_path, help="Write the findings ('-': print them).")
@click.option("--report", type=_path, help="Write a report page for a browser (.html; '-': print it).")
@click.option(
    "--phone-out",
    type=_path,
    help="Write a phone with the effects found (.toml; '-': print it), for simulate --phone.",
)
@click.option(
    "--fix-for",
    type=(click.Choice(list(FIXERS)), _path),
    metavar="TOOL FILE",
    help="Correct FILE, the configuration of --simulated or --phone, by what was found; FILE.bak keeps the"
    f" old one. TOOL: {', '.join(FIXERS)}.",
)
@click.option(
    "--residuals",
    type=_path,
    help="Write what is left bin by bin, without and with the effects found (.csv; '-': print it).",
)
@click.option(
    "--covariate",
    "covariates",
    multiple=True,
    metavar="NAME",
    help="A further column of TRACE's table, and of SIM's where it has it, that a bias may follow; may be"
    " given several times.",
)
@reading_options()
@quiet_option
def diagnose_command(  # noqa: PLR0917 - click hands every option over by name
    trace: Path,
    phone: str | None,
    simulated: Path | None,
    simulated_reading: Reading,
    paired: bool,
    witnesses: tuple[Path, ...],
    witness_sensors: tuple[str, ...],
    fail_on: tuple[str, ...],
    json_path: Path | None,
    report: Path | None,
    phone_out: Path | None,
    fix_for: tuple[str, Path] | None,
    covariates: tuple[str, ...],
    residuals: Path | None,
    reading: Reading,
    quiet: bool,
) -> None:
    """Find where a recording differs from a simulation, by what physics, and by how much.

    The simulation is an ideal sensor moved as TRACE was, a phone file (--phone), or a recording that any
    simulator made (--simulated), which may have other motion and another length. Another rate is a finding;
    all else is compared in spite of it. What could not be checked is said. Exit code 3 where there is too
    little data.
    """
    asked = _Asked(
        trace,
        phone,
        simulated,
        simulated_reading,
        paired,
        _witnesses(witnesses, witness_sensors),
        json_path,
        report,
        phone_out,
        fix_for,
        tuple(dict.fromkeys(covariates)),
        residuals,
        reading,
    )
    _check(asked)
    correction = _correction(asked)
    try:
        with stages(quiet) as show_stage:
            outputs = _table(asked) if reading.is_rest_table(trace) else _diagnosed(asked, show_stage)
    except NotSupported as refusal:
        named = simulated is not None or str(refusal).startswith(f"{short_name(trace)}: ")
        subject = "" if named else f"{input_name(trace)}: "
        click.echo(f"stillcal: too little data: {subject}{refusal}", err=True)
        sys.exit(TOO_LITTLE)
    _write(outputs, asked)
    if correction is not None:
        correction.write(outputs.answer)
    show_notes(outputs.notes, quiet)
    if not quiet and STANDARD_OUTPUT not in (json_path, report, phone_out, residuals):
        click.echo("\n".join(summary(outputs.answer)))
    if outputs.answer["verdict"] in fail_on:
        sys.exit(VERDICT)


def _correction(asked: _Asked) -> Correction | None:
    """Return the configuration to be corrected; a new phone file begins with the phone that is judged."""
    if asked.fix_for is None:
        return None
    tool, path = asked.fix_for
    judged = asked.phone if tool == "phone" else None
    return Correction(tool, path, None if judged is None else dump_phone(_loaded(judged)))


def _witnesses(paths: Sequence[Path], sensors: Sequence[str]) -> tuple[tuple[Path, str | None], ...]:
    """Return each witness with its sensor. Raises UsageError where they do not belong together."""
    if not sensors:
        return tuple((path, None) for path in paths)
    if len(paths) == 1:
        return tuple((paths[0], sensor) for sensor in sensors)
    if len(paths) != len(sensors):
        raise click.UsageError(
            f"--witness-sensor is given {len(sensors)} times and --witness {len(paths)} times:"
            " give one sensor for each witness"
        )
    return tuple(zip(paths, sensors, strict=True))


def _check(asked: _Asked) -> None:
    """Refuse early what would fail late. Raises UsageError."""
    if why := conflict(_given(asked), "--"):
        raise click.UsageError(why)
    report, phone_out = asked.report, asked.phone_out
    if report is not None:
        require_matplotlib()
    if report not in (None, STANDARD_OUTPUT) and report.suffix not in (".html", ".htm"):
        raise click.UsageError(f"{report}: a report is an HTML page; choose a name that ends in .html")
    if asked.residuals not in (None, STANDARD_OUTPUT) and asked.residuals.suffix != ".csv":
        raise click.UsageError(f"{asked.residuals}: choose a name that ends in .csv for the residuals")
    if phone_out not in (None, STANDARD_OUTPUT) and phone_out.suffix != ".toml":
        raise click.UsageError(f"{phone_out}: choose a name that ends in .toml for a phone file")
    if asked.reading.is_rest_table(asked.trace) and any(
        x
        for x in (
            asked.phone,
            asked.simulated,
            asked.witnesses,
            report,
            phone_out,
            asked.fix_for,
            asked.covariates,
            asked.residuals,
        )
    ):
        raise click.UsageError(
            "a rest table has no samples: --phone, --simulated, --witness, --report, --phone-out, --fix-for,"
            " --covariate and --residuals need them"
        )
    if asked.fix_for is not None and asked.simulated is None and asked.phone is None:
        raise click.UsageError(
            "--fix-for corrects the simulation that is judged: give it as --simulated SIM or --phone PHONE"
        )
    if asked.simulated_reading != Reading() and asked.simulated is None:
        raise click.UsageError("--simulated-format, -sensor, -gyro, -from and -to go with --simulated")
    reads = [*recording_files(asked.trace), *asked.reading.files]
    reads += [] if asked.simulated is None else recording_files(asked.simulated)
    reads += asked.simulated_reading.files
    reads += [file for path, _ in asked.witnesses for file in recording_files(path)]
    reads += [] if asked.phone is None else settings_files(asked.phone)
    fixed = None if asked.fix_for is None else asked.fix_for[1]
    if fixed is not None and asked.phone and fixed.resolve() == Path(asked.phone).resolve():
        reads.remove(Path(asked.phone))  # the phone file that was judged is the one to be corrected
    refuse_collisions(files(report, phone_out, fixed, asked.residuals, asked.json), reads)


def _given(asked: _Asked) -> list[str]:
    """Return the names of the options that were given, of those that `conflict` knows."""
    options = {
        "simulated": asked.simulated,
        "phone": asked.phone,
        "paired": asked.paired,
        "witness": asked.witnesses,
        "covariate": asked.covariates,
        "phone-out": asked.phone_out,
        "residuals": asked.residuals,
    }
    return [name for name, value in options.items() if value]


class _Outputs(NamedTuple):
    """The answer in plain values, the texts of page and phone file if asked for, and notes on reading."""

    answer: dict[str, Any]
    page: str | None = None
    phone: str | None = None
    notes: Sequence[str] = ()
    residuals: str | None = None


def _table(asked: _Asked) -> _Outputs:
    of_rests = diagnose_kept if is_daemon_state(asked.trace) else diagnose_rests
    table, name = asked.reading.rest_table(asked.trace), short_name(asked.trace)
    notes = [*table.notes, *(f"{name}: {note}" for note in told_of_temperatures(table.rests))]
    return _Outputs(of_rests(table.rests, name), notes=notes)


def _diagnosed(asked: _Asked, show_stage: ShowStage) -> _Outputs:
    whole = asked.paired or bool(asked.witnesses)
    recording = _read(asked.reading, asked.trace, show_stage, whole=whole)
    if asked.covariates:
        recording = replace(recording, covariates=_columns(asked.reading, asked.trace, asked.covariates))
    simulated = None
    if asked.simulated is not None:
        simulated = _read_simulation(asked, asked.simulated, show_stage, whole=whole)
        if asked.covariates:
            columns = _columns_there(asked.simulated_reading, asked.simulated, asked.covariates)
            simulated = replace(simulated, covariates=columns)
    witnesses = tuple(_witness(path, sensor, show_stage) for path, sensor in asked.witnesses)
    phone = None if asked.phone is None else _loaded(asked.phone)
    name = "" if asked.phone is None else short_name(asked.phone)
    request = Request(simulated, phone, name, asked.phone_out is not None, asked.paired, witnesses)
    outcome = diagnose(recording, request, show_stage)
    show_stage("writing", 0.0)
    made = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC: {command_line()}"
    text = page(outcome.judged, made) if asked.report is not None else None
    notes = [*recording.notes, *(simulated.notes if simulated is not None else ())]
    if simulated is not None and _same(simulated, recording):
        notes.append(
            f"{simulated.name} holds the very samples of {recording.name}: it is compared with itself"
        )
    left = None if asked.residuals is None else residuals_csv(outcome.judged.recorded)
    return _Outputs(outcome.judged.answer, text, outcome.phone_text, notes, left)


def _same(one: Recording, other: Recording) -> bool:
    """Whether two recordings have the same samples of both sensors."""
    rates = [np.zeros((0, 3)) if r.gyroscope is None else r.gyroscope.xyz for r in (one, other)]
    alike = np.array_equal(one.accelerometer.xyz, other.accelerometer.xyz)
    return alike and np.array_equal(rates[0], rates[1])


def _read(reading: Reading, path: Path, show_stage: ShowStage, *, whole: bool) -> Recording:
    """Read a recording, of a long one only what is needed unless it is wanted `whole`."""
    name = short_name(path) if reading.sensor is None else f"{short_name(path)}, sensor {reading.sensor}"
    stage = f"reading {name}"
    show_stage(stage, 0.0)
    trace = reading.open(path)
    if whole:
        return trace.recording(trace.name_of(path), lambda done: show_stage(stage, done))
    return read_condensed(trace, path, lambda done: show_stage(stage, done))


def _columns(reading: Reading, path: Path, names: Sequence[str]) -> dict[str, TimeSeries]:
    """Return further columns of a recording, all of which it must have."""
    return read_covariates(reading.open(path), names)


def _columns_there(reading: Reading, path: Path, names: Sequence[str]) -> dict[str, TimeSeries]:
    """Return those of the columns that a simulation has."""
    trace = reading.open(path)
    return read_covariates(trace, columns_there(trace, names))


def _read_simulation(asked: _Asked, path: Path, show_stage: ShowStage, *, whole: bool) -> Recording:
    """Read the simulation; the remedies of errors name its own options."""
    try:
        return _read(asked.simulated_reading, path, show_stage, whole=whole)
    except TraceError as error:
        remedy = re.sub(rf"--({'|'.join(READING)})\b", r"--simulated-\1", error.remedy)
        raise TraceError(error.file, error.what, remedy, error.row) from error


def _witness(path: Path, sensor: str | None, show_stage: ShowStage) -> Recording:
    recording = _read(Reading(sensor=sensor), path, show_stage, whole=True)
    return recording if sensor is None else replace(recording, name=f"{short_name(path)}, sensor {sensor}")


def _loaded(name: str) -> Phone:
    try:
        return load_phone(name)
    except ValueError as error:
        raise click.UsageError(str(error)) from error


def _write(outputs: _Outputs, asked: _Asked) -> None:
    """Write the files that were asked for, each whole or not at all."""
    if asked.report is not None and outputs.page is not None:
        write_output(asked.report, outputs.page.encode())
    if asked.residuals is not None and outputs.residuals is not None:
        write_output(asked.residuals, outputs.residuals.encode())
    if asked.phone_out is not None and outputs.phone is not None:
        write_output(asked.phone_out, outputs.phone.encode())
    text = pretty(jsonable(outputs.answer)) + "\n"
    if asked.json is not None:
        write_output(asked.json, text.encode())
