"""How much of a phone's temperature charging, use and the time of day tell, where there is no thermometer.

`python benchmarks/truth_latent.py` prints, for the lives of item 7, the rms error of predicting the second
half of the temperatures by what the first half showed: by their mean alone, and by a linear fit of drivers
that reach the phone with a first-order lag. No estimator is tried: this bounds what one could gain.
"""

# ruff: noqa: E402 - the number of threads is read when numpy is first imported

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import click
import numpy as np
from truth_phones import live

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths.rms import rms

STEP_S, DAY_S = 30.0, 86400.0
LAGS_S = (120.0, 300.0, 600.0, 1200.0, 2400.0)


def lagged(drive: Array, lag_s: float) -> Array:
    """Return a driver (n,) through a first-order lag, s."""
    from scipy.signal import lfilter  # noqa: PLC0415

    keep = np.exp(-STEP_S / lag_s)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], drive))


def errors(number: int, seed: int, days: float) -> dict[str, float]:
    """Return the rms errors of one life, K, by driver; each with the lag that fits the first half best."""
    simulation = live(number, seed, days).simulation
    t = np.arange(0.0, days * DAY_S, STEP_S)
    celsius, surroundings = simulation.temperature_at(t), simulation.plan.surroundings
    charging, use = surroundings.charging.at(t), surroundings.use.at(t)
    angles = 2 * np.pi * np.outer(t / DAY_S, (1, 2))
    clock = [*np.sin(angles).T, *np.cos(angles).T]
    drivers = {
        "nothing": ([], []),
        "charging": ([charging], []),
        "charging and use": ([charging, use], []),
        "time of day": ([], clock),
        "charging and time of day": ([charging], clock),
    }
    first = t < 0.5 * t[-1]
    found = {}
    for name, (slow, plain) in drivers.items():
        tried = []
        for lag_s in LAGS_S:
            columns = np.column_stack([np.ones(t.size), *(lagged(d, lag_s) for d in slow), *plain])
            error = celsius - columns @ np.linalg.lstsq(columns[first], celsius[first], rcond=None)[0]
            tried.append([rms(error[rows]) for rows in (first, ~first)])
        found[name] = min(tried)[1]
    return found


@click.command()
@click.option("--phones", default=4, show_default=True)
@click.option("--days", default=7.0, show_default=True)
@click.option("--seed", default=1619, show_default=True)
def main(phones: int, days: float, seed: int) -> None:
    """Print the median over the lives."""
    lives = [errors(number, seed, days) for number in range(phones)]
    for name in lives[0]:
        click.echo(f"{name}: {np.median([life[name] for life in lives]):.2f} K")


if __name__ == "__main__":
    main()
