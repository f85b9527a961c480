"""The grid that a sensor's values lie on, and the error that it leaves in the mean of a rest."""

from __future__ import annotations

from functools import cache

import numpy as np

from stillcal.calib_core.arrays import Array

UNIT = {"accel": "m/s^2", "gyro": "rad/s"}
COMB_SAMPLES = 20000

ROUNDED = float(np.sqrt(12.0))
"""A whole step of coarse values over the standard deviation of rounding to it."""

FEW = 0.05
"""Part of the changes that may be smaller than the least one that counts."""

OFF = 0.08
"""Part of a step that gaps between values may be off its multiples, one in twenty excepted."""

MOST = 0.6
"""Part of the changes of value that are whole steps, above half: by chance one in six is."""

LEAST_GAPS = 4
"""Gaps between values that tell a grid by themselves."""

RARE = 0.005
"""Part of the values on either side that are not usual ones: a rest's normal noise reaches 2.6 standard
deviations with the others."""

LEAST_CHANGES = 50
"""Changes from one value to another by which few values go to and fro."""

BY_CHANCE = 1e-4
"""Probability of gaps as near to multiples without a grid, one of them being the step."""

HARMONICS = 8
BENEATH = np.linspace(0.1, 1.0, 91)
"""Noise, in steps, that is told apart by the codes it reaches: less than the first reaches two codes at most,
and with the last nothing is left of a step in a mean."""

PLACES = np.linspace(0.0, 1.0, 65)
"""Places of a mean between two codes, in steps."""

CODES = np.arange(-8.0, 10.0)
"""Codes about a mean that noise of one step reaches."""

NO_THIRD = 1e-6
"""Excess variance, steps^2, that is rounding: one sample in 10^6 on a third code."""


def comb_step(values: Array) -> float | None:
    """Return the step (unit) of the grid that `values` (n,) lie on, None where they lie on none.

    On a grid all differences of distinct values are multiples of the smallest.
    """
    return _of_comb(*_gaps(_thinned(values)))


def step_at_rest(values: Array) -> float | None:
    """Return the step (unit) of values (n,), also of those that stay in one attitude; None for none seen.

    There they reach too few codes for a comb, but to and fro between two to four numbers go only coarse ones:
    what a simulation without noise reads in two attitudes, or with the charger on and off, changes rarely.
    Codes that were rounded a second time, as to whole mg, are apart by two gaps; of the usual values at rest
    all may be by one.
    """
    step = _step(values)
    return step if step is not None or not values.size else _step(_usual(values))


def _usual(values: Array) -> Array:
    """Return values (n,) without the outermost ones (`RARE` of them on either side)."""
    low, high = np.quantile(values, [RARE, 1.0 - RARE], method="nearest")
    return np.asarray(values[(values >= low) & (values <= high)])


def _step(values: Array) -> float | None:
    """Return the step of values (n,) by a comb, or by how they go to and fro."""
    distinct, gaps = _gaps(_thinned(values))
    if gaps.size >= LEAST_GAPS:
        return _of_comb(distinct, gaps)
    _, gaps = _gaps(values)
    if not 0 < gaps.size < LEAST_GAPS or np.count_nonzero(np.diff(values)) < LEAST_CHANGES:
        return None
    step = float(gaps.min())
    return step if np.abs(gaps / step - np.rint(gaps / step)).max() < OFF else None


