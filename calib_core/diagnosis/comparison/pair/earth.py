"""The Earth's rotation, which one of two sensors on one motion may lack: one vector of the ground.

A simulator that leaves it out reads the rate against the ground. Turned by the attitude into body axes, the
vector that is missing looks like a g-sensitivity of the gyroscope (its vertical part) or like slow noise.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.maths.rotation import attitudes, exponential, matrix
from stillcal.calib_core.streams.samples import Samples

UP = np.array([0.0, 0.0, 1.0])


def of_ground(rate: Samples, bins: Bins, still: NDArray[np.bool_]) -> Array:
    """Return what a vector of the ground is in body axes, the mean of every bin, (n, 3, 3).

    rate: of the device, whose mean at rest is taken for its bias; bins: of all of the recording, with what
    the other sensors read; still: (n,) which of them are at rest: there gravity corrects the tilt.
    """
    assert bins.rate is not None, "asked for with a gyroscope"
    bias = bins.rate[still].mean(axis=0) if still.any() else np.zeros(3)
    turned = _mean_rotations(rate, bins, bias)
    level, out = np.eye(3), np.empty_like(turned)
    # What comes before the first rest is levelled by it too.
    order = np.arange(len(bins))
    first = int(order[still][0]) if still.any() else 0
    for i in (first, *order):
        if still[i]:
            level = _onto_up(level @ turned[i] @ bins.force[i]) @ level
        out[i] = (level @ turned[i]).T
    return out


def _mean_rotations(rate: Samples, bins: Bins, bias: Array) -> Array:
    """Return the mean of the rotation (n, 3, 3) from the body in every bin to the body at the start."""
    q = attitudes(rate.t, rate.xyz - bias)
    edges = np.searchsorted(rate.t, np.append(bins.t - bins.duration / 2, bins.t[-1] + bins.duration[-1] / 2))
    last = len(rate) - 1
    return np.array([matrix(q[:, min(a, last) : max(b, a + 1)]).mean(axis=-3) for a, b in pairwise(edges)])


def _onto_up(direction: Array) -> Array:
    """Return the smallest rotation (3, 3) that takes a direction (3,) up."""
    across = np.cross(direction, UP)
    size = float(np.linalg.norm(across))
    angle = np.arctan2(size, float(direction @ UP))
    return np.asarray(matrix(exponential(across / max(size, 1e-300) * angle)))
