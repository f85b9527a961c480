"""From rates and forces to attitude, velocity and position; and from steps to position.

Strapdown inertial navigation and pedestrian dead reckoning after Collin et al. 2019, Inertial Sensors and
Their Applications, 3.1 (Eq. 6-11) and 3.4 (Eq. 20-22). Nothing here knows sensors' errors, or where on Earth
it is. World axes: any level ones with z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.maths.rotation import attitudes, exponential, matrix


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Where a body went. t: (n,) s; velocity, position: (n, 3) m/s, m, world axes."""

    t: Array
    velocity: Array
    position: Array


def direction_cosines(p: Array) -> Array:
    """Return C(p), (..., 3, 3), of rotation vectors p, (..., 3) rad: from the turned frame (Eq. 7)."""
    return matrix(exponential(p))


def strapdown(
    t: Array, rates: Array, forces: Array, attitude: Array, gravity: float, *, velocity: Array | None = None
) -> Track:
    """Navigate by integration (tasks 1, 2, 3 and 5 of 3.1; no Coriolis correction, flat ground).

    t: (n,) s; rates, forces: (n, 3) rad/s, m/s^2 (specific force), body axes; attitude: (3, 3) body to world
    at the start; gravity: m/s^2 downwards; velocity: (3,) m/s at the start. Attitude by Eq. 9, with the
    coning term that Eq. 26 has over Eq. 27; acceleration by Eq. 11, trapezoids.
    """
    turned = matrix(attitudes(t, rates))
    acceleration = np.einsum("ij,njk,nk->ni", attitude, turned, forces) - np.array([0.0, 0.0, gravity])
    speed = _integrated(t, acceleration) + (np.zeros(3) if velocity is None else velocity)
    return Track(frozen(t), frozen(speed), frozen(_integrated(t, speed)))


def up_in_body(t: Array, rates: Array, forces: Array, span: float) -> Array:
    """Return where up is in the body's axes at each sample, unit vectors (n, 3), however the body is turned.

    Forces are carried by the rates to the frame of the first sample, in which gravity stands still but for
    the rates' errors, and averaged there over `span` s to either side, in which carrying a phone cancels.
    """
    turned = matrix(attitudes(t, rates))
    world = np.einsum("njk,nk->nj", turned, forces)
    up = np.einsum("nkj,nk->nj", turned, _smoothed(t, world, span))
    return np.asarray(up / np.linalg.norm(up, axis=1, keepdims=True))


def headings(t: Array, heading_rate: Array, start: float = 0.0) -> Array:
    """Return the heading at each sample, (n,) rad, from its rate in rad/s (Eq. 20)."""
    return np.asarray(start + np.r_[0.0, np.cumsum(heading_rate[1:] * np.diff(t))])


def step_headings(t: Array, heading: Array, start: Array, end: Array) -> Array:
    """Return the mean heading (k,) rad over each step [start, end) s; samples (n,) at t (Eq. 21)."""
    total = np.r_[0.0, np.cumsum(heading)]
    first, last = np.searchsorted(t, start), np.searchsorted(t, end)
    last = np.maximum(last, first + 1)
    return np.asarray((total[last] - total[first]) / (last - first))


def dead_reckoning(length: Array, heading: Array) -> Array:
    """Return positions (k + 1, 2) m after steps of `length` m along `heading` rad (Eq. 22)."""
    moves = length[:, None] * np.column_stack((np.cos(heading), np.sin(heading)))
    return np.vstack((np.zeros(2), np.cumsum(moves, axis=0)))


def _integrated(t: Array, values: Array) -> Array:
    steps = 0.5 * np.diff(t)[:, None] * (values[1:] + values[:-1])
    return np.vstack((np.zeros(values.shape[1]), np.cumsum(steps, axis=0)))


def _smoothed(t: Array, values: Array, span: float) -> Array:
    """Return means over the samples within `span` s to either side."""
    total = np.vstack((np.zeros(values.shape[1]), np.cumsum(values, axis=0)))
    first, last = np.searchsorted(t, t - span), np.searchsorted(t, t + span, side="right")
    return np.asarray((total[last] - total[first]) / (last - first)[:, None])
