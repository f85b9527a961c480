"""Gravity carried from rest to rest by the gyroscope: residuals of Eq. 15, their slopes, their covariance.

All turns are one flat run of samples: a product over one turn is the quotient of two running products, so
a single scan in logarithmic depth serves turns of any length. Nothing here decides; gyroscope.py does.

Derivatives are sums of the rotated basis: with q(t) from the body at t to the body at the start,
d u_end = R (u_start x sum q(t) dS (raw - bias) dt), exact for small dS.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegment
from stillcal.calib_core.maths import rotation
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState, force_uncertainties
from stillcal.calib_core.static.rest import forces as stack

Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Rests:
    """The distinct rests at the ends of K turns, in time order.

    rests: n of them. before, after: (K,) index of each turn's ends. up, up_covariance: (n, 3) direction of
    the calibrated specific force and (n, 3, 3) its covariance, rad^2. forces: (n, 3) m/s^2, calibrated.
    """

    rests: tuple[RestState, ...]
    before: Rows
    after: Rows
    up: Array
    up_covariance: Array
    forces: Array

    @classmethod
    def of(cls, turns: Sequence[RotationSegment], accel: SensorModel) -> Rests:
        """Collect the rests of `turns` and their directions under the accelerometer's model."""
        found = {_key(r): r for turn in turns for r in (turn.before, turn.after)}
        keys = sorted(found)
        index = {key: i for i, key in enumerate(keys)}
        rests = tuple(found[key] for key in keys)
        up, covariance = directions(rests, accel)
        return cls(
            rests=rests,
            before=np.array([index[_key(t.before)] for t in turns], dtype=np.intp),
            after=np.array([index[_key(t.after)] for t in turns], dtype=np.intp),
            up=up,
            up_covariance=covariance,
            forces=accel.apply(stack(rests)),
        )


def directions(rests: Sequence[RestState], accel: SensorModel) -> tuple[Array, Array]:
    """Return the unit calibrated forces (n, 3) and the covariances (n, 3, 3) of these directions, rad^2.

    Besides each rest's own uncertainty, what the norms scatter beyond it stands for what the accelerometer's
    model leaves across gravity too.
    """
    force = accel.apply(stack(rests))
    variance = force_uncertainties(rests) ** 2
    norm = np.linalg.norm(force, axis=1)
    up = force / norm[:, None]
    across = np.eye(3) - up[:, :, None] * up[:, None, :]
    own = np.einsum("ij,kj,lj->kil", accel.scale, variance, accel.scale) / norm[:, None, None] ** 2
    along = np.einsum("ki,kij,kj->k", up, own, up)
    unmodelled = max(float(np.var(norm / norm.mean()) - along.mean()), 0.0)
    return up, across @ own @ across + unmodelled * across


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """K turns laid end to end, integrated as far as can be done before the scale is known.

    angles, cones: (N, 3) each interval's integrated raw rate and raw coning term; steps: (N, 1) its length,
    s; a row of zeros opens each turn. nodes: (N, 4) the same angles and steps, spread onto the samples.
    starts, ends: (K,) each turn's first and last row. up_before, up_after: (K, 3) gravity at either end.
    """

    angles: Array
    cones: Array
    steps: Array
    nodes: Array
    starts: Rows
    ends: Rows
    up_before: Array
    up_after: Array

    @classmethod
    def of(cls, turns: Sequence[RotationSegment], biases: Sequence[Array], rests: Rests) -> Bundle:
        """Lay out `turns` with each one's bias, (3,) or (n, 3) for n samples, taken off."""
        lengths = np.array([t.t.size for t in turns])
        ends = np.cumsum(lengths) - 1
        starts = ends + 1 - lengths
        rates = [turn.rates - bias for turn, bias in zip(turns, biases, strict=True)]
        opening = np.zeros((1, 3))
        pieces = [(opening, rotation.mean_rate_angles(t.t, w)) for t, w in zip(turns, rates, strict=True)]
        angles = np.concatenate([part for piece in pieces for part in piece])
        stamps = np.concatenate([turn.t for turn in turns])
        steps = np.diff(stamps, prepend=stamps[0])[:, None]
        cones = np.concatenate((opening, rotation.coning_angles(stamps, np.concatenate(rates))))
        steps[starts], cones[starts] = 0.0, 0.0
        rows = np.hstack((angles, steps))
        return cls(
            angles=angles,
            cones=cones,
            steps=steps,
            nodes=0.5 * (rows + np.concatenate((rows[1:], np.zeros((1, 4))))),
            starts=starts,
            ends=ends,
            up_before=rests.up[rests.before],
            up_after=rests.up[rests.after],
        )

    def path(self) -> Array:
        """Return the raw angle turned about each axis regardless of sign, (K, 3) rad."""
        total: Array = np.add.reduceat(np.abs(self.angles), self.starts, axis=0)
        return total

    def durations(self) -> Array:
        """Return how long each turn takes, (K,) s."""
        total: Array = np.add.reduceat(self.steps[:, 0], self.starts)
        return total

    def propagate(self, scale: Array, shift: Array) -> PropagatedGravity:
        """Carry gravity through every turn with rates scale @ (raw - bias - shift)."""
        body = self._bodies(scale, shift)
        first = body[self.starts].transpose(0, 2, 1)
        turned = (first @ body[self.ends]).transpose(0, 2, 1)
        rows = body.reshape(-1, 9).T
        spans = zip(self.starts, self.ends + 1, strict=True)
        sums = np.array([rows[:, a:b] @ self.nodes[a:b] for a, b in spans])
        sums = (first @ sums.reshape(-1, 3, 12)).reshape(-1, 3, 3, 4)
        rate_sums = sums[..., :3] - sums[..., 3:] * shift
        return PropagatedGravity.of(self, turned, rate_sums.reshape(-1, 3, 9), -sums[..., 3] @ scale)

    def up_along(self, scale: Array, shift: Array) -> list[Array]:
        """Return for each turn the direction of gravity's specific force at its samples, (n, 3)."""
        body = self._bodies(scale, shift)
        fixed = (body[self.starts] @ self.up_before[:, :, None])[..., 0]
        spans = zip(fixed, self.starts, self.ends + 1, strict=True)
        return [up @ body[a:b] for up, a, b in spans]

    def _bodies(self, scale: Array, shift: Array) -> Array:
        """Attitude at every sample, (N, 3, 3): from the body to the body at the first sample of all."""
        cofactor = np.linalg.det(scale) * np.linalg.inv(scale).T
        steps = (self.angles - self.steps * shift) @ scale.T + self.cones @ cofactor.T
        return rotation.matrix(rotation.running_product(rotation.exponential(steps)))


