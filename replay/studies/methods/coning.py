"""How complex a rotation is: what is lost where rates are averaged, since rotations do not commute.

Collin et al. 2019, Inertial Sensors and Their Applications, 4.2 (Eq. 26-27): the angle between the rotation
that a stretch of rates makes and the one that their mean makes. Zero where the axis keeps its direction. A
feature of motion that the accelerometer has no part in.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths.rotation import attitudes, conjugate, exponential, mean_rate_angles, multiply


def rotation_vector_rate(p: Array, rates: Array) -> Array:
    """Return the rate of change of rotation vectors p, (n, 3) rad, under rates (n, 3) rad/s (Eq. 26, exact).

    The factor of the last term is 1/12 where p vanishes.
    """
    angle = np.linalg.norm(p, axis=-1, keepdims=True)
    small = angle < 1e-3
    safe = np.where(small, 1.0, angle)
    factor = np.where(small, 1.0 / 12.0 + angle**2 / 720.0, (1.0 - safe / 2.0 / np.tan(safe / 2.0)) / safe**2)
    once = np.cross(p, rates)
    return np.asarray(rates + 0.5 * once + factor * np.cross(p, once))


def coning_errors(t: Array, rates: Array, span: float = 1.0) -> Array:
    """Return the coning error of each whole span of `span` s, (k,) rad.

    t: (n,) s; rates: (n, 3) rad/s. Each span's rates are averaged, by trapezoids, and turned into one
    rotation by Eq. 27; the error is the angle from that to the rotation of all samples. Raises ValueError
    where no span is whole.
    """
    edges = np.arange(t[0], t[-1] + 1e-9, span)
    if edges.size < 2:
        raise ValueError(f"coning needs {span} s of rates, have {t[-1] - t[0]:.2f} s")
    rows = np.minimum(np.searchsorted(t, edges - 1e-9), t.size - 1)
    q = attitudes(t, rates)
    true = multiply(conjugate(q[:, rows[:-1]]), q[:, rows[1:]])
    total = np.vstack((np.zeros(3), np.cumsum(mean_rate_angles(t, rates), axis=0)))
    averaged = exponential(total[rows[1:]] - total[rows[:-1]])
    return _angle(multiply(conjugate(averaged), true))


def _angle(q: Array) -> Array:
    """Return the angles of unit quaternions (4, n), rad, exact for small ones too."""
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(q[1:], axis=0), np.abs(q[0])))
