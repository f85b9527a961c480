"""The grid that a sensor's values lie on."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array

UNIT = {"accel": "m/s^2", "gyro": "rad/s"}
COMB_SAMPLES = 20000


def comb_step(values: Array) -> float | None:
    """Return the step (unit) of the grid that `values` (n,) lie on, None where they lie on none.

    On a grid all differences of distinct values are multiples of the smallest.
    """
    distinct = np.unique(values[:: max(1, values.size // COMB_SAMPLES)])
    gaps = np.diff(distinct)
    size = float(np.abs(distinct).max(initial=0.0))
    gaps = gaps[gaps > max(1e-7, 2e-6 * size)]
    if gaps.size < 4:
        return None
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    multiples = np.rint(gaps / step)
    small = multiples <= 8
    step = float(gaps[small].sum() / multiples[small].sum())
    off = np.abs(gaps[small] / step - multiples[small])
    if float(np.quantile(off, 0.95)) >= 0.08:
        return None
    return _refined(distinct, step)


def _refined(distinct: Array, step: float) -> float:
    """Fit the step to all distinct values, farther and farther from the middle one, where they keep to it."""
    away = distinct - distinct[distinct.size // 2]
    for reach in (30.0, 300.0, 3000.0):
        near = away[np.abs(away) < reach * step]
        multiples = np.rint(near / step)
        if multiples.any() and float(np.abs(near / step - multiples).max()) < 0.25:
            step = float(near @ multiples / (multiples @ multiples))
    return step
