"""How gravity's direction rotates in body axes, compared with the rates.

In body axes a direction u fixed in space goes as du/dt = -(rate - bias) x u (the relation behind Eq. 12-15
of Grammenos et al. 2018). Only stretches in which the force is near gravity are used, which leaves out free
fall and thrust; the bias is free and may drift, so that no bias is taken for a unit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Samples

SLOWEST_STEP_S = 0.05
"""s: below 20 Hz the motion of a hand or a pocket is not caught well enough to be integrated."""

FEWEST_PAIRS, MOST_PAIRS = 8, 20
"""Pairs of bins in a stretch: 2 to 5 s."""

_NEAR_GRAVITY = (7.0, 13.0)
"""Norms between which a force is taken for gravity, m/s^2: neither free fall nor thrust."""

_SINGULAR = 1e-12
"""Eigenvalue, over the largest, of a direction that no bias shows in: along a gravity that never turns."""

_BIN_S = 0.25
"""Shortest bin of time, s: a hand turns a phone visibly in it."""


_LEVI_CIVITA = np.zeros((3, 3, 3))
"""rows[i, j] = sum_k e[i, j, k] arm[k], so that rows @ b is b x arm."""
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI_CIVITA[_i, _j, _k], _LEVI_CIVITA[_i, _k, _j] = 1.0, -1.0


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """How well the rates, times any factor k, explain gravity's rotation in one span of some seconds.

    du = -k (theta x u) + (b x u) dt from a bin of time to the next, with u the mean direction of the force in
    a bin, theta the step of the mean integrated rate and b the bias, which is free. pairs: pairs of bins.
    spread: sum of squares of theta with a steady rate taken out, rad^2; change: that of its differences from
    one pair to the next. squares: (2, 2) rad^2.
    """

    pairs: int
    spread: float
    change: float
    squares: Array

    def misfit(self, k: float) -> float:
        """Return the sum of squares that the factor k leaves, rad^2."""
        weights = np.array([1.0, k])
        return float(weights @ self.squares @ weights)


def turnings(accelerometer: Samples, gyroscope: Samples) -> Iterator[Turning]:
    """Yield the spans of a chunk in which gravity and rates can be compared."""
    if len(accelerometer) < 2 or len(gyroscope) < 2:
        return
    if float(np.median(np.diff(gyroscope.t))) > SLOWEST_STEP_S:
        return
    t, up, turn, joined = _binned(accelerometer, _integrated(gyroscope, accelerometer.t))
    dt, theta, turned = np.diff(t)[joined, None], np.diff(turn, axis=0)[joined], np.diff(up, axis=0)[joined]
    middle = (up[1:] + up[:-1])[joined] / 2
    whole = len(middle) // MOST_PAIRS * MOST_PAIRS
    columns = (dt, theta, turned, middle)
    if whole:
        yield from _compared(*(c[:whole].reshape(-1, MOST_PAIRS, c.shape[1]) for c in columns))
    if len(middle) - whole >= FEWEST_PAIRS:
        yield from _compared(*(c[None, whole:] for c in columns))


def _compared(dt: Array, theta: Array, turned: Array, middle: Array) -> Iterator[Turning]:
    """Yield spans, from (m, n, 1) and three of (m, n, 3), with the bias that suits each best taken out."""
    spans, pairs = theta.shape[:2]
    sides = np.stack([turned.reshape(spans, -1), np.cross(theta, middle).reshape(spans, -1)], axis=2)
    biased = np.einsum("ijk,mnk->mnij", _LEVI_CIVITA, middle * dt).reshape(spans, -1, 3)
    left = _without(sides, biased)
    squares = np.swapaxes(left, 1, 2) @ left
    spread = np.sum(_without(theta, dt) ** 2, axis=(1, 2))
    change = np.sum(np.diff(theta, axis=1) ** 2, axis=(1, 2))
    for one, differences, square in zip(spread.tolist(), change.tolist(), squares, strict=True):
        yield Turning(pairs, one, differences, square)


def _without(values: Array, basis: Array) -> Array:
    """Return `values` (m, n, k) less what the columns of `basis` (m, n, j) explain of them."""
    across = np.swapaxes(basis, 1, 2)
    factors = np.linalg.pinv(across @ basis, rcond=_SINGULAR, hermitian=True) @ (across @ values)
    return np.asarray(values - basis @ factors)


def _integrated(gyroscope: Samples, at: Array) -> Array:
    """Return the rates integrated up to the times `at`, (n, 3) rad; NaN beyond the gyroscope's samples."""
    steps = np.diff(gyroscope.t)[:, None] * (gyroscope.xyz[1:] + gyroscope.xyz[:-1]) / 2
    angle = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    return np.column_stack(
        [np.interp(at, gyroscope.t, angle[:, i], left=np.nan, right=np.nan) for i in range(3)]
    )


def _binned(accelerometer: Samples, angle: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Return by bins of 0.25 s the mean times, unit forces and angles, and which neighbours can be paired.

    Force and angle are averaged alike, so that shaking faster than the bins leaves the same in both.
    """
    t = accelerometer.t
    width = max(_BIN_S, 4 * float(np.median(np.diff(t))))
    number = np.floor((t - t[0]) / width)
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    counts = np.diff(starts, append=len(t))
    norms = np.linalg.norm(accelerometer.xyz, axis=1)
    usable = (np.minimum.reduceat(norms, starts) > _NEAR_GRAVITY[0]) & (counts >= 3)
    usable &= np.maximum.reduceat(norms, starts) < _NEAR_GRAVITY[1]
    mean, turn = (np.add.reduceat(v, starts) / counts[:, None] for v in (accelerometer.xyz, angle))
    usable &= np.isfinite(turn).all(axis=1)
    up = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    joined = usable[1:] & usable[:-1] & (np.diff(number[starts]) == 1)
    return np.add.reduceat(t, starts) / counts, up, turn, joined
