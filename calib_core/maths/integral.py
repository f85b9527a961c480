"""Integrals of samples."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array


def running(t: Array, values: Array) -> Array:
    """Return the integral of values (n, a, b) from the first of the times t (n,) to each: trapezoids."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(t)[:, None, None]
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(steps, axis=0)])
