"""The chi-squared distribution's tail, by scipy.special: to import scipy.stats takes most of a second."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array


def log_tail(value: Array | float, freedom: float) -> Array:
    """Return the log probability of more than `value` (any shape); minus infinity where it is below 1e-308.

    >>> round(float(log_tail(5.991, 2)), 3)
    -2.996
    """
    from scipy.special import chdtrc  # noqa: PLC0415 - the daemon stays light

    with np.errstate(divide="ignore"):
        return np.asarray(np.log(chdtrc(freedom, value)))


def exceeded(chance: float, freedom: float) -> float:
    """Return the value that is exceeded with this probability.

    >>> round(exceeded(0.05, 2), 3)
    5.991
    """
    from scipy.special import chdtri  # noqa: PLC0415 - the daemon stays light

    return float(chdtri(freedom, chance))
