"""Rests without samples: the mean of each rest drawn at once, from the same noise that samples would have.

A sample-level day takes seconds; hundreds of phones need less. The mean over a rest is exact in
distribution for white noise, for every Gauss-Markov process (flicker's bank included) and for the random
walk, which run on from rest to rest; the sensor's low-pass passes means unchanged. Quantisation enters by
its expectation under white dither. Effects that live on single samples cannot be drawn so, and are refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.phone.activities.planner import Span, drawn, log_drawn
from stillcal.replay.phone.activities.resting import TABLE_WEIGHTS, drawn_support
from stillcal.replay.phone.effects.base import Circumstances, Effect, Moment, Term
from stillcal.replay.phone.heat import Surroundings
from stillcal.replay.phone.motion.attitudes import SUPPORTS, lying, poses
from stillcal.replay.phone.noise import GaussMarkov, seeded
from stillcal.replay.phone.phone import Phone
from stillcal.replay.phone.sensor_chain import slow_processes
from stillcal.replay.phone.settings import SensorSettings, per_axis
from stillcal.replay.phone.timeline import Steps

SPREAD = "spread"
"""Attitudes spread over the sphere as in a calibration by hand."""


@dataclass(frozen=True, slots=True, eq=False)
class RestDraws:
    """Means of n rests of one phone's accelerometer.

    forces: (n, 3) raw m/s^2. uncertainties: (n, 3) standard deviation of each mean about the model without
    noise, slow wander included; white_uncertainties: (n, 3) that part which averages out. up: (n, 3) true
    direction of gravity's reaction in body axes; true_forces: (n, 3) m/s^2. wander: (n, 3) m/s^2, the slow
    noise that went in. t, duration: (n,) s. gravity: m/s^2.
    """

    forces: Array
    uncertainties: Array
    white_uncertainties: Array
    up: Array
    true_forces: Array
    wander: Array
    t: Array
    duration: Array
    gravity: float


def _shares(gap: float, span: float, tau: float) -> tuple[float, ...]:
    """Return what a process of unit variance keeps and gains over a gap and a rest after it, both s.

    The integral over the rest and the value at its end are jointly Gaussian given that at its start
    (Gillespie 1996, Phys. Rev. E 54, 2084, Eq. 2.9-2.10).
    """
    keep = math.exp(-gap / tau)
    x = span / tau
    fall = math.exp(-x)
    var_end = 1.0 - fall**2
    covariance = (1.0 - fall) ** 2 / x
    var_mean = max(2.0 * x - 3.0 + 4.0 * fall - fall**2, 0.0) / x**2
    across = math.sqrt(max(var_mean - covariance**2 / var_end, 0.0))
    end = math.sqrt(var_end)
    return keep, math.sqrt(1.0 - keep**2), x, fall, end, covariance / end, across


def _slow_means(slow: Sequence[GaussMarkov], gap: Array, duration: Array, seed: int) -> Array:
    """Return the means of all processes but silent ones over n rests; shape (processes, n, 3).

    duration: (n,) s of the rests; gap: (n,) s before each.
    """
    loud = [(i, p) for i, p in enumerate(slow) if p.sigma.any()]
    if not loud:
        return np.zeros((0, gap.size, 3))
    sigma = np.array([p.sigma for _, p in loud])[:, None]
    sources = [seeded(seed, "rests", i) for i, _ in loud]
    now = sigma[:, 0] * [source.standard_normal(3) for source in sources]
    draws = np.array([source.standard_normal((gap.size, 3, 3)) for source in sources])
    spans = list(zip(gap, duration, strict=True))
    shares = np.array([[_shares(g, d, p.tau) for g, d in spans] for _, p in loud])
    keep, wait, x, fall, end, toward, across = np.moveaxis(shares, 2, 0)[..., None]
    waiting, first, second = np.moveaxis(draws, 2, 0)
    moved, ended = sigma * wait * waiting, sigma * end * first
    start = np.empty_like(moved)
    for i in range(gap.size):
        start[:, i] = keep[:, i] * now + moved[:, i]
        now = start[:, i] * fall[:, i] + ended[:, i]
    means: Array = start * (1.0 - fall) / x + sigma * (toward * first + across * second)
    return means


class _Walk:
    """The random walk, asked for its mean over one rest after another."""

    def __init__(self, density: Array, rng: np.random.Generator) -> None:
        self._density, self._rng, self._now = density, rng, np.zeros(3)

    def mean(self, gap: float, span: float) -> Array:
        draws = self._rng.standard_normal((3, 3))
        start = self._now + self._density * math.sqrt(gap) * draws[0]
        step = self._density * math.sqrt(span)
        self._now = start + step * draws[1]
        mean: Array = start + step * (0.5 * draws[1] + math.sqrt(1.0 / 12.0) * draws[2])
        return mean


def mean_sd(process: GaussMarkov, span: Array) -> Array:
    """Return the standard deviation of a process's mean over spans (n,) s; shape (n, 3)."""
    x = span / process.tau
    variance = 2.0 * (x + np.expm1(-x)) / x**2
    return np.outer(np.sqrt(variance), process.sigma)


