"""Detectability of an effect: d' on binned rests with the true noise covariance, and held-out gain.

d'^2 = delta' C^-1 delta. C is the covariance of the bins' means, plus broad normal priors on all that a
calibration may absorb, which is projecting it out: the gyroscope's constant bias and the Earth's rate, one
unknown vector of the ground for the recording; the accelerometer's bias and nine scale terms, and for every
rest the unknown attitude with a steady creep of it. No observer of the rests can do better than this d',
because all that such an observer could know is in it. `rotation` has the d' of effects of motion only.
"""

from __future__ import annotations

import math

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.blind_test.world.day import EARTH, Bins
from stillcal.replay.blind_test.world.noise import Colour

BIAS, SCALE, POSE, CREEP = 1.0, 0.5, 1.0, 0.01
"""Prior standard deviations in m/s^2: bias, scale and misalignment (5 % of g), attitude, creep in a rest."""

GYRO_BIAS = 0.2
"""The same for the gyroscope's bias, rad/s."""


def accelerometer_precision(bins: Bins, colour: Colour) -> Array:
    """Return the inverse covariance (3m, 3m) of the accelerometer's bin means, axis after axis."""
    m = bins.t.size
    covariance = np.zeros((3 * m, 3 * m))
    one = colour.covariance(bins.t, bins.width)
    for axis in range(3):
        covariance[axis * m : (axis + 1) * m, axis * m : (axis + 1) * m] = one
    free = _absorbed(bins)
    covariance += free @ free.T
    return np.asarray(np.linalg.inv(covariance))


def _absorbed(bins: Bins) -> Array:
    """Return what calibration and unknown attitudes absorb, columns (3m, k) scaled by their priors."""
    up = bins.force / np.linalg.norm(bins.force, axis=1, keepdims=True)
    eye = np.eye(3)
    columns = [BIAS * np.repeat(eye[a][:, None], bins.t.size, axis=1) for a in range(3)]
    columns += [SCALE * eye[a][:, None] * up[:, b] for a in range(3) for b in range(3)]
    for rest in np.unique(bins.rest):
        inside = bins.rest == rest
        east, north = _tangents(up[inside][0])
        creep = (bins.since - bins.since[inside].mean()) / max(float(np.ptp(bins.since[inside])), 1.0)
        for tangent in (east, north):
            columns += [POSE * tangent[:, None] * inside, CREEP * tangent[:, None] * (inside * creep)]
    return np.stack([c.ravel() for c in columns], axis=1)


def _tangents(up: Array) -> tuple[Array, Array]:
    east = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    east /= np.linalg.norm(east)
    return east, np.cross(up, east)


def gyroscope_precision(bins: Bins, colour: Colour) -> Array:
    """Return the inverse covariance (3m, 3m) of the gyroscope's bin means, axis after axis."""
    one = colour.covariance(bins.t, bins.width) + GYRO_BIAS**2
    free = _turning(bins)
    return np.asarray(np.linalg.inv(np.kron(np.eye(3), one) + free @ free.T))


def _turning(bins: Bins) -> Array:
    """Return what the Earth's rate may do to the bins, columns (3m, 3) scaled by its size.

    The Earth turns about one axis all the time, and the gyroscope itself carries that axis from rest to rest:
    a turn of 90 degrees that is known to 1 % leaves the axis known to 1 degree, which is 1e-6 rad/s. So it is
    one unknown vector of the ground for the whole recording, seen along up, north and east.
    """
    up = bins.force / np.linalg.norm(bins.force, axis=1, keepdims=True)
    east = np.cross(bins.north, up)
    return np.stack([EARTH * v.T.ravel() for v in (up, bins.north, east)], axis=1)


def precision(bins: Bins, sensor: str, colour: Colour) -> Array:
    """Return a sensor's inverse covariance of bin means."""
    if sensor == "accel":
        return accelerometer_precision(bins, colour)
    return gyroscope_precision(bins, colour)


def form(weight: Array, delta: Array) -> float:
    """Return delta' W delta of bins' values (m, 3)."""
    flat = delta.T.ravel()
    return max(float(flat @ weight @ flat), 0.0)


def d_prime(weight: Array, delta: Array) -> float:
    """Return d' of what is added to the bins, (m, 3)."""
    return math.sqrt(form(weight, delta))


def gain(weight: Array, true: Array, predicted: Array) -> float:
    """Return the log score that a predicted delta gains, in nats, on fresh noise of the same day; expected.

    The oracle, who predicts the true delta, gains d'^2 / 2.
    """
    return 0.5 * (form(weight, true) - form(weight, true - predicted))


def walk_d_prime(factor: float, density: float, white: float, duration: float, spacing: float) -> float:
    """Return d' of a random walk `factor` times what a sound phone may have, from its independent pieces.

    A walk of `density` shows over times longer than white / (sqrt 2 density), where it crosses white noise,
    and no finer than rests are spaced, s; each such piece of the recording is one draw of its variance.
    """
    pieces = max(duration / max(white / (math.sqrt(2.0) * density), spacing), 1.0)
    return math.log(factor) * math.sqrt(2.0 * pieces)
