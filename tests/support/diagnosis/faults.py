"""Faults for `hours`: what one thing gone wrong does to a played hour.

Each returns a function of `Played`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import butter, lfilter

from tests.support.diagnosis.hours import Fault, Played


def louder(sensor: str, ratio: Sequence[float]) -> Fault:
    """White noise `ratio` times its own, by axis."""

    def fault(p: Played) -> None:
        p.white[sensor] = p.white[sensor] * np.asarray(ratio)

    return fault


def tailed(sensor: str, ratio: float, fraction: float) -> Fault:
    """Part of the white noise is `ratio` times wider."""

    def fault(p: Played) -> None:
        p.white[sensor] *= np.where(p.rng.random(p.white[sensor].shape) < fraction, ratio, 1.0)

    return fault


def student(sensor: str, freedom: float) -> Fault:
    """White noise of Student's t, of the same variance."""

    def fault(p: Played) -> None:
        sd = p.white[sensor].std(axis=0)
        p.white[sensor] = (
            sd * p.rng.standard_t(freedom, p.white[sensor].shape) / np.sqrt(freedom / (freedom - 2))
        )

    return fault


def filtered(sensor: str, cutoff: float, order: int = 2) -> Fault:
    """Low-pass signal and noise."""

    def fault(p: Played) -> None:
        b, a = butter(order, cutoff, fs=p.hour.rate)
        both = p.values[sensor] + p.white[sensor]
        first = both[0]
        p.values[sensor] = np.asarray(lfilter(b, a, both - first, axis=0)) + first
        p.white[sensor] = np.zeros_like(both)

    return fault


def tone(
    sensor: str, frequency: float, amplitude: Sequence[float], span: tuple[float, float] = (0, 1e9)
) -> Fault:
    """A sine while it lasts."""

    def fault(p: Played) -> None:
        on = (p.t >= span[0]) & (p.t < span[1])
        p.values[sensor] = p.values[sensor] + np.outer(on * np.sin(2 * np.pi * frequency * p.t), amplitude)

    return fault


def coarse(sensor: str, step: float) -> Fault:
    """Round to a step; noise that comes after hides it."""

    def fault(p: Played) -> None:
        p.values[sensor] = np.round(p.values[sensor] / step) * step

    return fault


def clipped(sensor: str, limit: float) -> Fault:
    """Stop at a limit."""

    def fault(p: Played) -> None:
        p.values[sensor] = np.clip(p.values[sensor], -limit, limit)

    return fault


def skewed(relative: float, *, own: bool) -> Fault:
    """The clock fast; own: stamps are its own (nominal), else true times of a sensor that is fast."""

    def fault(p: Played) -> None:
        if own:
            p.arrival = p.arrival / (1.0 + relative)
        else:
            p.arrival, p.stamp = p.arrival / (1.0 + relative), p.stamp / (1.0 + relative)

    return fault


def jittered(sigma: float, *, walk: bool = False) -> Fault:
    """Stamps scatter; walk: intervals do."""

    def fault(p: Played) -> None:
        off = sigma * p.rng.normal(size=p.t.size)
        p.stamp = np.sort(np.maximum(p.stamp + (np.cumsum(off) if walk else off), 0.0))

    return fault


def dropped(fraction: float) -> Fault:
    """Lose samples at random."""

    def fault(p: Played) -> None:
        p.keep &= p.rng.random(p.t.size) >= fraction

    return fault


def stalled(fraction: float, length: float = 0.3) -> Fault:
    """Deliver nothing for `length` s now and then, for a share of the time."""

    def fault(p: Played) -> None:
        count = round(fraction * p.hour.duration / length)
        for begin in p.hour.duration / count * (np.arange(count) + p.rng.uniform(0, 0.9, count)):
            rows = slice(*np.searchsorted(p.t, (begin, begin + length)))
            p.arrival[rows] = np.maximum(p.arrival[rows], begin + length)

    return fault