@dataclass(frozen=True, slots=True, eq=False)
class PropagatedGravity:
    """Gravity after every turn under one scale and one bias shift, across gravity as it was measured.

    angle: (K,) rad between both. residuals: (K, 2) of Eq. 15, the part along gravity being none.
    scale_slopes: (K, 2, 9) by the scale, row by row. bias_slopes: (K, 2, 3) by the bias, per rad/s.
    before_slopes, after_slopes: (K, 2, 3) by gravity's direction at either end.
    """

    angle: Array
    residuals: Array
    scale_slopes: Array
    bias_slopes: Array
    before_slopes: Array
    after_slopes: Array

    @classmethod
    def of(cls, bundle: Bundle, turned: Array, by_scale: Array, by_bias: Array) -> PropagatedGravity:
        """Compare with measured gravity; turned: (K, 3, 3); by_*: (K, 3, m) in the first body."""
        arrived = np.einsum("kij,kj->ki", turned, bundle.up_before)
        across = _across(bundle.up_after)
        to_end = across @ turned
        swing = to_end @ _cross_matrix(bundle.up_before)
        cosine = np.einsum("ki,ki->k", arrived, bundle.up_after)
        sine = np.linalg.norm(np.cross(arrived, bundle.up_after), axis=1)
        return cls(
            angle=np.arctan2(sine, cosine),
            residuals=np.einsum("kij,kj->ki", across, arrived),
            scale_slopes=swing @ by_scale,
            bias_slopes=swing @ by_bias,
            before_slopes=to_end,
            after_slopes=-across,
        )

    def covariance(self, rests: Rests, bias: Array, walk: Array) -> Array:
        """Covariance of the residuals, (2 K, 2 K) rad^2, with what neighbouring turns share.

        bias: (3, K, K) covariance of the turns' biases for each axis. walk: (K,) rad^2, what the rate's
        noise adds to each turn.
        """
        k = len(self.angle)
        ends = np.zeros((k, 2, len(rests.rests), 3))
        rows = np.arange(k)
        ends[rows, :, rests.before] += self.before_slopes
        ends[rows, :, rests.after] += self.after_slopes
        spread = np.einsum("kina,nab->kinb", ends, rests.up_covariance)
        from_ends: Array = spread.reshape(2 * k, -1) @ ends.reshape(2 * k, -1).T
        slopes = self.bias_slopes
        from_bias: Array = np.einsum("kia,akl,lja->kilj", slopes, bias, slopes, optimize=True)
        total: Array = from_ends + from_bias.reshape(2 * k, 2 * k) + np.diag(np.repeat(walk, 2))
        return total


def _across(up: Array) -> Array:
    """Two unit vectors square to each of `up` (K, 3), as rows: (K, 2, 3)."""
    helper = np.eye(3)[np.abs(up).argmin(axis=1)]
    first = np.cross(up, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack((first, np.cross(up, first)), axis=1)


def _cross_matrix(v: Array) -> Array:
    """Matrices X with X w = v x w, for vectors (K, 3)."""
    x, y, z = v.T
    zero = np.zeros_like(x)
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)


def _key(rest: RestState) -> tuple[float, float]:
    return rest.t_start, rest.t_end
