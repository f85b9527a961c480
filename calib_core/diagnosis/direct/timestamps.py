"""What the stamps alone say: how they scatter about an even grid, and which of its places are empty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.left_out import of_counts, of_spread
from stillcal.calib_core.diagnosis.model.measurement import SIGNIFICANT, Measured, direct_finding, mean_of
from stillcal.calib_core.diagnosis.model.records import Finding, Parameter, Where

PIECES = 40
LONGEST_GAP = 50
SHARP = 0.08
SPAN = 8
LOCAL = 0.75
WANDERING = -0.25
PEAK = 1.5
COUNTED = 3.0
"""Standard errors beyond the tolerance that will do for what is simply counted."""
DECIMALS = (3, 4, 5, 6)


def typical_period(t: Array) -> float:
    """Return the usual interval of stamps, s.

    The mean of those near the median, which rounding does not move.
    """
    steps = np.diff(t)
    middle = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    near = steps[np.abs(steps - middle) <= 0.5 * middle]
    return float(near.mean()) if near.size else middle


def mean_period(t: Array) -> float:
    """Return the mean interval of a stretch, its gaps counted as the samples that are missing."""
    period = typical_period(t)
    return (
        float((t[-1] - t[0]) / max(np.rint(np.diff(t) / period).sum(), 1.0)) if period > 0.0 else float("nan")
    )


def resolution(t: Array) -> float:
    """Return the decimal step, s, that all stamps lie on; 0 where they lie on none coarser than 1 us."""
    thin = t[:: max(1, t.size // 5000)]
    for digits in DECIMALS:
        if np.abs(thin * 10.0**digits - np.rint(thin * 10.0**digits)).max() < 1e-3 * max(
            1.0, thin.max() * 1e-6
        ):
            return float(10.0**-digits)
    return 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Stamps t (n,) s, the period s, how many periods (n - 1,) lie between them, their step s.

    Sigma of one s.

    apart: (m,) second differences of neighbours in place, whose variance is six times that of one stamp.
    """

    t: Array
    period: float
    multiples: Array
    step: float
    apart: Array
    factor: float

    @classmethod
    def of(cls, t: Array, period: float) -> Grid:
        """Place stamps on a grid."""
        steps = np.diff(t)
        near = np.abs(steps - period) < LOCAL * period
        rough = np.diff(steps)[near[1:] & near[:-1]]
        sharp = rough.size == 0 or float(np.mean(rough**2)) < 6.0 * (SHARP * period) ** 2
        factor = _factor(steps, near)
        if sharp:
            multiples = np.rint(steps / period)
        else:
            multiples = _placed(t, period) if factor > 2.0 else _peaked(steps / period)
        even = (multiples == 1.0) & (steps < 2.0 * period)
        second = np.diff(steps)[even[1:] & even[:-1]]
        return cls(t, period, multiples, resolution(t), second, factor)

    def sigmas(self) -> Array:
        """Return the scatter (PIECES,) of single stamps in pieces of the recording, s."""
        parts = np.array_split(self.apart, PIECES)
        return np.array([float(np.sqrt(np.mean(p**2) / self.factor)) for p in parts])


def _factor(steps: Array, even: NDArray[np.bool_]) -> float:
    """Return the variance of second differences over that of one jitter.

    Six where each stamp is off by itself (intervals anticorrelate by one half); two where intervals scatter.
    """
    own = steps - np.median(steps[even]) if even.any() else steps
    both = even[1:] & even[:-1]
    power = float((own[1:][both] ** 2).mean()) if both.any() else 0.0
    if power <= 0.0:
        return 6.0
    return 2.0 if float((own[1:][both] * own[:-1][both]).mean()) / power > WANDERING else 6.0


def _placed(t: Array, period: float) -> Array:
    """Return the periods (n - 1,) between stamps that scatter much.

    A gap shifts all that follow, jitter does not.
    """
    level = t - period * np.arange(t.size)
    padded = np.pad(level, SPAN, mode="edge")
    total = np.concatenate([[0.0], np.cumsum(padded)])
    mean = (total[SPAN:] - total[:-SPAN]) / SPAN
    shift = mean[SPAN + 1 : SPAN + t.size] - mean[1 : t.size]
    steps = np.rint(shift / period)
    size = np.abs(shift)
    top = np.ones(size.size, dtype=bool)
    for k in range(1, SPAN):
        top[k:] &= size[k:] >= size[:-k]
        top[:-k] &= size[:-k] > size[k:]
    return np.asarray(1.0 + np.where(top & (steps >= 1.0) & (np.diff(t) > 0.8 * period), steps, 0.0))


def _peaked(ratio: Array) -> Array:
    """Return the periods in intervals that scatter.

    Two only where intervals gather at two, not on the way there.
    """
    at_two, between = int((np.abs(ratio - 2.0) < 0.25).sum()), int((np.abs(ratio - 1.5) < 0.25).sum())
    return np.asarray(np.rint(ratio) if at_two > PEAK * (between + 1) else np.ones(ratio.size))


def jitter(grid: Grid, where: Where) -> Finding | None:
    """Find stamps that scatter by more than a sound phone's; what rounding does is taken off."""
    if grid.apart.size < 100:
        return None
    rounding = grid.step**2 / 12.0
    pieces = np.sqrt(np.maximum(grid.sigmas() ** 2 - rounding, 0.0))
    sigma = mean_of(pieces, 1e-3 * grid.period / np.sqrt(grid.apart.size))
    # Stamps that scatter by a fifth of the period and more are put in order, or held apart, by somebody.
    sorted_by = 0.15 * max(sigma.value / grid.period - 0.2, 0.0) * sigma.value
    sigma = Measured(sigma.value, float(np.hypot(sigma.error, sorted_by)))
    allowed = thresholds.JITTER_TOLERANCE * grid.period
    sigmas = sigma.beyond(0.0, max(allowed, 1.5 * np.sqrt(rounding)))
    if sigmas < SIGNIFICANT:
        return None
    say = f"Time stamps jitter by {sigma.value * 1e3:.2f} ms about an even rate."
    parameter = {"sigma": sigma.parameter("s")}
    seen = of_spread(grid.apart / np.sqrt(grid.factor), allowed, sigmas)
    return direct_finding("timestamp_jitter", "timing", [], where, parameter, statement=say, seen=seen)


def drops(grid: Grid, where: Where) -> Finding | None:
    """Find places of the grid that are empty, in gaps of up to `LONGEST_GAP` periods.

    Longer ones are pauses.
    """
    multiples = grid.multiples
    lost = np.where((multiples >= 2.0) & (multiples <= LONGEST_GAP), multiples - 1.0, 0.0)
    gaps, missing = int((lost > 0).sum()), float(lost.sum())
    total = grid.t.size + missing
    fraction = missing / total
    error = float(np.sqrt((lost**2).sum())) / total
    sigmas = Measured(fraction, error).beyond(0.0, thresholds.DROP_TOLERANCE)
    if gaps < thresholds.LEAST_GAPS or sigmas < COUNTED:
        return None
    low, high = max(fraction - 1.96 * error, 0.0), fraction + 1.96 * error
    say = f"{fraction:.2%} of the samples are missing, in {gaps} gaps."
    parts = np.array_split(lost, PIECES)
    hits = np.array([float(p.sum()) for p in parts])
    of = np.array([float(p.size) for p in parts]) + hits
    seen = of_counts(hits, of, thresholds.DROP_TOLERANCE, sigmas)
    parameter = {"fraction": Parameter(fraction, [low, high], "1")}
    return direct_finding("dropped_samples", "timing", [], where, parameter, statement=say, seen=seen)
