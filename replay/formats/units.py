"""Does a recording look as if it were in m/s^2 and rad/s? Mistaken units are recognised and said.

Acceleration is judged by its norm: for the first samples together it must not be what g, mg or raw
counts would give. Rates are judged by gravity: as the phone turns, gravity's direction u turns against
it, du/dt = -(rate - bias) x u (the same relation that Eq. 12-15 of Grammenos et al. 2018 use), so the
factor between the rates and the turning shows the unit. Only stretches in which the force is near
gravity are used, which leaves out free fall and thrust; the bias is free, so a large one does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.samples import Array, Samples
from stillcal.replay.formats.errors import TraceError

OPENING, ENOUGH = 200, 2000
"""Samples after which the acceleration is judged: by its beginning, often a rest, and again with more."""

FEWEST = 10
"""Samples without which nothing is judged."""

DEGREE = float(np.pi / 180)
_NEAR_GRAVITY = (7.0, 13.0)
_BIN_S = 0.25
_FEWEST_TURNS = 20
_CLEARLY = 10.0
"""One unit must leave this many times the squared misfit of another to be ruled out: more than the 4 that
a gyroscope turned against the accelerometer's axes gives (residual twice the turning)."""

_SEEN = 2e-3
"""rad, rms of a pair of bins: turning that the mistaken unit must leave unexplained, above any rounding."""

_TILT = 0.2
"""rad: how far biases and misalignment may tilt the force from gravity as the gyroscope's axes have it; a
fast spin about the vertical then seems to turn gravity by this much of its angle."""

_MAP = "in a column map given as --format (docs/formats.md)"


@dataclass(slots=True)
class Turning:
    """Sums for the least-squares fit of gravity's turning to the rates, for any factor k between them.

    du = -k (theta x u) + (b x u) dt, with theta the integrated rate between the centres of neighbouring
    bins and b the free bias. pairs: pairs of bins used. squared_angle, angle: sums of |theta|^2 and theta.
    """

    pairs: int = 0
    squared_angle: float = 0.0
    angle: Array = field(default_factory=lambda: np.zeros(3))
    _normal: Array = field(default_factory=lambda: np.zeros((3, 3)))
    _right: Array = field(default_factory=lambda: np.zeros((2, 3)))
    _squares: Array = field(default_factory=lambda: np.zeros((2, 2)))

    def see(self, accelerometer: Samples, gyroscope: Samples) -> None:
        """Add the pairs of bins in this stretch."""
        binned = _gravity_bins(accelerometer)
        if binned is None or len(gyroscope) < 2:
            return
        t, up, joined = binned
        steps = np.diff(gyroscope.t)[:, None] * (gyroscope.xyz[1:] + gyroscope.xyz[:-1]) / 2
        angle = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
        joined &= (t[:-1] >= gyroscope.t[0]) & (t[1:] <= gyroscope.t[-1])
        theta = np.column_stack([np.diff(np.interp(t, gyroscope.t, angle[:, i])) for i in range(3)])
        middle, turned, dt = (up[1:] + up[:-1]) / 2, np.diff(up, axis=0), np.diff(t)
        self.squared_angle += float(np.sum(theta[joined] ** 2))
        self.angle = self.angle + theta[joined].sum(axis=0)
        self._add(turned[joined], np.cross(theta, middle)[joined], middle[joined] * dt[joined, None])

    def _add(self, turned: Array, crossed: Array, arm: Array) -> None:
        self.pairs += len(turned)
        rows = np.einsum("ijk,nk->nij", _LEVI_CIVITA, arm)  # b x arm = rows @ b
        sides = np.stack([turned, crossed])
        self._normal += np.einsum("nij,nik->jk", rows, rows)
        self._right += np.einsum("nij,sni->sj", rows, sides)
        self._squares += np.einsum("sni,tni->st", sides, sides)

    def misfit(self, k: float) -> float:
        """Return the sum of squares that the factor k leaves, with the bias that suits it best."""
        weights = np.array([1.0, k])
        right = weights @ self._right
        explained = right @ np.linalg.pinv(self._normal) @ right
        return float(weights @ self._squares @ weights - explained)

    @property
    def spread(self) -> float:
        """Sum of squares of the turning by the rates alone, their mean taken out, rad^2."""
        return self.squared_angle - float(self.angle @ self.angle) / max(self.pairs, 1)


