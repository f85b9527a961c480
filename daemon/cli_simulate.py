"""`stillcal simulate`: a recording of the simulated phone, as a real one would have been written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import msgspec

from stillcal.daemon.atomic import write_atomically
from stillcal.daemon.cli_lazy import examples
from stillcal.daemon.outputs import new_recording_files, refuse_collisions
from stillcal.daemon.progress import progress
from stillcal.daemon.store_document import pretty
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.writer import TraceWriter
from stillcal.replay.phone import Simulation, load_phone, load_scenario, simulate
from stillcal.replay.phone.simulation import TrueModel


@click.command(
    "simulate",
    epilog=examples(
        "stillcal simulate lab --out lab.csv --seed 7",
        "stillcal simulate day --phone mpu6050 --out day.csv.gz --truth day.truth.json",
        "stillcal simulate my-week.toml --phone my-phone.toml --out week.csv.gz",
    ),
)
@click.argument("scenario")
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="The recording (.csv or .csv.gz)."
)
@click.option(
    "--seed",
    default=0,
    type=click.IntRange(0),
    show_default=True,
    help="The same seed gives the same recording.",
)
@click.option("--phone", default="typical", show_default=True, help="A ready phone, or a phone.toml.")
@click.option("--truth", type=click.Path(path_type=Path), help="Write the true sensor errors there (JSON).")
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
def simulate_command(  # noqa: PLR0917 - click hands every option over by name
    scenario: str, out: Path, seed: int, phone: str, truth: Path | None, quiet: bool
) -> None:
    """Write a recording of the simulated phone living through SCENARIO.

    SCENARIO is a ready one (lab, tables, desk, day, night, drive, laundry, week) or a TOML file. Beside
    the recording stand its events (.events.jsonl) and what the maker claims (.json); what a real phone
    would not tell goes into --truth only.
    """
    simulation = _simulation(scenario, phone, seed)
    told = [path for path in (Path(scenario), Path(phone)) if path.suffix == ".toml"]
    refuse_collisions([*new_recording_files(out), *([] if truth is None else [truth])], told)
    claims = msgspec.convert(simulation.phone.claimed(), Claims)
    with (
        progress("simulating", simulation.duration, quiet) as step,
        _writer(simulation, out, claims) as writer,
    ):
        for chunk in simulation.chunks():
            writer.write(chunk.accelerometer, chunk.gyroscope, chunk.events)
            step(chunk.t_end)
    if truth is not None:
        write_atomically(truth, (pretty(truth_of(simulation)) + "\n").encode())
    if not quiet:
        click.echo(f"{out}: {simulation.duration:.0f} s of {scenario}, phone {phone}, seed {seed}")


def truth_of(simulation: Simulation) -> dict[str, Any]:
    """Return the true affine models as plain values; calibrated = scale @ (raw - bias)."""
    known = simulation.truth
    return {"accelerometer": _plain(known.accelerometer), "gyroscope": _plain(known.gyroscope)}


def _plain(model: TrueModel | None) -> dict[str, Any] | None:
    return None if model is None else {"scale": model.scale.tolist(), "bias": model.bias.tolist()}


def _simulation(scenario: str, phone: str, seed: int) -> Simulation:
    try:
        return simulate(load_scenario(scenario), load_phone(phone), seed)
    except ValueError as error:
        raise click.UsageError(str(error)) from error


def _writer(simulation: Simulation, out: Path, claims: Claims) -> TraceWriter:
    first = next(iter(simulation.chunks())).accelerometer
    return TraceWriter(
        out,
        gyroscope=simulation.phone.gyro is not None,
        temperature=first.temperature is not None,
        arrival=first.t_arrival is not None,
        claims=claims,
    )
