"""True motion in closed form: any moment's specific force and angular rate, exactly consistent.

A piece of motion turns about a few body-fixed axes in succession, each by an angle that is a known function
of time, while the phone is carried along world directions. Rates and accelerations are the analytic
derivatives, so attitude, gyroscope, accelerometer and lever arm agree to rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from stillcal.calib_core.arrays import Array

UP = np.array([0.0, 0.0, 1.0])


class Profile(Protocol):
    """A quantity as a function of time."""

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Return value, first and second derivative at times (n,) s from the piece's start."""
        ...


@dataclass(frozen=True, slots=True)
class Glide:
    """From 0 to `change` in `duration` s after `start` s with least jerk (Flash and Hogan 1985, Eq. 3)."""

    change: float
    duration: float
    start: float = 0.0

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Return value, first and second derivative at times (n,) s."""
        x = np.clip((t - self.start) / self.duration, 0.0, 1.0)
        remaining = 1.0 - x
        value = self.change * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        rate = self.change / self.duration * 30.0 * (x * remaining) ** 2
        acceleration = self.change / self.duration**2 * 60.0 * x * remaining * (1.0 - 2.0 * x)
        return value, rate, acceleration


@dataclass(frozen=True, slots=True, eq=False)
class Waves:
    """A sum of sinusoids that swells and dies away within `fade` s of the ends of `duration` s.

    amplitude, frequency (Hz), phase: (k,).
    """

    amplitude: Array
    frequency: Array
    phase: Array
    duration: float
    fade: float

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Return value, first and second derivative at times (n,) s."""
        omega = 2.0 * math.pi * self.frequency
        angle = np.multiply.outer(t, omega) + self.phase
        sine, cosine = np.sin(angle), np.cos(angle)
        s0, s1, s2 = (
            sine @ self.amplitude,
            cosine @ (self.amplitude * omega),
            sine @ (self.amplitude * -(omega**2)),
        )
        if t.size and t[0] >= self.fade and t[-1] <= self.duration - self.fade:
            return s0, s1, s2
        rise = Glide(1.0, self.fade).at(t)
        fall = Glide(-1.0, self.fade, self.duration - self.fade).at(t)
        w0, w1, w2 = (a + b for a, b in zip(rise, fall, strict=True))
        return w0 * s0, w1 * s0 + w0 * s1, w2 * s0 + 2.0 * w1 * s1 + w0 * s2


@dataclass(frozen=True, slots=True)
class Creep:
    """A slow settling towards `amplitude` with time constant `tau` s."""

    amplitude: float
    tau: float

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Return value, first and second derivative at times (n,) s."""
        remaining = self.amplitude * np.exp(-t / self.tau)
        return self.amplitude - remaining, remaining / self.tau, -remaining / self.tau**2


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """Rotation about a body axis (unit, (3,)) by a profile in rad."""

    axis: Array
    angle: Profile


@dataclass(frozen=True, slots=True, eq=False)
class Sway:
    """Acceleration along a world direction (3,). The profile's derivative of that `order` is in m/s^2."""

    direction: Array
    course: Profile
    order: int = 2


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A stretch of motion of one kind.

    attitude: (3, 3) body to world at t_start. heading: rotation about the vertical, which carries the sway
    directions with it. still: whether a person would say that the phone lies still. earth: (3,) rad/s of
    the world in east, north, up.
    """

    t_start: float
    t_end: float
    attitude: Array
    activity: str
    still: bool
    gravity: float
    turns: tuple[Turn, ...] = ()
    sways: tuple[Sway, ...] = ()
    heading: Profile | None = None
    earth: Array | None = None

    def attitude_at(self, t: float) -> Array:
        """Return the attitude (3, 3), body to world, at time t in s."""
        since = np.array([t - self.t_start])
        attitude = self.attitude
        if self.heading is not None:
            attitude = rotation(UP, float(self.heading.at(since)[0][0])) @ attitude
        for turn in self.turns:
            attitude = attitude @ rotation(turn.axis, float(turn.angle.at(since)[0][0]))
        return attitude


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """True motion at n moments, body axes: force m/s^2, rate rad/s, rate_dot rad/s^2, each (n, 3)."""

    force: Array
    rate: Array
    rate_dot: Array


def cross_matrix(axis: Array) -> Array:
    """Return K (3, 3) with K @ v = axis x v."""
    x, y, z = axis
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation(axis: Array, angle: float) -> Array:
    """Return the rotation matrix (3, 3) about a unit axis by an angle in rad (Rodrigues)."""
    K = cross_matrix(axis)
    matrix: Array = np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * (K @ K)
    return matrix


def turn_between(start: Array, end: Array) -> tuple[Array, float]:
    """Return body axis (3,) and angle in rad, 0 to pi, that take attitude `start` to `end`."""
    R = start.T @ end
    angle = math.acos(float(np.clip((np.trace(R) - 1.0) / 2.0, -1.0, 1.0)))
    symmetric = (R + R.T) / 2.0 - math.cos(angle) * np.eye(3)
    column = symmetric[:, int(np.argmax(np.diag(symmetric)))]
    axis = column / max(float(np.linalg.norm(column)), 1e-300)
    skew = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return (axis if axis @ skew >= 0.0 else -axis), angle


def _seen_after(axis: Array, angle: Array, vectors: Array) -> Array:
    """Return world-fixed vectors (n, 3) in axes turned about `axis` by angle (n,)."""
    sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
    along = np.outer(vectors @ axis, axis)
    return along + (vectors - along) * cosine - (vectors @ cross_matrix(axis).T) * sine


def motion_of(piece: Piece, t: Array) -> Motion:
    """Return the true motion at times (n,) s inside the piece.

    With attitude R0 E1 E2 ... and E_k about u_k by theta_k: rate_k = E_k^T rate_(k-1) + u_k theta_k', and its
    derivative gains (E_k^T rate_(k-1)) x u_k theta_k'. The specific force is R^T (acceleration + gravity up).
    """
    n, since = t.size, np.maximum(t - piece.t_start, 0.0)
    world = np.broadcast_to(UP * piece.gravity, (n, 3))
    for sway in piece.sways:
        world = world + np.outer(sway.course.at(since)[sway.order], sway.direction)
    force = world @ piece.attitude
    rate, rate_dot = np.zeros((n, 3)), np.zeros((n, 3))
    earth = None if piece.earth is None else np.broadcast_to(piece.earth, (n, 3))
    if piece.heading is not None:
        angle, speed, growth = piece.heading.at(since)
        up = piece.attitude[2]
        rate, rate_dot = np.outer(speed, up), np.outer(growth, up)
        earth = None if earth is None else _seen_after(UP, angle, earth)
    earth = None if earth is None else earth @ piece.attitude
    for turn in piece.turns:
        angle, speed, growth = turn.angle.at(since)
        force = _seen_after(turn.axis, angle, force)
        rate = _seen_after(turn.axis, angle, rate)
        earth = None if earth is None else _seen_after(turn.axis, angle, earth)
        gained = (rate @ -cross_matrix(turn.axis).T) * speed[:, None]
        rate_dot = _seen_after(turn.axis, angle, rate_dot) + gained + np.outer(growth, turn.axis)
        rate = rate + np.outer(speed, turn.axis)
    return Motion(force, rate if earth is None else rate + earth, rate_dot)
