"""The least error of a gyroscope's bias at a random moment: of an estimator that knows all but the bias.

It knows the true curve of temperature and the true sizes of flicker and walk of each phone of item 7, and
has a rest at every `--every` seconds, without a gap. The covariance of its error is known (Rasmussen and
Williams 2006, 2.2), and errors are drawn from it. The thermometer is exact, or read in its own steps: its
rounding at the moment then counts as independent of that of the rests, which is the worst case.
"""

# ruff: noqa: E402 - the number of threads is read when numpy is first imported

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import click
import numpy as np
from truth_phones import FLICKER_TAUS_S, PER_PROCESS, RATE_HZ, Life, Sizes, live

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Sensor

GYRO = Sensor.GYROSCOPE
REACH_S = 8 * 3600.0
"""Older rests add nothing: the walk of these phones leaves what is older behind."""

AGES, DRAWS = 6, 400
"""Moments between two rests, and errors drawn for each."""


def rest_variance(life: Life, length: float) -> float:
    """Return the variance of a rest's mean rate by white noise and rounding; length: s."""
    sensor = life.simulation.phone.sensor(GYRO)
    assert sensor is not None and sensor.lsb is not None
    white = sensor.noise.white**2 * RATE_HZ / 2.0
    return float((white + sensor.lsb**2 / 12.0) / (RATE_HZ * length))


def least_variance(sizes: Sizes, noise: float, every: float, age: float) -> float:
    """Return the variance of the best estimate of a bias, `age` (s) after the newest rest, by axis."""
    t = REACH_S - np.arange(0.0, REACH_S, every)

    def covariance(a: Array, b: Array) -> Array:
        apart = np.abs(a[:, None] - b)[..., None]
        flicker = (sizes.flicker * PER_PROCESS) ** 2 * np.exp(-apart / FLICKER_TAUS_S).sum(axis=-1)
        return np.asarray(flicker + sizes.walk**2 / 86400.0 * np.minimum(a[:, None], b) + _ANY)

    now = np.array([REACH_S + age])
    along = covariance(t, now)
    known = along.T @ np.linalg.solve(covariance(t, t) + noise * np.eye(t.size), along)
    return float((covariance(now, now) - known)[0, 0])


_ANY = 1e-4
"""rad^2/s^2: variance of the constant part, of which nothing is known before the rests."""


def errors(lives: list[Life], every: float, length: float, steps: bool) -> Array:
    """Return drawn errors, deg/s, of all phones together."""
    rng, found = np.random.default_rng(0), []
    for life in lives:
        sizes, noise = life.sizes[GYRO], rest_variance(life, length)
        step = life.simulation.phone.heat.thermometer_lsb_c if steps else 0.0
        for age in every * (np.arange(AGES) + 0.5) / AGES:
            error = np.sqrt(least_variance(sizes, noise, every, age)) * rng.standard_normal((DRAWS, 3))
            rounding = step * rng.uniform(-0.5, 0.5, DRAWS)
            found.append(np.linalg.norm(error + np.outer(rounding, sizes.slope), axis=1))
    return np.degrees(np.concatenate(found))


@click.command()
@click.option("--phones", default=8, show_default=True)
@click.option("--days", default=7.0, show_default=True, help="What a phone is depends on them.")
@click.option("--seed", default=1619, show_default=True)
@click.option("--every", default=330.0, show_default=True, help="Seconds from rest to rest.")
@click.option("--length", default=5.5, show_default=True, help="Seconds that a rest takes.")
def main(phones: int, days: float, seed: int, every: float, length: float) -> None:
    """Print median and 95th percentile."""
    lives = [live(number, seed, days) for number in range(phones)]
    for words, steps in (("exact", False), ("in its own steps", True)):
        median, high = np.quantile(errors(lives, every, length, steps), (0.5, 0.95))
        click.echo(f"thermometer {words}: median {median:.3g} deg/s, 95th percentile {high:.3g} deg/s")


if __name__ == "__main__":
    main()
