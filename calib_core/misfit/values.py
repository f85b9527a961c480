"""What the values themselves say: the step they come in, and where they stop."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.misfit import thresholds
from stillcal.calib_core.misfit.quick import direct_finding
from stillcal.calib_core.misfit.records import Finding, Parameter, Where
from stillcal.calib_core.samples import Array, Samples

UNIT = {"accel": "m/s^2", "gyro": "rad/s"}
COMB_SAMPLES = 20000
LEAST_LIMIT = {"accel": 11.3, "gyro": 0.5}


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
    return step if float(np.quantile(off, 0.95)) < 0.08 else None


def quantisation(samples: Samples, sensor: str, noise: Array, lsb: float | None) -> Finding | None:
    """Find a step coarser than the declared one, or, where none is declared, than the noise (3,)."""
    steps = [comb_step(samples.xyz[:, a]) for a in range(3)]
    limit = [1.5 * lsb if lsb else float(noise[a]) for a in range(3)]
    axes = [a for a in range(3) if (steps[a] or 0.0) > limit[a]]
    if not axes:
        return None
    step = float(np.median([s for s in (steps[a] for a in axes) if s is not None]))
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.0), "value")
    half = step * 1e-3
    size = f"{step:.4g} {UNIT[sensor]}"
    say = f"The {sensor} sensor's values come in steps of {size}, coarser than declared or than its noise."
    parameter = {"step": Parameter(step, [step - half, step + half], UNIT[sensor])}
    return direct_finding(
        f"{sensor}_quantisation", sensor, axes, where, parameter, statement=say, sigmas=30.0
    )


def saturation(samples: Samples, sensor: str, noise: Array, declared: float | None) -> Finding | None:
    """Find a value short of the declared range that nothing exceeds and on which samples pile up."""
    size = np.abs(samples.xyz)
    flat = {a: _flat_top(size[:, a], float(noise[a]), LEAST_LIMIT[sensor]) for a in range(3)}
    tops = {a: t for a, t in flat.items() if t is not None and (not declared or t[0] < 0.97 * declared)}
    if not tops:
        return None
    axes = list(tops)
    limit = float(np.median([t[0] for t in tops.values()]))
    error = max([1e-4 * limit, *(t[1] for t in tops.values())])
    rows = np.flatnonzero((size[:, axes] > limit - 4.0 * error - 4.0 * noise[axes]).any(axis=1))
    where = Where(float(samples.t[rows[0]]), float(samples.t[rows[-1]]), (0.0, 0.0), "own input")
    say = f"The {sensor} sensor stops at {limit:.4g} {UNIT[sensor]}; nothing beyond is to be trusted."
    parameter = {"limit": Parameter(limit, [limit - 1.96 * error, limit + 1.96 * error], UNIT[sensor])}
    return direct_finding(f"{sensor}_saturation", sensor, axes, where, parameter, statement=say, sigmas=30.0)


def _flat_top(size: Array, noise: float, least: float) -> tuple[float, float] | None:
    """Return limit and its standard error where the largest values pile up as no motion would make them."""
    top = float(size.max())
    width = max(4.0 * noise, 1e-4 * top)
    if top < least:
        return None
    pile = size > top - 2.0 * width
    below = int(((size > top - 6.0 * width) & ~pile).sum())
    runs = int((pile[1:] & pile[:-1]).sum())
    if pile.sum() < thresholds.LEAST_PILE or runs < 3 or pile.sum() < 3.0 * (below + 1):
        return None
    values = size[pile]
    return float(np.median(values)), float(values.std() / np.sqrt(values.size))