def _thinned(values: Array) -> Array:
    return values[:: max(1, values.size // COMB_SAMPLES)]


def _gaps(values: Array) -> tuple[Array, Array]:
    """Return the distinct values, and the gaps between them that are no rounding of numbers."""
    distinct = np.unique(values)
    gaps = np.diff(distinct)
    return distinct, gaps[gaps > max(1e-7, 2e-6 * float(np.abs(distinct).max(initial=0.0)))]


def _of_comb(distinct: Array, gaps: Array) -> float | None:
    """Return the step of distinct values with gaps between them; None where they lie on no grid."""
    if gaps.size < LEAST_GAPS:
        return None
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    multiples = np.rint(gaps / step)
    small = multiples <= 8
    step = float(gaps[small].sum() / multiples[small].sum())
    off = float(np.quantile(np.abs(gaps[small] / step - multiples[small]), 0.95))
    if off >= OFF or (2.0 * off) ** (np.count_nonzero(small) - 1) > BY_CHANCE:
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


def keeps_to(values: Array, step: float) -> bool:
    """Whether most changes from one value (n,) to the next are whole steps (unit).

    So they are where codes were rounded a second time, though no grid holds them all. With a step half as
    large, half of the changes are; with one twice as large all are, but none is of one step.
    """
    changes = np.abs(np.diff(_thinned(values))) / step
    changes = changes[changes > OFF]
    if not changes.size or changes.min() > 1.5:
        return False
    return bool(np.mean(np.abs(changes - np.rint(changes)) < OFF) > MOST)


def rounding_error(mean: Array, variance: Array, step: Array) -> Array:
    """Return the rms error (3,) that steps leave in the mean of a rest: no time averages it away.

    mean, variance: (n, 3) of the values of still bins; step: (3,), 0 for none. The error is periodic in the
    true mean; noise fades its harmonics (Widrow and Kollar, Quantization Noise, 2008, ch. 7).
    """
    k = np.arange(1, HARMONICS + 1)
    out = np.zeros(3)
    for axis in np.flatnonzero(step > 0.0):
        noise = _noise_beneath(mean[:, axis] / step[axis], variance[:, axis] / step[axis] ** 2)
        fading = np.exp(-2.0 * (np.pi * k * noise) ** 2)
        out[axis] = step[axis] * np.sqrt(0.5 * ((fading / (np.pi * k)) ** 2).sum())
    return out


def _noise_beneath(mean: Array, variance: Array) -> float:
    """Return the sd of the noise before rounding, of bins with mean and variance (n,) in steps.

    With the mean at a part p between two codes, values on these alone have the variance p (1 - p), however
    little noise there is; what is more is of noise that reaches a third code. It is the largest noise of
    which the bins together show no less than they would. A bin counts at most twice what it would show: in
    a few, the bias itself goes from code to code. 0 where no more than the least of `BENEATH` is shown.
    Variance less step^2 / 12 tells it of many rests in many attitudes only: midway between two codes that is
    too large, and the error was taken for five times smaller than it was.
    """
    place = mean - np.floor(mean)
    excess = np.maximum(variance - place * (1.0 - place), 0.0)
    shown = np.array([np.interp(place, PLACES, row) for row in _excesses()])
    shown[shown < NO_THIRD] = 0.0
    enough = np.flatnonzero((np.minimum(excess, 2.0 * shown) - shown).sum(axis=1) >= 0.0)
    return float(BENEATH[enough[-1]]) if enough.size and enough[-1] > 0 else 0.0


@cache
def _excesses() -> Array:
    """Return the excess (noise, place) of the variance that normal noise makes of rounded values."""
    from scipy.special import ndtr  # noqa: PLC0415 - the daemon stays light

    rows = []
    for noise in BENEATH:
        edges = (CODES[:, None] + 0.5 - PLACES) / noise
        chance = np.diff(ndtr(edges), axis=0)
        mean = CODES[1:] @ chance
        rows.append(np.interp(PLACES, mean, CODES[1:] ** 2 @ chance - mean**2) - PLACES * (1.0 - PLACES))
    return np.maximum.accumulate(np.array(rows), axis=0)


def least_change(values: Array) -> float:
    """Return what few changes from one value (n,) to the next stay below, unit: the step, where it is coarse.

    Where values have two gains one after the other, the grid of all is much finer than the steps of either.
    """
    changes = np.abs(np.diff(values))
    return float(np.quantile(changes[changes > 0.0], FEW)) if changes.any() else 0.0
