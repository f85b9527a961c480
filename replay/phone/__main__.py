"""`python -m stillcal.replay.phone [SCENARIO ...]`: the figures of docs/phone.md, computed again.

For each scenario, over several seeds: rests of 10 s or more, their share of the time, attitudes more than 8
degrees apart, and how well these determine nine parameters; then the processor time that it takes to record.
"""

from __future__ import annotations

import math
import time

import click
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.phone import Phone, Scenario, load_phone, load_scenario, simulate

LEAST_REST_S = 10.0
APART = math.radians(8.0)


def distinct(ups: Array) -> Array:
    """Return those of the directions (n, 3) that lie more than APART from all returned before them."""
    distinct_ups: list[Array] = []
    for up in ups:
        if all(up @ other <= math.cos(APART) for other in distinct_ups):
            distinct_ups.append(up)
    return np.array(distinct_ups).reshape(-1, 3)


def determination(ups: Array) -> float:
    """Return the smallest singular value of the design of bias and symmetric scale (n, 9); 0 for too few."""
    x, y, z = ups.T
    design = np.column_stack([ups, x * x, y * y, z * z, x * y, x * z, y * z])
    return 0.0 if len(ups) < 9 else float(np.linalg.svd(design, compute_uv=False)[-1])


def variety(scenario: Scenario, seed: int) -> tuple[float, float, float, float]:
    """Return number of rests, their share of the time, number of attitudes, and their determination."""
    simulation = simulate(scenario, Phone(), seed)
    rests = [r for r in simulation.truth.rests if r.t_end - r.t_start >= LEAST_REST_S]
    ups = distinct(np.array([r.up for r in rests]).reshape(-1, 3))
    share = sum(r.t_end - r.t_start for r in rests) / simulation.duration
    return len(rests), share, len(ups), determination(ups)


@click.command()
@click.argument("names", nargs=-1)
@click.option("--phone", default="typical", show_default=True, help="Phone to record with.")
@click.option("--seeds", default=8, show_default=True, help="Number of seeds to look at.")
def report(names: tuple[str, ...], phone: str, seeds: int) -> None:
    """Print how varied the rests of the ready scenarios are, and the processor time to simulate them."""
    for name in names or ("lab", "tables", "desk", "night", "day"):
        scenario = load_scenario(name)
        spans = np.array([variety(scenario, seed) for seed in range(seeds)])
        low, high = spans.min(axis=0), spans.max(axis=0)
        begin, count = time.process_time(), 0
        for chunk in simulate(scenario, load_phone(phone), 0).chunks():
            count += len(chunk.accelerometer)
        spent = time.process_time() - begin
        click.echo(
            f"{name:8} rests {low[0]:.0f}-{high[0]:.0f}, share {low[1]:.2f}-{high[1]:.2f}, "
            f"attitudes {low[2]:.0f}-{high[2]:.0f}, determination {low[3]:.2f}-{high[3]:.2f}; "
            f"{phone}: {count} samples in {spent:.1f} s"
        )


if __name__ == "__main__":
    report()
