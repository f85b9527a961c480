"""What the accelerometer shows beyond gravity as the gyroscope carries it, piece by piece of the motion.

A linear model of it is fitted to all pieces together; errors come from leaving pieces out, and so does what
speaks for the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import blocks
from stillcal.calib_core.diagnosis.model.measurement import HeldOut
from stillcal.calib_core.maths.f_distribution import log_tail
from stillcal.calib_core.maths.rms import rms

Mask = NDArray[np.bool_]

UNTOLD = 1.0
"""Standard error of a parameter that no piece tells, in m, s or as a gain: none is as large."""

PARTS = 40
"""Groups of pieces that are left out in turn."""

STRETCHES = 20
"""Parts of the recording that are left out in turn where what is fitted goes with time."""

TAPERED = 1.5
"""Rows of a spectrum by a Hann window that share one independent value (its noise bandwidth)."""

LEAST = 1e-12
"""Part of a piece's power below which what is left of it is rounding."""


def of_arm(t: Array, rate: Array) -> Array:
    """Return what an arm r (3,) m does at times t (n,), (n, 3, 3): rate x (rate x r) + d rate/dt x r."""
    spin = _cross_matrix(rate)
    return np.asarray(spin @ spin + _cross_matrix(_slope(t, rate)))


def _slope(t: Array, rate: Array) -> Array:
    """Return the derivative of a rate (n, 3) at t (n,).

    A difference of two samples 2 h apart is smaller by (w h)^2 / 6 at an angular frequency w, which makes an
    arm longer: by 6 % at a tenth of the sample rate. The bend of these differences tells that part of it.
    """
    slope = np.gradient(rate, t, axis=0)
    slope[1:-1] -= np.diff(slope, 2, axis=0) / 6.0
    return np.asarray(slope)


def slope_power(angle: Array) -> Array:
    """Return the power of `_slope` times an interval squared, at `angle` rad from sample to sample."""
    return np.asarray((np.sin(angle) * (1.0 + (1.0 - np.cos(angle)) / 3.0)) ** 2)


def solved(information: Array, target: Array) -> Array:
    """Return the solution (k, ...) of normal equations (k, k); 0 for parameters that have no information."""
    told = np.flatnonzero(information.diagonal() > 0.0)
    out = np.zeros(target.shape)
    out[told] = np.linalg.solve(information[np.ix_(told, told)], target[told])
    return out


