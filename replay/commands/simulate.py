"""`stillcal simulate`: the recording of a simulated phone, in the format of a real one.

Or the phone itself, on a pseudo-terminal that a daemon opens as it would a USB device.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import msgspec

from stillcal.daemon.cli.lazy import examples
from stillcal.daemon.cli.options import FiniteRange, quiet_option
from stillcal.daemon.cli.progress import progress
from stillcal.daemon.store.document import pretty
from stillcal.daemon.system.files import input_name
from stillcal.daemon.system.requirements import PSEUDO_TERMINAL, require
from stillcal.daemon.system.signals import run_until_signalled
from stillcal.replay.commands.outputs import (
    files,
    new_recording_files,
    refuse_collisions,
    settings_files,
    write_output,
)
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.conversion.by_name import writer_class
from stillcal.replay.formats.writer import STANDARD_OUTPUT, TraceWriter
from stillcal.replay.phone import Simulation, load_phone, load_scenario, simulate
from stillcal.replay.phone.simulation import Chunk, TrueModel


@click.command(
    "simulate",
    short_help="Simulate a phone: write its recording, or stream it live.",
    epilog=examples(
        "stillcal simulate lab --out lab.csv --seed 7",
        "stillcal simulate day --phone mpu6050 --out day.csv.gz --truth day.truth.json",
        "stillcal simulate my-week.toml --phone my-phone.toml --out week.csv.gz",
        "stillcal simulate day --serial --port phone    # and elsewhere: stillcal run --port phone",
    ),
)
@click.argument("scenario")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="The recording (.csv, .csv.gz or .parquet; '-': print CSV).",
)
@click.option("--serial", is_flag=True, help="Stream on a pseudo-terminal instead; its path is printed.")
@click.option(
    "--port", type=click.Path(path_type=Path), help="With --serial: make this a link to the terminal."
)
@click.option(
    "--speed",
    type=FiniteRange(0, min_open=True),
    help="With --serial: simulated seconds per second [default: as fast as it is read].",
)
@click.option(
    "--seed",
    default=0,
    type=click.IntRange(0),
    show_default=True,
    help="The same seed gives the same recording.",
)
@click.option(
    "--phone",
    default="typical",
    show_default=True,
    help="A ready phone, or a phone.toml ('-': standard input).",
)
@click.option(
    "--truth",
    type=click.Path(path_type=Path),
    help="Write the true sensor errors there (JSON; '-': print them).",
)
@quiet_option
def simulate_command(  # noqa: PLR0917 - click hands every option over by name
    scenario: str,
    out: Path | None,
    serial: bool,
    port: Path | None,
    speed: float | None,
    seed: int,
    phone: str,
    truth: Path | None,
    quiet: bool,
) -> None:
    """Write the recording that a simulated phone makes in SCENARIO.

    SCENARIO is a ready one (lab, tables, desk, day, night, drive, laundry, starved, week) or a TOML file
    ('-': standard input). The events (.events.jsonl) and the maker's claims (.json) are written beside the
    recording; the true sensor errors only with --truth. With --serial the phone streams to a daemon instead,
    until the daemon has received everything.
    """
    if serial == (out is not None):
        raise click.UsageError("give either --out for a recording, or --serial for a live stream")
    if not serial and (port is not None or speed is not None):
        raise click.UsageError("--port and --speed need --serial")
    inputs = [*settings_files(scenario), *settings_files(phone)]
    outputs = [*([] if out is None else new_recording_files(out)), *files(truth, port)]
    refuse_collisions(outputs, inputs)
    simulation = _simulation(scenario, phone, seed)
    if out is not None:
        _write(simulation, out, quiet)
    else:
        _serve(simulation, speed or math.inf, port, quiet)
    if truth is not None:
        write_output(truth, (pretty(truth_of(simulation)) + "\n").encode())
    if not quiet:
        where = "" if out in (None, STANDARD_OUTPUT) else f"{out}: "
        of = f"{input_name(scenario)}, phone {input_name(phone)}, seed {seed}"
        click.echo(f"{where}{simulation.duration:.0f} s of {of}", err=STANDARD_OUTPUT in (out, truth))


def _write(simulation: Simulation, out: Path, quiet: bool) -> None:
    claims = msgspec.convert(simulation.phone.claimed(), Claims)
    with (
        progress("simulating", simulation.duration, quiet) as step,
        _writer(simulation, out, claims) as writer,
    ):
        for chunk in simulation.chunks():
            writer.write(chunk.accelerometer, chunk.gyroscope, chunk.events)
            step(chunk.t_end)


def _serve(simulation: Simulation, speed: float, port: Path | None, quiet: bool) -> None:
    """Stream the phone on a pseudo-terminal until a daemon has received its end, or a signal ends it."""
    require("stillcal simulate --serial", PSEUDO_TERMINAL)
    from stillcal.replay.serial_phone.link import (  # noqa: PLC0415 - imports what only POSIX has
        LinkSettings,
        serve_phone,
    )

    settings = LinkSettings(speed=speed, credit=speed > 1.0)
    with progress("streaming", simulation.duration, quiet) as step:

        def chunks() -> Iterator[Chunk]:
            for chunk in simulation.chunks():
                step(chunk.t_end)
                yield chunk

        try:
            run_until_signalled(serve_phone(chunks(), simulation.phone.claimed(), settings, port, click.echo))
        except OSError as error:
            raise click.UsageError(str(error)) from error


def truth_of(simulation: Simulation) -> dict[str, Any]:
    """Return the true affine models as plain values; calibrated = scale @ (raw - bias)."""
    truth = simulation.truth
    return {"accelerometer": _plain(truth.accelerometer), "gyroscope": _plain(truth.gyroscope)}


def _plain(model: TrueModel | None) -> dict[str, Any] | None:
    return None if model is None else {"scale": model.scale.tolist(), "bias": model.bias.tolist()}


def _simulation(scenario: str, phone: str, seed: int) -> Simulation:
    try:
        return simulate(load_scenario(scenario), load_phone(phone), seed)
    except ValueError as error:
        raise click.UsageError(str(error)) from error


def _writer(simulation: Simulation, out: Path, claims: Claims) -> TraceWriter:
    first = next(iter(simulation.chunks())).accelerometer
    return writer_class(out)(
        out,
        gyroscope=simulation.phone.gyro is not None,
        temperature=first.temperature is not None,
        arrival=first.t_arrival is not None,
        claims=claims,
    )
