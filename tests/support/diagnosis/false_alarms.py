"""False alarms end to end: simulated phones of several noise families with no effect, whole diagnosis.

    python -m tests.support.diagnosis.false_alarms --trials 10 [--seed 1] [--minutes 60]

Scenarios, rates, thermometer and wander are drawn; prints each alarm and the rate per family with its
Clopper-Pearson 95 % upper bound.
"""

from __future__ import annotations

import argparse

import msgspec
import numpy as np
from scipy.stats import beta

from stillcal.replay.phone.phone import Phone, load_phone
from stillcal.replay.phone.settings import Noise, Wandering
from tests.support.diagnosis import trials

FAMILIES = ("white", "flicker", "gauss_markov", "random_walk", "mixture")
WALK = {"accel": 1.5e-4, "gyro": 8e-6}


def noise(rng: np.random.Generator, family: str, own: Noise, sensor: str) -> Noise:
    """Draw the wander of one sensor; white noise stays the phone's own."""
    white = float(np.max(own.white))
    size = white * 10 ** rng.uniform(-1.0, 0.5)
    flicker = size * 0.5 if family in ("flicker", "mixture") else 0.0
    gm = (
        (Wandering(sigma=size, tau_s=float(10 ** rng.uniform(1.3, 3.3))),)
        if family in ("gauss_markov", "mixture")
        else ()
    )
    walk = WALK[sensor] * float(rng.uniform(0.1, 1.0)) if family in ("random_walk", "mixture") else 0.0
    return Noise(white=own.white, flicker=flicker, gauss_markov=gm, random_walk=walk)


def drawn_phone(rng: np.random.Generator, family: str) -> Phone:
    """Return the typical phone with other noise."""
    phone = load_phone("typical")
    accel = msgspec.structs.replace(phone.accel, noise=noise(rng, family, phone.accel.noise, "accel"))
    gyro = msgspec.structs.replace(phone.gyro, noise=noise(rng, family, phone.gyro.noise, "gyro"))
    return msgspec.structs.replace(phone, accel=accel, gyro=gyro)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--scenarios", default="tables")
    parser.add_argument("--families", default=",".join(FAMILIES))
    options = parser.parse_args()
    for family in options.families.split(","):
        alarms = 0
        for trial in range(options.trials):
            rng = np.random.default_rng([options.seed, trial, FAMILIES.index(family)])
            scenario = str(rng.choice(options.scenarios.split(",")))
            rate, thermometer = float(rng.choice([25.0, 50.0])), bool(rng.random() < 0.5)
            phone = drawn_phone(rng, family)
            answer, seconds = trials.run(
                scenario, phone, options.minutes, rate, int(rng.integers(1 << 31)), thermometer
            )
            alarms += bool(answer.findings)
            if answer.findings:
                trials.show(
                    f"  {family} {trial} {scenario} {rate} thermometer={thermometer}", answer, seconds
                )
        upper = beta.ppf(0.975, alarms + 1, options.trials - alarms) if alarms < options.trials else 1.0
        print(f"{family:14s} {alarms} of {options.trials}, upper bound {upper:.3f}", flush=True)


if __name__ == "__main__":
    main()