def late(delay: float) -> Fault:
    """The gyroscope tells of motion `delay` s ago."""

    def fault(p: Played) -> None:
        p.rate = np.stack([np.interp(p.t - delay, p.t, p.rate[:, a]) for a in range(3)], axis=1)

    return fault


def arm(position: Sequence[float]) -> Fault:
    """The accelerometer sits off the point that the phone turns about."""

    def fault(p: Played) -> None:
        r = np.asarray(position)
        p.force = p.force + np.cross(p.rate, np.cross(p.rate, r)) + np.cross(p.rate_dot, r)

    return fault


def held(sensor: str, fraction: float, run: int = 1) -> Fault:
    """Part of the samples repeats the one before, `run` at a time."""

    def fault(p: Played) -> None:
        starts = p.rng.random(p.t.size) < fraction / run
        stuck = np.convolve(starts, np.ones(run))[: p.t.size] > 0
        source = np.maximum.accumulate(np.where(stuck, 0, np.arange(p.t.size)))
        p.values[sensor] = p.values[sensor][source]

    return fault


def changed(sensor: str, span: tuple[float, float], matrix: Sequence[Sequence[float]]) -> Fault:
    """For a while the axes are mixed by a matrix: swapped, flipped, of another gain."""

    def fault(p: Played) -> None:
        rows = (p.t >= span[0]) & (p.t < span[1])
        p.values[sensor][rows] = p.values[sensor][rows] @ np.asarray(matrix, dtype=float).T

    return fault


def spiked(sensor: str, axis: int, size: float, per_hour: float) -> Fault:
    """Single samples of one axis are off by a fixed size."""

    def fault(p: Played) -> None:
        hit = p.rng.random(p.t.size) < per_hour / 3600.0 / p.hour.rate
        p.values[sensor][hit, axis] += size * p.rng.choice([-1.0, 1.0], int(hit.sum()))

    return fault


def swaying(size: float, frequency: float, harmonics: int = 1, spread: float = 0.05) -> Fault:
    """A chest under the phone: it heaves (m/s^2) and tilts, not quite evenly; heartbeats have harmonics."""

    def fault(p: Played) -> None:
        n = p.t.size
        pace = frequency * (1 + spread * np.cumsum(p.rng.normal(size=n)) / np.sqrt(n))
        phase = 2 * np.pi * np.cumsum(pace) / p.hour.rate
        wave = sum(np.sin(k * phase) / k for k in range(1, harmonics + 1))
        tilt = 0.3 * size / 9.8 * wave
        axis = np.array([0.8, 0.6, 0.0])
        p.rate = p.rate + np.outer(np.gradient(tilt, 1.0 / p.hour.rate), axis)
        p.force = p.force + size * wave[:, None] * p.up + 9.8 * np.outer(tilt, [0.6, -0.8, 0.0])

    return fault


def driven(size: float) -> Fault:
    """A vehicle: broad shaking of both sensors that comes and goes.

    And an engine that never keeps its pace.
    """

    def fault(p: Played) -> None:
        n, rate = p.t.size, p.hour.rate
        b, a = butter(2, [1.0, min(12.0, 0.45 * rate)], btype="band", fs=rate)
        strength = np.interp(
            p.t, np.arange(0, p.t[-1] + 60, 30.0), p.rng.uniform(0, 1, int(p.t[-1] / 30) + 3)
        )
        road = np.asarray(lfilter(b, a, p.rng.normal(size=(n, 3)), axis=0)) * strength[:, None]
        pace = 9.0 + 1.5 * np.interp(
            p.t, np.arange(0, p.t[-1] + 20, 10.0), p.rng.normal(size=int(p.t[-1] / 10) + 3)
        )
        engine = np.sin(2 * np.pi * np.cumsum(pace) / rate) * strength
        p.force = p.force + size * (road + 0.3 * engine[:, None])
        p.rate = (
            p.rate
            + 0.05 * size * np.asarray(lfilter(b, a, p.rng.normal(size=(n, 3)), axis=0)) * strength[:, None]
        )

    return fault
