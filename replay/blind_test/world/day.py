"""True motion and surroundings of a phone, by sample or by bin: plain records, no physics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array

MARGIN_S = 1.0
"""Time left out at both ends of a rest, s."""

EARTH = 7.292115e-5
"""Rotation of the Earth, rad/s (WGS 84)."""

WIDTH_S, MOST_BINS = 10.0, 200
"""Length of a bin in s, and the number beyond which bins are made longer."""


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """True motion and surroundings at times t (n,) s.

    force, rate, rate_dot: (n, 3) specific force m/s^2, angular rate rad/s and its derivative, in body axes.
    north: (n, 3) one fixed horizontal direction of the ground, in body axes; during rests only it is exact.
    temperature: (n,) degC. charging: (n,) 0 or 1. drive: (k, 2) times in s and heating from then on.
    rests: (r, 2) s, beginnings and ends. turns: (q, 6) begin, end, axis in the body; empty where unknown.
    """

    t: Array
    force: Array
    rate: Array
    rate_dot: Array
    north: Array
    temperature: Array
    charging: Array
    drive: Array
    rests: Array
    turns: Array

    @property
    def duration(self) -> float:
        """Time of the last sample, s."""
        return float(self.t[-1])

    def rest_of(self, t: Array) -> Array:
        """Return which rest each time belongs to, -1 for none."""
        index = np.searchsorted(self.rests[:, 0] + MARGIN_S, t, side="right") - 1
        inside = (index >= 0) & (t <= self.rests[np.maximum(index, 0), 1] - MARGIN_S)
        return np.where(inside, index, -1).astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """A world averaged over m bins within rests.

    width: s. t: (m,) s, centres. rest: (m,) number of the rest. since: (m,) s since its start. The other
    fields are as in World.
    """

    width: float
    t: Array
    rest: Array
    force: Array
    north: Array
    temperature: Array
    charging: Array
    drive: Array
    since: Array


Felt = World | Bins


def binned(world: World) -> Bins:
    """Cut a world's rests into bins of 10 s, or of 1/200 of it where that is longer."""
    width = max(WIDTH_S, world.duration / MOST_BINS)
    centres, rests = _centres(world, width)
    begin = world.rests[rests.astype(np.int64), 0]
    force, north, temperature, charging = (
        averaged(world, centres, width, v)
        for v in (world.force, world.north, world.temperature, world.charging)
    )
    return Bins(width, centres, rests, force, north, temperature, charging, world.drive, centres - begin)


def averaged(world: World, centres: Array, width: float, values: Array) -> Array:
    """Return the means (m, ...) of samples (n, ...) over `width` s about centres (m,) s."""
    sums = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    first, last = np.searchsorted(world.t, np.stack([centres - width / 2.0, centres + width / 2.0]))
    counts = np.maximum(last - first, 1).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((sums[last] - sums[first]) / counts)


def over_bins(world: World, bins: Bins, values: Array) -> Array:
    """Return the means (m, ...) of samples (n, ...) over bins."""
    return averaged(world, bins.t, bins.width, values)


def _centres(world: World, width: float) -> tuple[Array, Array]:
    centres, rests = [], []
    for index, (begin, end) in enumerate(world.rests):
        count = int((end - begin - 2.0 * MARGIN_S) // width)
        centres.append(begin + MARGIN_S + width * (np.arange(count) + 0.5))
        rests.append(np.full(count, float(index)))
    return np.concatenate(centres), np.concatenate(rests)


def lagged(drive: Array, tau: float, t: Array) -> Array:
    """Return the first-order response at times t (n,) s to a drive in steps (k, 2), settled at the first."""
    level = [float(drive[0, 1])]
    for (since, value), until in zip(drive[:-1], drive[1:, 0], strict=True):
        level.append(value + (level[-1] - value) * float(np.exp(-(until - since) / tau)))
    index = np.clip(np.searchsorted(drive[:, 0], t, side="right") - 1, 0, None)
    value = drive[index, 1]
    after = np.maximum(t - drive[index, 0], 0.0)
    return np.asarray(value + (np.array(level)[index] - value) * np.exp(-after / tau))
