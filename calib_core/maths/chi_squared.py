"""The chi-squared distribution's tail, by scipy.special: to import scipy.stats takes most of a second."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array


def log_tail(value: Array | float, freedom: float) -> Array:
    """Return the log probability of more than `value` (any shape), also where it is less than a float holds.

    >>> round(float(log_tail(5.991, 2)), 3)
    -2.996
    """
    from scipy.special import chdtrc  # noqa: PLC0415 - the daemon stays light

    value = np.asarray(value, dtype=np.float64)
    tail = chdtrc(freedom, value)
    far = tail < np.finfo(np.float64).tiny
    return np.where(far, _far(np.where(far, value, freedom + 2.0), freedom), np.log(np.where(far, 1.0, tail)))


def _far(value: Array, freedom: float) -> Array:
    """Return it far out, where Gamma(a, z) = z^(a - 1) e^-z (1 + (a - 1) / z + ...) (DLMF 8.11.2)."""
    from scipy.special import gammaln  # noqa: PLC0415 - the daemon stays light

    a, z = 0.5 * freedom, 0.5 * value
    term, total = np.ones_like(z), np.ones_like(z)
    for k in range(1, int(np.ceil(a))):  # it ends there for whole a, and is as good as ended for others
        term = term * (a - k) / z
        total += term
    return np.asarray((a - 1.0) * np.log(z) - z - gammaln(a) + np.log(total))


def exceeded(chance: float, freedom: float) -> float:
    """Return the value that is exceeded with this probability.

    >>> round(exceeded(0.05, 2), 3)
    5.991
    """
    from scipy.special import chdtri  # noqa: PLC0415 - the daemon stays light

    return float(chdtri(freedom, chance))
