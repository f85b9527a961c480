"""What a thermometer that fails costs, on the simulated lives of truth.py, beside one withheld all along.

`python benchmarks/truth_thermometer.py --phones 4 --days 2.5 --since 1.2` prints the errors at all moments
after the failure, every ten minutes. A life takes one to two minutes for each row of the table.
"""

# ruff: noqa: I001 - truth.py sets the number of threads, which is read when numpy is first imported

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

from truth import (
    DAY_S,
    EVERY_S,
    SEED,
    Warmth,
    error_of,
    read_every_minute,
    told_by,
    without_thermometer,
)
from truth_phones import live

import click
import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.phone import Chunk

JUMPS_EVERY_S, JUMPS_K, LIES_BY_K = 7200.0, 10.0, 40.0
_JUMPS = np.random.default_rng(7).uniform(-JUMPS_K, JUMPS_K, 2000)

Reads = Callable[[Array, Array, float], Array]
"""What a thermometer shows (n,) at times (n,) s and true temperatures (n,) degC; last: before it failed."""

SHOWN: dict[str, Reads] = {
    "freezes": lambda t, celsius, last: np.full(len(t), last),
    "lies by 40 K": lambda t, celsius, last: celsius + LIES_BY_K,
    "jumps": lambda t, celsius, last: celsius + _JUMPS[(t / JUMPS_EVERY_S).astype(int)],
}
KINDS = ("works", "withheld all along", "stops", *SHOWN)


def read(chunk: Chunk, kind: str, failed: bool, last: float) -> Chunk:
    """Return a chunk as a thermometer of this kind reads it. last: degC, its last reading that was true."""
    if kind == "withheld all along" or (kind == "stops" and failed):
        return without_thermometer(chunk)
    if kind not in SHOWN or not failed:
        return chunk
    accel, gyro = (
        samples
        if samples is None or samples.temperature is None
        else replace(samples, temperature=frozen(SHOWN[kind](samples.t, samples.temperature, last)))
        for samples in (chunk.accelerometer, chunk.gyroscope)
    )
    assert accel is not None
    return replace(chunk, accelerometer=accel, gyroscope=gyro)


def lived(of: tuple[int, str], seed: int, days: float, since_s: float) -> list[tuple[str, float, float]]:
    """Return sensor, error (mg or deg/s) and share of 95 % intervals that hold at each moment of a life."""
    number, kind = of
    life, engine, rows, last = live(number, seed, days), Engine(EngineSettings()), [], 20.0
    for true_chunk in life.simulation.chunks(EVERY_S):
        failed = true_chunk.t_end > since_s
        chunk = read(true_chunk, kind, failed, last)
        accel, t, celsius = chunk.accelerometer, chunk.t_end, None
        if accel.temperature is not None:
            celsius = float(accel.temperature[-1])
            last = last if failed else celsius
        assert chunk.gyroscope is not None
        engine.feed(*read_every_minute(chunk), chunk.gyroscope, accel, *chunk.events)
        record = engine.present.record
        if record is None or record.accelerometer is None or not failed:
            continue
        for sensor in Sensor:
            for told in told_by(kind, record, sensor, t, Warmth.of(engine, t, celsius)):
                true, step = life.bias_at(sensor, t), engine.present.suspected.get(sensor)
                stated = np.hypot(told.stated, 0.0 if step is None else step.uncertainty)
                holds = float((np.abs(true - told.bias) <= 1.96 * stated).mean())
                rows.append((str(sensor), error_of(told, life, true), holds))
    return rows


def line(name: str, rows: Iterable[tuple[str, float, float]]) -> str:
    """Return a row of the table."""
    cells = [name]
    for sensor in Sensor:
        own = np.array([row[1:] for row in rows if row[0] == sensor])
        median, high = np.quantile(own[:, 0], (0.5, 0.95))
        cells += [f"{median:.3g}", f"{high:.3g}", f"{100 * own[:, 1].mean():.0f} %"]
    return f"| {' | '.join(cells)} |"


@click.command()
@click.option("--phones", default=4, show_default=True)
@click.option("--days", default=2.5, show_default=True)
@click.option("--since", default=1.2, show_default=True, help="Day of the failure.")
@click.option("--seed", default=SEED, show_default=True)
@click.option("--jobs", default=1, show_default=True)
@click.option("--kind", "kinds", multiple=True, type=click.Choice(KINDS), default=KINDS, help="Rows; all.")
def main(phones: int, since: float, jobs: int, kinds: tuple[str, ...], **life: Any) -> None:
    """Print the rows of each life, and one of each kind for all of them."""
    both = [f"{sensor} {what}" for sensor in Sensor for what in ("median", "95th percentile", "hold")]
    click.echo(f"| life, thermometer | {' | '.join(both)} |\n|{'---|' * 7}")
    tasks = [(number, kind) for number in range(phones) for kind in kinds]
    every: dict[str, list[tuple[str, float, float]]] = {kind: [] for kind in kinds}
    with ProcessPoolExecutor(jobs) as pool:
        lives = pool.map(partial(lived, since_s=since * DAY_S, **life), tasks)
        for (number, kind), rows in zip(tasks, lives, strict=True):
            every[kind] += rows
            click.echo(line(f"{number}, {kind}", rows))
    for kind, rows in every.items():
        click.echo(line(f"all, {kind}", rows))


if __name__ == "__main__":
    main()
