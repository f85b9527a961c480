"""The Kalman filter that the paper compares with: one a sensor, the sensor's three axes as its state.

Grammenos et al. 2018, 5.2: a random walk with the same Q and R on all axes. Written out with full matrices,
as freely available libraries do.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array


class Kalman:
    """A filter with state x (3,), transition and measurement the unit matrix.

    Works on any number type that numpy can hold, so that operations can be counted.
    """

    def __init__(self, first: Any, q: float, r: float, unit: Any = 1.0) -> None:
        eye = np.array([[unit * float(i == j) for j in range(3)] for i in range(3)])
        self.F, self.H, self.Q, self.R = eye, eye, eye * q, eye * r
        self.x, self.P, self._eye = first, eye * r, eye

    def update(self, z: Any) -> Any:
        """Take one reading (3,) and return the estimate (3,)."""
        x = self.F @ self.x
        P = self.F @ self.P @ self.F.T + self.Q
        S = self.H @ P @ self.H.T + self.R
        K = P @ self.H.T @ inverse(S)
        self.x = x + K @ (z - self.H @ x)
        self.P = (self._eye - K @ self.H) @ P
        return self.x


def inverse(m: Any) -> Any:
    """Return the inverse of a matrix (3, 3) by its adjugate."""
    c = np.cross(m[[1, 2, 0]], m[[2, 0, 1]])
    return c.T / (m[0] @ c[0])


def steady_gain(q: float, r: float) -> float:
    """Return the gain that such a filter settles at: of a scalar random walk, by its Riccati equation."""
    ahead = (q + np.sqrt(q**2 + 4.0 * q * r)) / 2.0
    return float(ahead / (ahead + r))


def settled(values: Array, q: float, r: float) -> Array:
    """Return settled filters' estimates over whole traces (n, length, 3), each from its first sample on."""
    from scipy.signal import lfilter  # noqa: PLC0415 - slow to import

    gain = steady_gain(q, r)
    start = (1.0 - gain) * values[:, :1]
    return np.asarray(lfilter([gain], [1.0, gain - 1.0], values, axis=1, zi=start)[0])
