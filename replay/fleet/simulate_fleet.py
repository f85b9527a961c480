"""A fleet to try things on: `python -m stillcal.replay.fleet.simulate_fleet FOLDER [--phones N]`.

Simulated phones of several models, one recording each, laid out as MODEL/DEVICE/recording.csv, with what
their maker claims beside them. Some are spoilt on purpose, since some always are.
"""

from __future__ import annotations

from pathlib import Path

import click
import msgspec

from stillcal.daemon.cli.progress import progress
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.writer import TraceWriter
from stillcal.replay.phone import Phone, load_scenario, simulate
from stillcal.replay.phone.population import population

RATE_HZ = 25.0
"""Accelerometers as slow as a phone's may be: a fleet is about many, not about long."""


def recording(path: Path, phone: Phone, seed: int, scenario: str = "lab") -> None:
    """Write one phone's recording with its claims."""
    slow = _slowed(phone)
    simulation = simulate(load_scenario(scenario), slow, seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    gyroscope, claims = slow.gyro is not None, msgspec.convert(slow.claimed(), Claims)
    with TraceWriter(path, gyroscope=gyroscope, temperature=False, arrival=False, claims=claims) as writer:
        for chunk in simulation.chunks():
            writer.write(chunk.accelerometer, chunk.gyroscope, chunk.events)


def fleet(folder: Path, phones: int, seed: int = 0, bad: int = 0, scenario: str = "lab") -> list[Path]:
    """Write `phones` recordings and after them `bad` that cannot be read; return the readable ones' paths."""
    drawn = population(phones, seed)
    paths = [folder / _name(phone, i) for i, phone in enumerate(drawn)]
    for i, (path, phone) in enumerate(zip(paths, drawn, strict=True)):
        recording(path, phone, seed + i, scenario)
    for i in range(bad):
        spoilt = folder / "Spoilt" / f"phone-{i:04d}" / "recording.csv"
        spoilt.parent.mkdir(parents=True, exist_ok=True)
        spoilt.write_text("t,ax,ay,az\n0.0,0.1,0.2,9.8\n0.1,nan,0.2,9.8\n0.2,0.1,0.2,9.8\n")
    return paths


def _name(phone: Phone, number: int) -> Path:
    model = (phone.claims.device or "unknown").replace(" ", "-")
    return Path(model) / f"phone-{number:04d}" / "recording.csv"


def _slowed(phone: Phone) -> Phone:
    sensors = {k: getattr(phone, k) for k in ("accel", "gyro")}
    slow = {k: msgspec.structs.replace(s, rate_hz=RATE_HZ) for k, s in sensors.items() if s is not None}
    claims = msgspec.structs.replace(phone.claims, nominal_rate_hz=RATE_HZ)
    return msgspec.structs.replace(phone, claims=claims, **slow)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--phones", default=200, type=click.IntRange(1), show_default=True)
@click.option(
    "--bad", default=5, type=click.IntRange(0), show_default=True, help="Unreadable recordings besides."
)
@click.option("--seed", default=0, type=click.IntRange(0), show_default=True)
def main(folder: Path, phones: int, bad: int, seed: int) -> None:
    """Write a fleet of simulated phones to FOLDER."""
    with progress("simulating", phones, quiet=False) as step:
        for number, phone in enumerate(population(phones, seed)):
            recording(folder / _name(phone, number), phone, seed + number)
            step(number + 1)
    fleet(folder, 0, seed, bad)
    click.echo(f"{folder}: {phones} phones, {bad} unreadable recordings")


if __name__ == "__main__":
    main()
