"""Sets the threshold of the slow search: null recordings of every noise family through the whole search.

    python -m tests.support.diagnosis.threshold --trials 40 [--seed 1]

Prints for every family the largest score of each recording at some quantiles, and who raised it. The
recordings come from `nulls`, which shares no code with the estimator.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from stillcal.calib_core.diagnosis.effects.catalogue import effects_of
from stillcal.calib_core.diagnosis.model.sensor_residuals import by_sensor
from stillcal.calib_core.diagnosis.slow.search import ranking
from tests.support.diagnosis import nulls


def largest(rng: np.random.Generator, family: str) -> dict[str, tuple[float, str]]:
    """Return per sensor the best score of one null recording and the entry that has it."""
    day = nulls.schedule(rng)
    thermometer, charger = bool(rng.random() < 0.6), bool(rng.random() < 0.7)
    bins = nulls.bins_of(rng, day, family, thermometer=thermometer, charger=charger)
    best = {}
    for residuals in by_sensor(bins, nulls.G):
        ranked = ranking(residuals, effects_of(residuals.sensor))
        if ranked:
            top = ranked[0]
            note = f"{top.hypothesis.effect.name}/{top.hypothesis.effect.follows} rests={day.rest.max() + 1}"
            best[residuals.sensor] = (top.score, note)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--show", type=float, default=4.0)
    options = parser.parse_args()
    for family in nulls.FAMILIES:
        began, scores = time.perf_counter(), {"accel": [], "gyro": []}
        for trial in range(options.trials):
            rng = np.random.default_rng([options.seed, trial, nulls.FAMILIES.index(family)])
            for sensor, (value, note) in largest(rng, family).items():
                scores[sensor].append(value)
                if value > options.show:
                    print(f"    {family} {sensor} trial {trial}: {value:.2f} {note}")
        row = "  ".join(
            f"{s}: " + " ".join(f"{q:.0%}={np.quantile(v, q):.2f}" for q in (0.5, 0.9, 0.98, 1.0))
            for s, v in scores.items()
        )
        print(f"{family:12s} {row}  {(time.perf_counter() - began) / options.trials:.1f} s each", flush=True)


if __name__ == "__main__":
    main()
