"""Gravity propagated from rest to rest by the gyroscope: residuals of Eq. 15, their slopes and covariance.

Grammenos et al. 2018, Eq. 15. All rotation segments are laid end to end as one run of samples. The product of
rotations over one segment is the quotient of two running products, so that a single scan in logarithmic depth
serves segments of any length. What follows from the residuals is decided in solver.py.

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
    """The n distinct rests at the ends of K rotation segments, in time order.

    before, after: (K,) indices of the rests at each segment's ends. up: (n, 3) unit vectors of the calibrated
    specific force. up_covariance: (n, 3, 3) their covariance, rad^2. forces: (n, 3) m/s^2, calibrated.
    """

    rests: tuple[RestState, ...]
    before: Rows
    after: Rows
    up: Array
    up_covariance: Array
    forces: Array

    @classmethod
    def of(cls, segments: Sequence[RotationSegment], accel: SensorModel) -> Rests:
        """Collect the rests of rotation segments and their directions under the accelerometer's model."""
        by_time = {_key(r): r for segment in segments for r in (segment.before, segment.after)}
        keys = sorted(by_time)
        index = {key: i for i, key in enumerate(keys)}
        rests = tuple(by_time[key] for key in keys)
        up, covariance = directions(rests, accel)
        return cls(
            rests=rests,
            before=np.array([index[_key(t.before)] for t in segments], dtype=np.intp),
            after=np.array([index[_key(t.after)] for t in segments], dtype=np.intp),
            up=up,
            up_covariance=covariance,
            forces=accel.apply(stack(rests)),
        )


def directions(rests: Sequence[RestState], accel: SensorModel) -> tuple[Array, Array]:
    """Return the unit calibrated forces (n, 3) and the covariances (n, 3, 3) of these directions, rad^2.

    Besides each rest's own uncertainty they hold what the accelerometer's model leaves uncertain across
    gravity, which is taken as large as the scatter of the norms beyond the rests' own uncertainty.
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
    """K rotation segments laid end to end, integrated as far as possible before the scale is known.

    angles, cones: (N, 3) rad, each interval's integrated raw rate and raw coning term. steps: (N, 1) s, its
    length. A row of zeros opens each segment. nodes: (N, 4) the same angles and steps, distributed to the
    samples. starts, ends: (K,) each segment's first and last row. up_before, up_after: (K, 3) direction of
    gravity at either end.
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
    def of(cls, segments: Sequence[RotationSegment], biases: Sequence[Array], rests: Rests) -> Bundle:
        """Lay out segments after taking off each one's bias, (3,) or (n, 3) for n samples, rad/s."""
        lengths = np.array([t.t.size for t in segments])
        ends = np.cumsum(lengths) - 1
        starts = ends + 1 - lengths
        rates = [segment.rates - bias for segment, bias in zip(segments, biases, strict=True)]
        opening = np.zeros((1, 3))
        pieces = [(opening, rotation.mean_rate_angles(t.t, w)) for t, w in zip(segments, rates, strict=True)]
        angles = np.concatenate([part for piece in pieces for part in piece])
        stamps = np.concatenate([segment.t for segment in segments])
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
        """Return the raw angle turned about each axis, whatever its sign, (K, 3) rad."""
        total: Array = np.add.reduceat(np.abs(self.angles), self.starts, axis=0)
        return total

    def durations(self) -> Array:
        """Return the duration of each segment, (K,) s."""
        total: Array = np.add.reduceat(self.steps[:, 0], self.starts)
        return total

    def propagate(self, scale: Array, shift: Array) -> PropagatedGravity:
        """Propagate gravity through every segment with rates scale @ (raw - bias - shift).

        scale: (3, 3). shift: (3,) rad/s.
        """
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
        """Return the direction of gravity's specific force at each segment's samples, (n, 3) each."""
        body = self._bodies(scale, shift)
        fixed = (body[self.starts] @ self.up_before[:, :, None])[..., 0]
        spans = zip(fixed, self.starts, self.ends + 1, strict=True)
        return [up @ body[a:b] for up, a, b in spans]

    def _bodies(self, scale: Array, shift: Array) -> Array:
        """Return the attitude at every sample, (N, 3, 3): from the body to that at the very first sample."""
        cofactor = np.linalg.det(scale) * np.linalg.inv(scale).T
        steps = (self.angles - self.steps * shift) @ scale.T + self.cones @ cofactor.T
        return rotation.matrix(rotation.running_product(rotation.exponential(steps)))


@dataclass(frozen=True, slots=True, eq=False)
class PropagatedGravity:
    """Gravity propagated through every segment under one scale and shift, against gravity measured.

    angle: (K,) rad, between the two. residuals: (K, 2) rad, those of Eq. 15 across gravity; there is none
    along it. scale_slopes: (K, 2, 9) derivatives by the scale, row by row. bias_slopes: (K, 2, 3) by the
    bias, per rad/s. before_slopes, after_slopes: (K, 2, 3) by the direction of gravity at either end.
    """

    angle: Array
    residuals: Array
    scale_slopes: Array
    bias_slopes: Array
    before_slopes: Array
    after_slopes: Array

    @classmethod
    def of(cls, bundle: Bundle, turned: Array, by_scale: Array, by_bias: Array) -> PropagatedGravity:
        """Compare with measured gravity.

        turned: (K, 3, 3) rotation of each segment. by_scale, by_bias: (K, 3, 9) and (K, 3, 3) derivatives of
        the rotation vector in the body at the start.
        """
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
        """Return the covariance of the residuals, (2 K, 2 K) rad^2, with what neighbouring segments share.

        bias: (3, K, K) covariance of the segments' biases for each axis. walk: (K,) rad^2, what the rate's
        noise adds over each segment.
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
    """Return two unit vectors perpendicular to each of `up` (K, 3), as rows: (K, 2, 3)."""
    helper = np.eye(3)[np.abs(up).argmin(axis=1)]
    first = np.cross(up, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack((first, np.cross(up, first)), axis=1)


def _cross_matrix(v: Array) -> Array:
    """Return matrices X with X w = v x w, (K, 3, 3), for vectors v (K, 3)."""
    x, y, z = v.T
    zero = np.zeros_like(x)
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)


def _key(rest: RestState) -> tuple[float, float]:
    return rest.t_start, rest.t_end
