"""What the accelerometer shows beyond gravity as the gyroscope carries it from rest to rest, turn by turn.

A linear model of it is fitted to all turns together; errors come from leaving turns out, and so does what
speaks for the model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.misfit.left_out import blocks, rms
from stillcal.calib_core.misfit.quick import Seen
from stillcal.calib_core.misfit.turns import Turn
from stillcal.calib_core.misfit.views import Baseline
from stillcal.calib_core.samples import Array, Samples

MEMORY = 0.25
"""s for which a hand's acceleration, the noise of this view, keeps its direction."""


def beyond_gravity(
    samples: Samples, baseline: Baseline, turn: Turn, gravity: float, late: float = 0.0
) -> Array:
    """Return specific force less carried gravity (n, 3), m/s^2, the gyroscope's stamps being `late` by s."""
    raw = np.stack([np.interp(turn.t - late, samples.t, samples.xyz[:, a]) for a in range(3)], axis=1)
    return np.asarray((raw - baseline.bias) @ baseline.scale.T - gravity * turn.gravity())


def of_arm(turn: Turn) -> Array:
    """Return what an arm r (3,) m does, (n, 3, 3): rate x (rate x r) + d rate/dt x r."""
    spin = _cross_matrix(turn.rate)
    return np.asarray(spin @ spin + _cross_matrix(np.gradient(turn.rate, turn.t, axis=0)))


def of_delay(turn: Turn, gravity: float) -> Array:
    """Return what a gyroscope that is late by 1 s does, (n, 3, 1) m/s^2: carried gravity is behind."""
    return np.asarray(-gravity * np.cross(turn.rate, turn.gravity())[:, :, None])


def _cross_matrix(v: Array) -> Array:
    """Return the matrices (n, 3, 3) of v x."""
    zero = np.zeros(len(v))
    x, y, z = v.T
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """Normal equations of K turns: information (K, k, k), target (K, k), power (K,), count (K,) samples."""

    information: Array
    target: Array
    power: Array
    count: Array

    @classmethod
    def of(cls, designs: list[Array], lefts: list[Array]) -> Regression:
        """Add up designs (n, 3, k) and what they are to explain (n, 3), a turn each."""
        return cls(
            np.array([np.einsum("nij,nik->jk", d, d) for d in designs]),
            np.array([np.einsum("nij,ni->j", d, y) for d, y in zip(designs, lefts, strict=True)]),
            np.array([float((y**2).sum()) for y in lefts]),
            np.array([len(y) for y in lefts], dtype=np.float64),
        )

    def fitted(self, turns: Array | None = None) -> Array:
        """Return the parameters (k,) that fit the turns chosen by (K,) bool, all by default."""
        use = np.ones(len(self.power), dtype=bool) if turns is None else turns
        return np.asarray(
            np.linalg.solve(self.information[use].sum(axis=0), self.target[use].sum(axis=0)), dtype=np.float64
        )

    def left(self, x: Array) -> Array:
        """Return the sum of squares (K,) that parameters `x` leave in each turn."""
        return np.asarray(
            self.power - 2.0 * self.target @ x + np.einsum("a,nab,b->n", x, self.information, x)
        )

    def jackknifed(self, parts: int) -> tuple[Array, Array, float]:
        """Return parameters, their covariance and the part of the power of left-out turns explained."""
        part = np.arange(len(self.power)) % parts
        chosen = np.unique(part)
        others = np.array([self.fitted(part != p) for p in chosen])
        explained = sum(
            float((self.power - self.left(x))[part == p].sum()) for p, x in zip(chosen, others, strict=True)
        )
        away = others - others.mean(axis=0)
        n = chosen.size
        covariance = (n - 1) / n * away.T @ away + 1e-12 * np.eye(others.shape[1])
        return self.fitted(), covariance, explained / float(self.power.sum())

    def seen(self, sigmas: float, interval: float, free: Array | None = None) -> Seen:
        """Predict turns left out with the others' parameters, and with those of `free` (k,) bool alone.

        Three normal residuals each `MEMORY` s; interval: of samples, s.
        """
        fold, gain = blocks(len(self.power)), 0.0
        kept = np.zeros(self.target.shape[1], dtype=bool) if free is None else free
        before, after = np.empty(len(self.power)), np.empty(len(self.power))
        for k in np.unique(fold):
            train, test = fold != k, fold == k
            own, null = self._spread(train, ~np.zeros_like(kept)), self._spread(train, kept)
            independent = self.count[test].sum() * interval / MEMORY
            after[test], before[test] = own[1][test], null[1][test]
            ratios = before[test].sum() / null[0] - after[test].sum() / own[0]
            gain += float(1.5 * independent * (np.log(null[0] / own[0]) + ratios / self.count[test].sum()))
        level = [np.sqrt(np.maximum(x, 0.0) / self.count) for x in (before, after)]
        return Seen(sigmas, gain, rms(level[0]), rms(level[1]))

    def _spread(self, train: Array, use: Array) -> tuple[float, Array]:
        """Return what parameters `use` leave: power a sample in `train`, and the sums (K,) of all turns."""
        x = np.zeros(use.size)
        rows = np.flatnonzero(use)
        if rows.size:
            sums = self.information[train].sum(axis=0)[np.ix_(rows, rows)]
            x[rows] = np.linalg.solve(sums, self.target[train].sum(axis=0)[rows])
        left = self.left(x)
        return float(left[train].sum() / self.count[train].sum()), left


def whitened(values: Array, interval: float) -> Array:
    """Take from each sample (n, ...) what `MEMORY` says the one before foretold."""
    return np.asarray(values[1:] - np.exp(-interval / MEMORY) * values[:-1])
