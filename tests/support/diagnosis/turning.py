"""Where up is, in the axes of a phone that is turned: for phones that are played from their rates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def ups(first: Rotation, rate: Array, rate_hz: float) -> Array:
    """Return up (n, 3) in body axes, from an attitude on; rate: (n, 3) rad/s in body axes, as sampled.

    Between two samples the phone turns by the mean of both rates. The third row of an attitude, body to
    world, is up as the body sees it, and is carried on by the turns as the attitude is.
    """
    turns = Rotation.from_rotvec((rate[1:] + rate[:-1]) / (2.0 * rate_hz)).as_matrix()
    up = np.empty_like(rate)
    up[0] = first.as_matrix()[2]
    for i, turn in enumerate(turns):
        np.matmul(up[i], turn, out=up[i + 1])
    return up
