"""Steps of a walker from an accelerometer anywhere on the body: when they are, and how long they may be.

Collin et al. 2019, Inertial Sensors and Their Applications, 3.2 and 3.3. Works on the norm of the force,
which needs no attitude; the two patterns of the vertical component take it where it is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen

Rows = NDArray[np.int64]
PATTERNS = (
    "main frequency",
    "variance of the norm",
    "variance of the vertical",
    "area integral",
    "largest difference of the norm",
    "largest difference of the vertical",
)
"""p_1 to p_6, Eq. 13-18."""


@dataclass(frozen=True, slots=True)
class StepSettings:
    """Settings of the step detector.

    rate: Hz, to which the signal is brought, 20 to 25 is enough; cutoff: Hz of the low-pass before it.
    least_rise: m/s^3, steepest rise after a crossing of g; least_peak: m/s^2 over g, height that follows;
    least_s, most_s: s, shortest time between steps and longest a step may last.
    """

    rate: float = 25.0
    cutoff: float = 4.0
    least_rise: float = 5.0
    least_peak: float = 0.7
    least_s: float = 0.3
    most_s: float = 1.2


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Steps found. start, end: (k,) s. t, norm: (n,) s, m/s^2, the signal they were found in."""

    start: Array
    end: Array
    t: Array
    norm: Array


_DEFAULT = StepSettings()


def even(t: Array, values: Array, settings: StepSettings = _DEFAULT) -> tuple[Array, Array]:
    """Return values (n, ...) low-passed, at even times (3.2, item 1). Raises ValueError below two seconds."""
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415 - the daemon stays light

    if t.size < 16 or t[-1] - t[0] < 2.0:
        raise ValueError("steps need at least two seconds of samples")
    rate = (t.size - 1) / (t[-1] - t[0])
    place = np.arange(t[0], t[-1], 1.0 / max(rate, settings.rate))
    columns = np.reshape(values, (t.size, -1))
    fine = np.column_stack([np.interp(place, t, column) for column in columns.T])
    smooth = sosfiltfilt(butter(2, settings.cutoff, fs=max(rate, settings.rate), output="sos"), fine, axis=0)
    grid = np.arange(t[0], t[-1], 1.0 / settings.rate)
    out = np.column_stack([np.interp(grid, place, column) for column in smooth.T])
    return grid, np.reshape(out, (grid.size, *values.shape[1:]))


def detect_steps(t: Array, forces: Array, gravity: float, settings: StepSettings = _DEFAULT) -> Steps:
    """Find steps in forces (n, 3) m/s^2 at t (n,) s: crossings of g that a quick, high rise follows (3.2)."""
    grid, smooth = even(t, forces, settings)
    norm = np.asarray(np.linalg.norm(smooth, axis=1))
    over = norm >= gravity
    crossings = np.flatnonzero(~over[:-1] & over[1:])
    starts = _apart(grid, crossings[_followed(norm, crossings, gravity, settings)], settings.least_s)
    start = grid[starts]
    end = np.minimum(np.r_[start[1:], np.inf], start + settings.most_s)
    inside = end <= grid[-1]
    return Steps(frozen(start[inside]), frozen(end[inside]), frozen(grid), frozen(norm))


def vertical_only(forces: Array) -> Array:
    """Return forces (n, 3) m/s^2 with all but their component along their mean taken off, (n, 3)."""
    mean = forces.mean(axis=0)
    up = mean / np.linalg.norm(mean)
    return np.asarray((forces @ up)[:, None] * up)


def patterns(steps: Steps, gravity: float, vertical: Array | None = None) -> Array:
    """Return p_1 to p_6 of each step, (k, 6) (Eq. 13-18); the vertical's are NaN where it is not given.

    vertical: (n,) m/s^2 at `steps.t`, the force along up.
    """
    first, last = np.searchsorted(steps.t, steps.start), np.searchsorted(steps.t, steps.end)
    step = float(np.median(np.diff(steps.t)))
    unknown = np.full(steps.start.size, np.nan)
    up_variance, up_range = (unknown, unknown) if vertical is None else _spread(vertical, first, last)
    variance, extent = _spread(steps.norm, first, last)
    area = _over(np.add, np.abs(steps.norm - gravity), first, last) * step
    return np.column_stack((1.0 / (steps.end - steps.start), variance, up_variance, area, extent, up_range))


def step_length(pattern: Array, factor: float, exponent: float, offset: float = 0.0) -> Array:
    """Return the length of each step, m: K p^q + b (Eq. 19)."""
    return np.asarray(factor * pattern**exponent + offset)


def _followed(norm: Array, crossings: Rows, gravity: float, settings: StepSettings) -> NDArray[np.bool_]:
    """Say after which crossings the norm rises quickly and high enough before the next one; (k,) booleans."""
    if not crossings.size:
        return np.zeros(0, dtype=bool)
    ends = np.r_[crossings[1:], norm.size]
    rise = np.r_[np.diff(norm), 0.0] * settings.rate
    high = _over(np.maximum, norm, crossings, ends) >= gravity + settings.least_peak
    return np.asarray(high & (_over(np.maximum, rise, crossings, ends) >= settings.least_rise))


def _apart(t: Array, rows: Rows, least: float) -> Rows:
    """Drop what follows the last kept one too soon."""
    kept: list[int] = []
    for row in rows:
        if not kept or t[row] - t[kept[-1]] >= least - 1e-9:
            kept.append(int(row))
    return np.array(kept, dtype=np.int64)


def _over(reduce: np.ufunc, values: Array, first: Rows, last: Rows) -> Array:
    """Reduce values over each [first, last), which do not overlap."""
    if not first.size:
        return np.zeros(0)
    padded = np.r_[values, values[-1]]
    return np.asarray(reduce.reduceat(padded, np.column_stack((first, last)).ravel())[::2])


def _spread(values: Array, first: Rows, last: Rows) -> tuple[Array, Array]:
    """Return variance and range of values over each [first, last)."""
    n = last - first
    mean = _over(np.add, values, first, last) / n
    variance = _over(np.add, values**2, first, last) / n - mean**2
    return variance, _over(np.maximum, values, first, last) - _over(np.minimum, values, first, last)
