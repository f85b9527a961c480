"""Sensor noise as it is made: white at each sample, and a slow wander that does not care for samples.

The wander is a sum of first-order Gauss-Markov processes (a flicker, 1/f, is a bank of them) and a
random walk, run on a time grid of its own so that gaps, drops and rates change nothing in it, and
carried from block to block so that the length of blocks changes nothing either.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.phone.recursion import decaying

WANDER_STEP = 0.05
"""Spacing of the wander's time grid, s."""

MOST_NODES = 100_000
"""Points of this grid that are made at once: 2.4 MB for each process, however far apart the samples are."""

FLICKER_SPACING = 4.0
"""Ratio of neighbouring correlation times in the flicker bank."""

FLICKER_TAUS = tuple(0.25 * FLICKER_SPACING**k for k in range(10))
"""Correlation times of the flicker bank, s: 1/f from about 2 uHz to 0.6 Hz, below and above it flattens."""


def seeded(seed: int, *names: str | int) -> np.random.Generator:
    """Return a generator of its own for one named purpose of one seed."""
    words = [zlib.crc32(n.encode()) if isinstance(n, str) else n for n in names]
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, *words])))


def flicker_sigma(level: Array) -> Array:
    """Return the standard deviation of each process in the flicker bank for a bias instability `level`.

    A bank with equal variances and correlation times spaced by a factor r has the one-sided spectrum
    sigma^2 / (f ln r). IEEE Std 952-1997, Annex C, gives bias instability B the two-sided spectrum
    B^2 / (2 pi f), one-sided B^2 / (pi f), whose Allan deviation is flat at B sqrt(2 ln 2 / pi) = 0.664 B.
    """
    sigma: Array = level * math.sqrt(math.log(FLICKER_SPACING) / math.pi)
    return sigma


@dataclass(frozen=True, slots=True, eq=False)
class GaussMarkov:
    """A first-order Gauss-Markov process. sigma: (3,) standard deviation by axis; tau: s."""

    sigma: Array
    tau: float


def flicker_bank(level: Array) -> list[GaussMarkov]:
    """Return the Gauss-Markov processes whose sum is 1/f noise of bias instability `level` (3,)."""
    return [GaussMarkov(flicker_sigma(level), tau) for tau in FLICKER_TAUS]


class White:
    """White noise of a given standard deviation by axis, with a share of heavier-tailed samples."""

    def __init__(self, sd: Array, tail_fraction: float, tail_ratio: float, rng: np.random.Generator) -> None:
        self._sd, self._rng = sd, rng
        self._fraction, self._ratio = tail_fraction, tail_ratio

    def draw(self, n: int) -> Array:
        """Return the next (n, 3) values."""
        values = self._rng.standard_normal((n, 3)) * self._sd
        if self._fraction > 0.0:
            values *= np.where(self._rng.random((n, 3)) < self._fraction, self._ratio, 1.0)
        return values


class _Process:
    """One Gauss-Markov process, or a random walk where tau is infinite, stepping along the grid."""

    def __init__(self, process: GaussMarkov, rng: np.random.Generator) -> None:
        self._rng = rng
        self._keep = math.exp(-WANDER_STEP / process.tau)
        drive = math.sqrt(-math.expm1(-2.0 * WANDER_STEP / process.tau))
        self._drive = process.sigma * drive
        self._last = process.sigma * rng.standard_normal(3)

    def advance(self, n: int) -> Array:
        shocks = self._rng.standard_normal((n, 3)) * self._drive
        values = decaying(shocks, self._keep, self._last)
        self._last = values[-1]
        return values


class _Walk:
    """A random walk from zero. density: (3,) per sqrt(s)."""

    def __init__(self, density: Array, rng: np.random.Generator) -> None:
        self._rng = rng
        self._step = density * math.sqrt(WANDER_STEP)
        self._last = np.zeros(3)

    def advance(self, n: int) -> Array:
        steps = self._rng.standard_normal((n, 3)) * self._step
        steps[0] += self._last
        values: Array = np.cumsum(steps, axis=0)
        self._last = values[-1]
        return values


class Wander:
    """The sum of slow noises, read at rising times. Times before the last one read cannot be read again."""

    def __init__(
        self, processes: Sequence[GaussMarkov], walk_density: Array, seed: int, *names: str | int
    ) -> None:
        self._parts: list[_Process | _Walk] = [
            _Process(p, seeded(seed, *names, "wander", i)) for i, p in enumerate(processes) if p.sigma.any()
        ]
        if walk_density.any():
            self._parts.append(_Walk(walk_density, seeded(seed, *names, "walk")))
        self._first = 0
        self._nodes = np.empty((0, 3))

    @property
    def silent(self) -> bool:
        """Whether there is nothing to add."""
        return not self._parts

    def at(self, t: Array) -> Array:
        """Return the wander at times (n,) s >= 0, rising from call to call; shape (n, 3)."""
        if self.silent or not t.size:
            return np.zeros((t.size, 3))
        place = t / WANDER_STEP
        node = place.astype(np.int64)
        if node[-1] - self._first > MOST_NODES and t.size > 1:
            return np.concatenate([self.at(half) for half in np.array_split(t, 2)])
        self._extend(int(node[-1]) + 2)
        share = (place - node)[:, None]
        row = node - self._first
        values: Array = self._nodes[row] * (1.0 - share) + self._nodes[row + 1] * share
        self._forget(int(node[-1]))
        return values

    def _extend(self, end: int) -> None:
        missing = end - (self._first + len(self._nodes))
        if missing > 0:
            fresh = np.sum([p.advance(missing) for p in self._parts], axis=0)
            self._nodes = np.concatenate([self._nodes, fresh])

    def _forget(self, node: int) -> None:
        keep = max(node - self._first, 0)
        self._nodes = self._nodes[keep:]
        self._first += keep