@dataclass(slots=True)
class UnitCheck:
    """Looks at a recording as it goes by, and raises TraceError when its units cannot be right."""

    path: Path
    _norms: list[Array] = field(default_factory=list)
    _seen: int = 0
    _turning: Turning | None = field(default_factory=Turning)

    def see(self, accelerometer: Samples, gyroscope: Samples) -> None:
        """Take in the next stretch of the recording. Raises TraceError."""
        before, self._seen = self._seen, self._seen + len(accelerometer)
        if before < ENOUGH:
            self._norms.append(np.linalg.norm(accelerometer.xyz, axis=1))
        if before < OPENING <= self._seen:
            self._judge_size(np.concatenate(self._norms)[:OPENING])
        if before < ENOUGH <= self._seen:
            self.finish()
        if self._turning is not None and len(gyroscope):
            self._turning.see(accelerometer, gyroscope)
            self._judge_rates(self._turning)

    def finish(self) -> None:
        """Judge the acceleration by what was seen; called again at the end it has nothing left to say."""
        if self._norms and self._seen >= FEWEST:
            norms = np.concatenate(self._norms)[:ENOUGH]
            if not norms.any():
                what = f"the accelerometer reads zero in all of the first {norms.size} samples"
                raise TraceError(self.path, what, "check that it was on and that the columns are its own")
            self._judge_size(norms)
        self._norms = []

    def _judge_size(self, norms: Array) -> None:
        low, middle, high = np.quantile(norms, (0.05, 0.5, 0.95))
        seen = f"the acceleration is about {middle:.4g} in size where m/s^2 would give 9.8"
        for unit, one in (("g", 1.0), ("mg", 1000.0)):
            if 0.7 * one < middle < 1.4 * one and 0.2 * one < low and high < 4 * one:
                what = f"{seen}: it seems to be {unit}"
                raise TraceError(self.path, what, f'give m/s^2, or set unit = "{unit}" {_MAP}')
        if low > 60:
            what = f"{seen}: raw counts?"
            remedy = f'say accel_unit (m/s^2 in one count) in NAME.json, or unit = "counts" {_MAP}'
            raise TraceError(self.path, what, remedy)

    def _judge_rates(self, turning: Turning) -> None:
        right, degrees, radians = (turning.misfit(k) for k in (1.0, DEGREE, 1 / DEGREE))
        if turning.pairs < _FEWEST_TURNS:
            return
        seen = turning.pairs * _SEEN**2
        tilted = _TILT**2 * turning.spread
        for unit, misfit, least, stated in (
            ("deg/s", degrees, tilted, "rad/s"),
            ("rad/s", radians, 0.0, "deg/s"),
        ):
            if right > max(_CLEARLY * misfit, least, seen):
                what = f"the rates are not {stated}: gravity's direction turns as if they were {unit}"
                raise TraceError(self.path, what, f'give rad/s, or set unit = "{unit}" {_MAP}')
        if min(degrees, radians) > _CLEARLY * right:
            self._turning = None


_LEVI_CIVITA = np.zeros((3, 3, 3))
"""rows[i, j] = sum_k e[i, j, k] arm[k], so that rows @ b = b x arm."""
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI_CIVITA[_i, _j, _k], _LEVI_CIVITA[_i, _k, _j] = 1.0, -1.0


def _gravity_bins(accelerometer: Samples) -> tuple[Array, Array, NDArray[np.bool_]] | None:
    """Return times and unit forces of bins of 0.25 s, and which neighbours both show gravity undisturbed."""
    t = accelerometer.t
    if len(t) < FEWEST or t[-1] - t[0] <= 0:
        return None
    width = max(_BIN_S, 4 * float(np.median(np.diff(t))))
    number = np.floor((t - t[0]) / width)
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    counts = np.diff(starts, append=len(t))
    norms = np.linalg.norm(accelerometer.xyz, axis=1)
    calm = (
        (np.minimum.reduceat(norms, starts) > _NEAR_GRAVITY[0])
        & (np.maximum.reduceat(norms, starts) < _NEAR_GRAVITY[1])
        & (counts >= 3)
    )
    mean = np.add.reduceat(accelerometer.xyz, starts) / counts[:, None]
    times = np.add.reduceat(t, starts) / counts
    up = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    joined = calm[1:] & calm[:-1] & (np.diff(number[starts]) == 1)
    return times, up, joined
