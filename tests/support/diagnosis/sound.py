"""Sound phones that a sceptic would try: hours in which nothing is wrong, by kind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.model.records import Claims
from tests.support.diagnosis.faults import driven, dropped, swaying
from tests.support.diagnosis.hours import G, Hour, with_fault

Drawn = Callable[[np.random.Generator], Hour]


def plain(rng: np.random.Generator) -> Hour:
    """Draw a phone of some density, rate and step, exactly as claimed."""
    rate = float(rng.choice([25.0, 50.0]))
    density = {"accel": 10 ** rng.uniform(-3.0, -2.3), "gyro": 10 ** rng.uniform(-4.1, -3.4)}
    lsb = {s: float(d * np.sqrt(rate / 2) * rng.uniform(0.02, 0.9)) for s, d in density.items()}
    return Hour(rate=rate, density=density, lsb=lsb, jitter=float(rng.uniform(0.0, 0.02)))


def _coarse(rng: np.random.Generator) -> Hour:
    hour = plain(rng)
    times = float(rng.uniform(0.8, 6.0))
    return replace(hour, lsb={s: d * np.sqrt(hour.rate / 2) * times for s, d in hour.density.items()})


def _printed(rng: np.random.Generator) -> Hour:
    hour = plain(rng)
    return replace(hour, decimals=(int(rng.choice([4, 5, 6])), int(rng.choice([3, 4, 6]))), jitter=0.0)


def _odd_rate(rng: np.random.Generator) -> Hour:
    return replace(plain(rng), rate=float(rng.choice([30.0, 33.3, 48.0])), decimals=(6, 3), jitter=0.0)


def _rough_claims(rng: np.random.Generator) -> Hour:
    return replace(plain(rng), level=float(rng.uniform(0.9, 1.1)), axes=0.05)


def _two_sided(rng: np.random.Generator) -> Hour:
    """Density in the convention of continuous-time models: sd = density sqrt(rate)."""
    return replace(plain(rng), level=float(np.sqrt(2.0)))


def _slow_delivery(rng: np.random.Generator) -> Hour:
    return replace(plain(rng), latency=float(rng.uniform(0.002, 0.006)))


def _swaying(rng: np.random.Generator) -> Hour:
    hour = replace(plain(rng), rests=(100.0, 400.0), attitudes=4)
    if rng.random() < 0.5:
        return with_fault(hour, "before", swaying(rng.uniform(0.01, 0.06), rng.uniform(0.2, 0.35)))
    return with_fault(hour, "before", swaying(rng.uniform(0.005, 0.03), rng.uniform(1.0, 1.4), harmonics=5))


KINDS: dict[str, Drawn] = {
    "plain": plain,
    "flicker": lambda rng: replace(plain(rng), wander=4.0),
    "coarse steps, declared": _coarse,
    "printed digits": _printed,
    "odd rate, ms stamps": _odd_rate,
    "claims 10 % off, axes 5 %": _rough_claims,
    "two-sided density": _two_sided,
    "clock 100 ppm": lambda rng: replace(plain(rng), skew=float(rng.uniform(-1e-4, 1e-4))),
    "stamps scatter by 1 to 3 %": lambda rng: replace(plain(rng), jitter=float(rng.uniform(0.01, 0.029))),
    "slow delivery": _slow_delivery,
    "few drops": lambda rng: with_fault(plain(rng), "on_clock", dropped(2e-4)),
    "no claims, no arrival": lambda rng: replace(plain(rng), claims=Claims(gravity=G), arrives=False),
    "rests all hour": lambda rng: replace(plain(rng), rests=(4000.0, 4001.0)),
    "two rests": lambda rng: replace(plain(rng), rests=(1300.0, 2000.0), attitudes=3),
    "handled half the time": lambda rng: replace(plain(rng), handled=0.97, rests=(40.0, 120.0)),
    "breathing or heart": _swaying,
    "vehicle": lambda rng: with_fault(plain(rng), "before", driven(float(10 ** rng.uniform(-2, -0.3)))),
    "no thermometer": lambda rng: replace(plain(rng), thermometer=False),
}
"""Kinds of sound phones, by what is said of them."""
