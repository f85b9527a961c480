"""Low-passes of the kinds that chips, drivers and programs have: what of noise each leaves, and its delay."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from stillcal.calib_core.arrays import Array

ORDERS = (1, 2, 3, 4, 6, 8)

RARE = (3, 6, 8)
"""Orders that are told only where no other one fits as well: noise hardly parts them from others."""

PASSES = (2, 3)
"""How often a first-order low-pass may follow another one like it, as where software smooths twice."""

FASTER = (1, 2, 4, 16)
"""Times the sample rate at which a sensor filters: at the last its filter is as good as analogue."""

BELL_LATE = (1.1, 0.0, 2.2)
"""Delays, times 1 / (2 pi cutoff), of a filter whose power falls as a bell curve, the middle one first: none
of one that smooths afterwards, 2.2 of a Bessel low-pass of the fourth order, which has nearly this power."""


@dataclass(frozen=True, slots=True, eq=False)
class Kind:
    """Low-passes of one kind, each halving the power at its cutoff (C,).

    shapes: (C, F) of power, 1 at low frequency; late: (C,) s, how much it delays slow motion; order: of the
    Butterworth low-pass that is most like it; common: whether it goes before others that fit as well.
    """

    order: int
    shapes: Array
    late: Array
    common: bool = True


def kinds_of(f: Array, cutoffs: Array, rate: float) -> list[Kind]:
    """Return filters of cutoffs (C,) Hz at frequencies f (F,) Hz: analogue, bilinear, averages and means."""
    below = np.minimum(f, 0.4999 * rate)
    ratio = f[None, :] / cutoffs[:, None]
    turn = 2.0 * np.pi * cutoffs
    analogue = [
        Kind(n, 1.0 / (1.0 + ratio ** (2 * n)), 1.0 / (turn * np.sin(np.pi / (2 * n))), n not in RARE)
        for n in ORDERS
    ]
    late = [n * np.sqrt(2.0 ** (1.0 / n) - 1.0) / turn for n in PASSES]
    repeated = [Kind(2, _repeated(ratio, n), by, False) for n, by in zip(PASSES, late, strict=True)]
    bilinear = [_bilinear(f, cutoffs, rate, times, n) for times, n in product(FASTER, ORDERS)]
    averages = [_exponential(below / rate, cutoffs / rate, rate, n) for n in (1, *PASSES)]
    bell = [Kind(2, 2.0 ** -(ratio**2), by / turn, False) for by in BELL_LATE]
    return [*analogue, *bilinear, *averages, *repeated, *bell, _moving_mean(f / rate, cutoffs / rate, rate)]


def _repeated(ratio: Array, passes: int) -> Array:
    """Return the power behind so many first-order low-passes, half of it at a ratio of 1."""
    return np.asarray((1.0 + (2.0 ** (1.0 / passes) - 1.0) * ratio**2) ** -float(passes))


def _exponential(f: Array, cutoffs: Array, rate: float, passes: int) -> Kind:
    """Return exponential averages, y[n] = (1 - a) x[n] + a y[n - 1]. f, cutoffs: parts of the rate.

    They are of the first order and go as the sine; each delays by a / (1 - a) samples.
    """
    at_cutoff = np.sin(np.pi * cutoffs)
    edge = at_cutoff / np.sqrt(2.0 ** (1.0 / passes) - 1.0)
    root = np.sqrt(1.0 + edge**2) - edge
    shapes = _repeated(np.sin(np.pi * f)[None, :] / at_cutoff[:, None], passes)
    return Kind(min(passes, 2), shapes, passes * root / (2.0 * edge * rate), passes == 1)


def _moving_mean(f: Array, cutoffs: Array, rate: float) -> Kind:
    """Return means of the last n samples. f, cutoffs: parts of the rate.

    A Hann window spreads what is beside a zero of the filter into it.
    """
    few, many = np.ones_like(cutoffs), 1.0 / cutoffs
    for _ in range(40):
        middle = 0.5 * (few + many)
        more = _mean_power(cutoffs, middle) > 0.5
        few, many = np.where(more, middle, few), np.where(more, many, middle)
    sides = [_mean_power(np.abs(f + k * f[1])[None, :], few[:, None]) for k in (-1, 0, 1)]
    shapes = sides[1] * 2.0 / 3.0 + (sides[0] + sides[2]) / 6.0
    return Kind(2, shapes, (few - 1.0) / (2.0 * rate), False)


def _mean_power(f: Array, many: Array) -> Array:
    """Return the power that the mean of so many samples leaves at f, parts of the rate."""
    phase = np.pi * np.maximum(f, 1e-9)
    return np.asarray((np.sin(many * phase) / (many * np.sin(phase))) ** 2)


def _bilinear(f: Array, cutoffs: Array, rate: float, times: int, order: int) -> Kind:
    """Return bilinear filters at `times` the rate.

    Of such samples every so-many-th is read: what the filter leaves beyond half the rate folds back.
    """
    k = np.arange(times)
    images = np.where(k % 2 == 0, 1.0, -1.0)[:, None] * f + (k[:, None] + 1) // 2 * rate
    warped = np.tan(np.pi * np.minimum(images, 0.4999 * times * rate) / (times * rate))
    edge = np.tan(np.pi * cutoffs / (times * rate))
    power = (1.0 / (1.0 + (warped / edge[:, None, None]) ** (2 * order))).sum(axis=1)
    late = 1.0 / (2.0 * times * rate * edge * np.sin(np.pi / (2 * order)))
    return Kind(order, np.asarray(power / power[:, :1]), late, order not in RARE)
