"""Simulations that have none, half, all, one and a half and twice of an effect, judged and counted.

`python -m stillcal.replay.trials.comparison [--trials N] [--seed S] [--jobs N]` prints a table by effect.
Recording and simulation have other motion, other rates and other lengths; sizes are drawn. A trial counts as
undecided where the answer names no relation though the simulation is wrong: the recordings may be too short.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import click
import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.diagnosis.given_simulation import judge_simulation
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording
from stillcal.replay.phone import load_phone, simulate
from stillcal.replay.phone.activities.resting import Table
from stillcal.replay.phone.phone import Phone
from stillcal.replay.phone.scenario import Scenario

SHARES = (0.0, 0.5, 1.0, 1.5, 2.0)
RATES = (25.0, 50.0)
SPANS = (1200.0, 2400.0)
"""s: lengths of a recording, a third of it warm on the charger."""


@dataclass(frozen=True, slots=True)
class Case:
    """An effect at a share of its size in the simulation, or only there where `reverse`."""

    effect: str
    share: float
    reverse: bool
    seed: int

    @property
    def expected(self) -> str:
        """The relation that is true."""
        if self.reverse:
            return "superfluous"
        return {0.0: "lacking", 0.5: "too_small", 1.0: "agreed"}.get(self.share, "too_large")


def _along(rng: np.random.Generator, size: float) -> Array:
    """Return three numbers (3,) of about that size, of either sign."""
    return np.asarray(size * rng.uniform(0.6, 1.4, 3) * rng.choice([-1.0, 1.0], 3))


Change = Callable[[dict[str, Any], Array, float], dict[str, Any]]


def _bias(sensor: str, table: dict[str, Any], size: Array, share: float) -> dict[str, Any]:
    table[sensor]["bias"] = (share * size).tolist()
    return table


def _noise(sensor: str, table: dict[str, Any], size: Array, share: float) -> dict[str, Any]:
    table[sensor]["noise"]["white"] = float(share * size[0])
    return table


def _effect(name: str, key: str, table: dict[str, Any], size: Array, share: float) -> dict[str, Any]:
    if share:
        table["effect"] = [{"name": name, key: (share * size).tolist()}]
    return table


EFFECTS: dict[str, tuple[str, str, float, Change]] = {
    "accel_bias": ("accel_bias", "accel", 0.3, partial(_bias, "accel")),
    "gyro_bias": ("gyro_bias", "gyro", 0.015, partial(_bias, "gyro")),
    "accel_noise": ("noise_level", "accel", 0.0015, partial(_noise, "accel")),
    "gyro_noise": ("noise_level", "gyro", 0.00012, partial(_noise, "gyro")),
    "accel_bias_temperature": (
        "accel_bias_temperature", "accel", 4e-3, partial(_effect, "accel_bias_temperature", "slope"),
    ),
    "gyro_bias_temperature": (
        "gyro_bias_temperature", "gyro", 2e-4, partial(_effect, "gyro_bias_temperature", "slope"),
    ),
}  # fmt: skip
"""By name: the effect as it is stated, its sensor, a usual size (SI), and its place."""


def _phone(case: Case, share: float, rate: float) -> Phone:
    _, _, usual, change = EFFECTS[case.effect]
    size = _along(np.random.default_rng([case.seed, 1]), usual)
    table = msgspec.to_builtins(load_phone("typical"))
    for sensor in ("accel", "gyro"):
        table[sensor]["rate_hz"] = rate
    table["heat"] = {"charge_k": 8.0, "slow_tau_s": 200.0, "thermometer_lsb_c": 0.05}
    if case.effect.endswith("noise"):
        size = np.abs(size)
    return msgspec.convert(change(table, size, share), type=Phone)


def _recorded(phone: Phone, span: float, seed: int, name: str) -> Recording:
    parts = [
        Table(duration_s=span / 3.0, rest_s=(20.0, 60.0), look=0.0, use=float(warm), charging=warm)
        for warm in (False, True, False)
    ]
    whole = simulate(Scenario(segments=tuple(parts)), phone, seed).whole()
    return replace(
        Recording(whole.accelerometer, whole.gyroscope, list(whole.events), Claims(), []), name=name
    )


def judged_case(case: Case) -> tuple[Case, str]:
    """Return the relation that the answer states of the case's effect, "agreed", or "undecided"."""
    rng = np.random.default_rng([case.seed, 2])
    rates, spans = rng.permutation(RATES), rng.permutation(SPANS)
    shares = (0.0, 1.0) if case.reverse else (1.0, case.share)
    real, sim = (
        _recorded(_phone(case, share, float(rate)), float(span), case.seed + i, name)
        for i, (share, rate, span, name) in enumerate(
            zip(shares, rates, spans, ("real.csv", "sim.csv"), strict=True)
        )
    )
    answer = judge_simulation(real, sim).answer
    effect, sensor, _, _ = EFFECTS[case.effect]
    stated = [f["relation"] for f in answer["findings"] if (f["effect"], f["sensor"]) == (effect, sensor)]
    if stated:
        return case, stated[0]
    return case, "agreed" if case.expected == "agreed" else "undecided"


def cases(trials: int, seed: int) -> list[Case]:
    """Return the cases: effects and shares in turn, sizes by their seeds."""
    kinds = [(e, s, False) for e in EFFECTS for s in SHARES] + [(e, 1.0, True) for e in EFFECTS]
    return [Case(*kinds[i % len(kinds)], 1000 * seed + 2 * i) for i in range(trials)]


@click.command()
@click.option("--trials", type=click.IntRange(min=1), default=72)
@click.option("--seed", type=int, default=1)
@click.option("--jobs", type=click.IntRange(min=1), default=2)
def main(trials: int, seed: int, jobs: int) -> None:
    """Judge simulations and print, by effect, how many answers were right, undecided and wrong."""
    counts: dict[str, Counter[str]] = {name: Counter() for name in EFFECTS}
    with ProcessPoolExecutor(jobs) as pool:
        for done, (case, relation) in enumerate(pool.map(judged_case, cases(trials, seed)), start=1):
            kind = relation if relation in (case.expected, "undecided") else "wrong"
            counts[case.effect]["right" if kind == case.expected else kind] += 1
            if kind == "wrong":
                click.echo(f"  wrong: {case} was called {relation}", err=True)
            click.echo(f"\r{done} of {trials}", nl=False, err=True)
    click.echo("", err=True)
    click.echo(f"{'effect':26s}{'right':>7s}{'undecided':>11s}{'wrong':>7s}")
    for name, count in counts.items():
        click.echo(f"{name:26s}{count['right']:7d}{count['undecided']:11d}{count['wrong']:7d}")
    whole = sum(counts.values(), Counter())
    click.echo(f"{'all':26s}{whole['right']:7d}{whole['undecided']:11d}{whole['wrong']:7d}")


if __name__ == "__main__":
    main()