def rounded_mean(value: Array, sd: Array, lsb: float) -> Array:
    """Return the expectation of a value (n, 3) rounded to multiples of lsb after dither of `sd` (3,).

    Widrow and Kollar 2008, Quantization Noise, Eq. 4.11 in series form; with little dither, plain rounding.
    """
    if lsb == 0.0:
        return value
    k = np.arange(1, 6)[:, None, None]
    waves = (-1.0) ** k / (math.pi * k) * np.sin(2.0 * math.pi * k * value / lsb)
    soft = value + lsb * np.sum(waves * np.exp(-2.0 * (math.pi * k * sd / lsb) ** 2), axis=0)
    return np.where(sd < 0.2 * lsb, np.rint(value / lsb) * lsb, soft)


def _attitudes(n: int, how: str | Array, rng: np.random.Generator) -> Array:
    if not isinstance(how, str):
        return np.asarray(how, dtype=np.float64)
    if how == SPREAD:
        return np.array([attitude[2] for attitude in poses(n, rng)])
    if how == "lying":
        return np.array([lying(drawn_support(TABLE_WEIGHTS, rng), rng)[2] for _ in range(n)])
    if how in SUPPORTS:
        return np.array([lying(SUPPORTS[how], rng)[2] for _ in range(n)])
    known = ", ".join([SPREAD, "lying", *SUPPORTS])
    raise ValueError(f"attitudes = {how!r}: must be one of {known}, or an array of up directions (n, 3)")


def _terms(phone: Phone, settings: SensorSettings, true: Array, t: Array, warmth: Array) -> Array:
    n, quiet = t.size, Steps.of([0.0], [0.0])
    moment = Moment(t, true, np.zeros((n, 3)), np.zeros((n, 3)), warmth, np.zeros(n))
    circumstances = Circumstances(settings.rate_hz, Surroundings(quiet, quiet, quiet), seeded(0))
    total = np.zeros((n, 3))
    for effect in phone.effects:
        term = _mean_term(effect, circumstances)
        total = total if term is None else total + term(moment)
    return total


def _mean_term(effect: Effect, circumstances: Circumstances) -> Term | None:
    if not effect.concerns(Sensor.ACCELEROMETER):
        return None
    if effect.needs_samples:
        raise ValueError(f"effect {effect.name} lives on single samples: simulate the phone to see it")
    return effect.output_term(Sensor.ACCELEROMETER, circumstances)


def draw_rests(
    phone: Phone,
    n: int,
    seed: int = 0,
    *,
    duration_s: Span = (20.0, 300.0),
    gap_s: Span = (2.0, 60.0),
    attitudes: str | Array = SPREAD,
    gravity: float = 9.80665,
    temperature_c: Array | None = None,
) -> RestDraws:
    """Draw the means of n rests of a phone's accelerometer.

    duration_s, gap_s: how long rests and the times between them last, drawn log-even and even. attitudes:
    "spread", "lying" as on tables, the name of a support, or up directions (n, 3) in body axes.
    temperature_c: (n,) degC, the reference where None. Raises ValueError on an effect that needs samples.
    """
    rng, settings = seeded(seed, "rests"), phone.sensor(Sensor.ACCELEROMETER)
    assert settings is not None, "every phone has an accelerometer"
    up = _attitudes(n, attitudes, rng)
    true = up * gravity
    duration = np.array([log_drawn(duration_s, rng) for _ in range(n)])
    gap = np.array([drawn(gap_s, rng) for _ in range(n)])
    t = np.cumsum(gap + duration) - duration
    warmth = np.zeros(n) if temperature_c is None else temperature_c - phone.heat.reference_c
    level = true @ np.asarray(settings.scale).T + settings.bias + _terms(phone, settings, true, t, warmth)
    slow = slow_processes(settings.noise)
    wander = _wander(slow, per_axis(settings.noise.random_walk), gap, duration, seed)
    sd = per_axis(settings.noise.white) * math.sqrt(settings.rate_hz / 2.0)
    white = np.outer(1.0 / np.sqrt(duration * settings.rate_hz), sd)
    forces = rounded_mean(level + wander, sd, settings.lsb) + white * rng.standard_normal((n, 3))
    variance = white**2 + sum((mean_sd(p, duration) ** 2 for p in slow), np.zeros((n, 3)))
    return RestDraws(forces, np.sqrt(variance), white, up, true, wander, t, duration, gravity)


def _wander(slow: list[GaussMarkov], walk: Array, gap: Array, duration: Array, seed: int) -> Array:
    total = np.zeros((gap.size, 3))
    for means in _slow_means(slow, gap, duration, seed):
        total += means
    if walk.any():
        part = _Walk(walk, seeded(seed, "rests", "walk"))
        total += [part.mean(g, d) for g, d in zip(gap, duration, strict=True)]
    return total
