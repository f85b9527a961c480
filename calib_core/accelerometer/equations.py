"""Rests as equations on the accelerometer's parameters: each rest's calibrated norm must be gravity's.

Grammenos et al. 2018, Eq. 4 and 5, in units of gravity, so that bias and scale are of one size. `solve`
minimises Eq. 5 for given rests and parameters; which these are is decided in fit.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths import random_effects
from stillcal.calib_core.maths.levenberg_marquardt import Damping, Residuals, minimise
from stillcal.calib_core.static.rest import directions

_IDENTITY = np.r_[np.zeros(3), np.eye(3).ravel()]
_LEAST_SD = 1e-12  # of gravity: no rest gets the weight of a smaller uncertainty, so that none is infinite


@dataclass(frozen=True, slots=True, eq=False)
class Norms:
    """Rests in units of gravity.

    raw, sd: (n, 3) forces and their standard uncertainties. target: (n,) local gravity, about 1. labels: (n,)
    number of each rest's attitude, from 0. matrix: (12, p) basis of the parameters that are fitted.
    """

    raw: Array
    sd: Array
    target: Array
    labels: NDArray[np.intp]
    matrix: Array

    def only(self, mask: NDArray[np.bool_]) -> Norms:
        """Return the rests where `mask` (n,) holds, with their attitudes numbered anew."""
        if mask.all():
            return self
        labels = np.unique(self.labels[mask], return_inverse=True)[1]
        return replace(self, raw=self.raw[mask], sd=self.sd[mask], target=self.target[mask], labels=labels)

    def directions(self) -> Array:
        """Return the unit vectors of the attitudes, (m, 3), each the mean of its rests."""
        sums = [np.bincount(self.labels, column) for column in directions(self.raw).T]
        return directions(np.column_stack(sums))

    def residuals(self, v: Array) -> tuple[Array, Array]:
        """Return Eq. 4 divided by twice the target, (n,), and its Jacobian (n, p), at parameters v (p,).

        To first order it is the calibrated norm less the target.
        """
        bias, scale = self._unpacked(v)
        shifted = np.ascontiguousarray(self.raw.T) - bias[:, None]
        calibrated = scale @ shifted
        values = (np.add.reduce(calibrated * calibrated, axis=0) - self.target**2) / (2.0 * self.target)
        unit = calibrated / self.target
        slopes = np.empty((12, len(self.raw)))
        np.negative(scale.T @ unit, out=slopes[:3])
        np.multiply(unit[:, None], shifted, out=slopes[3:].reshape(3, 3, -1))
        return values, (self.matrix.T @ slopes).T

    def own_variances(self, v: Array) -> Array:
        """Return each calibrated norm's variance by its rest's uncertainty, (n,), at parameters v (p,)."""
        bias, scale = self._unpacked(v)
        slopes = directions((self.raw - bias) @ scale.T) @ scale
        return np.asarray(np.maximum(((slopes * self.sd) ** 2).sum(axis=1), _LEAST_SD**2))

    def start(self) -> Array:
        """Return the parameters of an ideal sensor, (p,); the columns of `matrix` are orthogonal."""
        return np.asarray(_IDENTITY @ self.matrix / (self.matrix**2).sum(axis=0))

    def _unpacked(self, v: Array) -> tuple[Array, Array]:
        twelve = self.matrix @ v
        return twelve[:3], twelve[3:].reshape(3, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Fitted parameters in units of gravity.

    v: (p,). covariance: (p, p). within, between: variance of the norm beyond the declared uncertainty,
    between rests of one attitude and between attitudes.
    """

    v: Array
    covariance: Array
    within: float
    between: float
    iterations: int
    converged: bool

    def variances(self, norms: Norms) -> Array:
        """Return each rest's variance about the model, (n,): its own and the excess."""
        return norms.own_variances(self.v) + self.within + self.between


@dataclass(frozen=True, slots=True, eq=False)
class _Weights:
    """How rests are weighted.

    pooling: (m, n) means over the rests of each of m attitudes. variances: (m,) of these means. within,
    between: the excess variances in them.
    """

    pooling: Array
    variances: Array
    within: float = 0.0
    between: float = 0.0

    @property
    def whitening(self) -> Array:
        return np.asarray(self.pooling / np.sqrt(self.variances)[:, None])


def solve(norms: Norms, damping: Damping, rounds: int, start: Array | None = None) -> Solution:
    """Minimise Eq. 5 and weight its terms anew, in turn, until the weights settle or `rounds` times.

    start: (p,); None starts from an ideal sensor. Rests that share an attitude enter as their weighted mean,
    so that an attitude held often does not outvote the others.
    """
    v = norms.start() if start is None else start
    iterations, converged = 0, False
    weights = _Weights(pooling(norms.labels, np.ones(len(norms.raw))), np.ones(norms.labels.max() + 1))
    for _ in range(rounds):
        minimum = minimise(_whitened(norms, weights.whitening), v, damping)
        v, iterations, converged = minimum.v, iterations + minimum.iterations, minimum.converged
        before, weights = weights, _weights(norms, v)
        if (np.abs(weights.variances - before.variances) <= 2e-3 * before.variances).all():
            break
    white = weights.whitening @ norms.residuals(v)[1]
    covariance = np.asarray(np.linalg.inv(white.T @ white), dtype=np.float64)
    return Solution(v, covariance, weights.within, weights.between, iterations, converged)


def _weights(norms: Norms, v: Array) -> _Weights:
    """Weight rests by their own variance and by the excess variances within and between attitudes."""
    residuals, jacobian = norms.residuals(v)
    own = norms.own_variances(v)
    within = random_effects.within_variance(residuals, norms.labels, own)
    pooled = pooling(norms.labels, 1.0 / (own + within))
    variances = 1.0 / np.bincount(norms.labels, 1.0 / (own + within))
    between = random_effects.excess_variance(pooled @ residuals, pooled @ jacobian, variances)
    return _Weights(pooled, variances + between, within, between)


def pooling(labels: NDArray[np.intp], weights: Array) -> Array:
    """Return the matrix (attitudes, n) that takes the weighted mean over each attitude's rests."""
    matrix = np.zeros((labels.max() + 1, labels.size))
    matrix[labels, np.arange(labels.size)] = weights / np.bincount(labels, weights)[labels]
    return matrix


def _whitened(norms: Norms, whitening: Array) -> Residuals:
    """Return the weighted residuals of Eq. 5 as a function of the parameters."""

    def residuals(v: Array) -> tuple[Array, Array]:
        values, jacobian = norms.residuals(v)
        return whitening @ values, whitening @ jacobian

    return residuals