def _cross_matrix(v: Array) -> Array:
    """Return the matrices (n, 3, 3) of v x."""
    zero = np.zeros(len(v))
    x, y, z = v.T
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """Normal equations of K pieces: information (K, k, k), target (K, k), power (K,), count (K,) samples.

    shared: (k, m), what errors that all pieces share add to the sum of `target`, a standard deviation each.
    """

    information: Array
    target: Array
    power: Array
    count: Array
    shared: Array

    @classmethod
    def of(cls, designs: list[Array], lefts: list[Array]) -> Regression:
        """Add up designs (n, 3, k) and what they are to explain (n, 3), a piece each."""
        return cls(
            np.array([np.einsum("nij,nik->jk", d, d) for d in designs]),
            np.array([np.einsum("nij,ni->j", d, y) for d, y in zip(designs, lefts, strict=True)]),
            np.array([float((y**2).sum()) for y in lefts]),
            np.array([len(y) for y in lefts], dtype=np.float64),
            np.zeros((designs[0].shape[2], 0)),
        )

    def sharing(self, designs: list[Array], errors: list[Array]) -> Regression:
        """Return the same with what errors (n, 3, m) that all pieces share do to designs (n, 3, k)."""
        pairs = zip(designs, errors, strict=True)
        return replace(self, shared=np.sum([np.einsum("nij,nim->jm", d, e) for d, e in pairs], axis=0))

    def fitted(self, pieces: Mask | None = None) -> Array:
        """Return the parameters (k,) that fit the pieces chosen by (K,) bool, all by default.

        What none of these tells, its column being nothing in all of them, is 0.
        """
        use = np.ones(len(self.power), dtype=bool) if pieces is None else pieces
        return solved(self.information[use].sum(axis=0), self.target[use].sum(axis=0))

    def through(self, mixed: Array) -> Regression:
        """Return the same for columns that are mixtures of these: (k, m), a column each."""
        information = np.einsum("ka,nkl,lb->nab", mixed, self.information, mixed)
        return Regression(information, self.target @ mixed, self.power, self.count, mixed.T @ self.shared)

    def only(self, columns: Mask) -> Regression:
        """Return the same without the columns that (k,) bool does not choose."""
        rows = np.flatnonzero(columns)
        information = self.information[:, rows[:, None], rows]
        return Regression(information, self.target[:, rows], self.power, self.count, self.shared[rows])

    def left(self, x: Array) -> Array:
        """Return the sum of squares (K,) that parameters `x` leave in each piece."""
        return np.asarray(
            self.power - 2.0 * self.target @ x + np.einsum("a,nab,b->n", x, self.information, x)
        )

    def jackknifed(self, parts: int, *, in_a_row: bool = False) -> tuple[Array, Array, float]:
        """Return parameters, their covariance and the part of the power of left-out pieces explained.

        in_a_row: each group is of pieces that follow each other. A walk moves alike from one piece to the
        next, so what goes with time is no surer for more pieces of one walk.
        Where all values are exactly 0 (two equal recordings) there is nothing to explain, and the part is 0.
        """
        pieces = np.arange(len(self.power))
        part = pieces * min(parts, pieces.size) // pieces.size if in_a_row else pieces % parts
        chosen = np.unique(part)
        others = np.array([self.fitted(part != p) for p in chosen])
        explained = sum(
            float((self.power - self.left(x))[part == p].sum()) for p, x in zip(chosen, others, strict=True)
        )
        away = others - others.mean(axis=0)
        n = chosen.size
        information = self.information.sum(axis=0)
        common = solved(information, self.shared)
        least = np.where(information.diagonal() > 0.0, 1e-12, UNTOLD**2)
        covariance = (n - 1) / n * away.T @ away + common @ common.T + np.diag(least)
        total = float(self.power.sum())
        return self.fitted(), covariance, explained / total if total else 0.0

    def log_chance(self, x: Array, covariance: Array) -> float:
        """Return the log probability of k parameters that are nothing being as large (Hotelling's T^2).

        x: (k,) of the pieces, with the covariance (k, k) that leaving `PARTS` of them out gave.
        """
        k, parts = x.size, min(PARTS, len(self.power))
        squared = float(x @ np.linalg.solve(covariance, x)) * (parts - k) / (k * (parts - 1.0))
        return log_tail(squared, k, parts - k)

    def held_out(self, free: Mask | None = None, without: Regression | None = None) -> HeldOut:
        """Predict pieces left out with the others' parameters, and with those of `free` (k,) bool alone.

        without: the equations that these alone are fitted in, by default the same. A piece's own level of
        noise is unknown: with it integrated out under 1 / level, n independent values have a likelihood of
        what is left, as a sum of squares, to the power of -n / 2.
        """
        fold, every = blocks(len(self.power)), np.ones(self.target.shape[1], dtype=bool)
        chosen, other = ~every if free is None else free, without or self
        after, before = np.empty(len(self.power)), np.empty(len(self.power))
        for k in np.unique(fold):
            test = fold == k
            after[test], before[test] = (
                self._predicted(~test, every)[test],
                other._predicted(~test, chosen)[test],
            )
        gain = 1.5 / TAPERED * float(self.count @ np.log(before / after))
        level = [np.sqrt(x / self.count) for x in (before, after)]
        return HeldOut(gain, rms(level[0]), rms(level[1]))

    def _predicted(self, train: Mask, use: Mask) -> Array:
        """Return the sums of squares (K,) that parameters `use` leave, fitted to `train`; all are above 0."""
        chosen, least = self.only(use), np.maximum(LEAST * self.power, np.finfo(np.float64).tiny)
        return np.maximum(chosen.left(chosen.fitted(train)), least)
