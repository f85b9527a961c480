"""The Earth's rate: one vector of the ground, which the gyroscope itself carries from rest to rest.

Its vertical part is seen along gravity wherever the phone lies. Where to its horizontal part points is the
same for the whole recording too, as far as the phone's heading can be followed: through every turn between
two rests that was recorded without a gap.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.turns import throughout
from stillcal.calib_core.maths.rotation import attitudes, matrix
from stillcal.calib_core.streams.samples import Samples

RATE = 7.292e-5
"""rad/s (WGS 84)."""

ON_AVERAGE = float(np.sqrt(0.5))
"""Part of it that is vertical, or along one horizontal direction, in standard deviation: at 45 degrees, or at
the equator with any heading."""

OF_ANGLE = 0.02
"""Error of a heading as a part of the angle turned through: twice the scale error of consumer gyroscopes."""

OF_TIME = 5e-5
"""Error of a heading, rad/s, by a bias that is known from the rests about a turn: 10 deg/h."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Horizontal directions in the bins. north: (n, 3) one direction, in body axes; trust: (n,) 0 to 1.

    trust: the correlation of the heading there with that in the bin from which it is counted.
    """

    north: Array
    trust: Array


def ground(gyroscope: Samples | None, bins: Bins, up: Array) -> Ground:
    """Follow the heading through the recording. up: (n, 3) unit gravity in the bins.

    With no gyroscope's samples, and where it is lost, nothing is known of the heading (trust 0).
    """
    north, spread, epoch = np.zeros_like(up), np.zeros(len(up)), np.zeros(len(up), dtype=np.int64)
    if not len(up):
        return Ground(north, spread)
    north[0] = _level(np.eye(3)[np.argmin(np.abs(up[0]))], up[0])
    for i, j in pairwise(range(len(up))):
        carried = (np.eye(3), 0.0) if bins.rest[i] == bins.rest[j] else _turned(gyroscope, bins, i)
        if carried is None:
            north[j] = _level(np.eye(3)[np.argmin(np.abs(up[j]))], up[j])
            epoch[j] = epoch[i] + 1
            continue
        rotation, error = carried
        missed = float(np.linalg.norm(up[j] - rotation @ up[i])) if bins.rest[i] != bins.rest[j] else 0.0
        north[j] = _level(rotation @ north[i], up[j])
        epoch[j], spread[j] = epoch[i], spread[i] + error**2 + missed**2
    longest = np.bincount(epoch).argmax()
    counted_from = np.median(spread[epoch == longest])
    trust = np.exp(-0.5 * np.abs(spread - counted_from)) * (epoch == longest)
    return Ground(north, trust if gyroscope is not None else np.zeros(len(up)))


def shared_rate(up: Array, over: Ground) -> Array:
    """Return the rate (n, 3, 3), rad/s, by the Earth's parts along up and along two directions of the ground.

    up: (n, 3) unit gravity in the bins; each part is one number for the recording, of unit size.
    """
    east = np.cross(over.north, up)
    known = over.trust[:, None]
    return np.asarray(np.stack([up, known * over.north, known * east], axis=2))


def _level(direction: Array, up: Array) -> Array:
    """Return the unit vector along what of a direction (3,) is across gravity."""
    across = direction - (direction @ up) * up
    return np.asarray(across / np.linalg.norm(across))


def _turned(gyroscope: Samples | None, bins: Bins, i: int) -> tuple[Array, float] | None:
    """Return the rotation (3, 3) from the body in bin i to that in the next, and its error, rad.

    None where samples between them are missing.
    """
    assert bins.rate is not None, "asked for with a gyroscope only"
    if gyroscope is None:
        return None
    start, end = bins.t[i] + bins.duration[i] / 2, bins.t[i + 1] - bins.duration[i + 1] / 2
    part = gyroscope.between(float(start), float(end))
    if len(part) < 2 or not throughout(part.t, float(start), float(end)):
        return None
    rate = part.xyz - 0.5 * (bins.rate[i] + bins.rate[i + 1])
    angle = float(np.linalg.norm(np.gradient(part.t)[:, None] * rate, axis=1).sum())
    rotation = matrix(attitudes(part.t, rate))[-1].T
    return rotation, float(np.hypot(OF_ANGLE * angle, OF_TIME * (end - start)))
