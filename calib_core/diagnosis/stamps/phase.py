"""How many periods lie between stamps that jitter much, told by the phase of the grid that they lie on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import isotonic_regression

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import Index
from stillcal.calib_core.diagnosis.segments.sample_period import more_even_than_chance

BLOCKS = (64, 256, 1024)
"""Stamps whose phases are added up to find the period: the more, the clearer, unless the clock wanders."""

ENOUGH = 25600
"""Stamps, spread over the recording, that are enough to find the period."""

CELLS = 8
"""Parts of the usual interval that stamps are put into to add up phases, if they have no coarser step."""

FINER = 4
"""Periods tried for each that the phases of a block tell apart."""

LONGER, SHORTER = 0.05, 0.4
"""Parts by which the true period may be longer or shorter than the usual interval.

Missing samples make intervals longer: with 40 % missing and much jitter, by 0.37.
"""

CLEAR = 5.0
"""Standard errors by which the phases of a period must agree, of some hundred periods tried."""

CERTAIN = 32.0
"""Times the squared resultant length, stamps in one window: they tell the phase to 0.02 periods."""

AS_WELL = 0.9
"""Part of the best agreement from which a period is tried, too.

Stamps that are rounded to steps agree equally well at a mirrored rate: the steps' rate less the true one. At
that rate the lag falls where two stamps are close, and numbers that never fall follow it less closely.
"""

GRID = 2.0
"""Times as well that phases must agree as those of the same intervals in a random order, for a grid.

Intervals that are each off by themselves, or that are whole numbers of the stamps' steps, keep in any order
what agreement they have.
"""

STEPS = 0.9
"""Agreement in any order from which stamps lie on steps as long as a period."""

HOLDS = 0.5
"""Part of the agreement that must be left in as many stamps as tell the phase, to be one phase there."""

TURNED = 0.75
"""Periods by which the phase may turn from one such window to the next, the usual turn taken off."""

COARSE = 0.25
"""Steps of the stamps, in periods, from which their rounding may look like losses that come evenly."""


def periods_between(t: Array, usual: float, step: float) -> Array | None:
    """Return how many periods (n - 1,) lie between stamps t (n,) s that jitter. usual: their interval, s.

    Missing samples leave the phase of the grid as it is and put all later stamps a whole number of periods
    back; jitter does neither. So the whole numbers that never fall and lie nearest to the stamps' lag are
    sought: isotonic regression, rounded. Of several periods, the one whose lag they follow most closely
    counts; where stamps come in coarse steps (step: s), none whose losses are more even than chance. None
    where jitter or steps hide the grid.
    """
    best, nearest = None, np.inf
    for period, agreement in _periods(t, usual, step):
        window = int(CERTAIN / agreement)
        if window > t.size / 4:
            continue
        turns = (t - t[0]) / period
        if _agreement(turns, window) < HOLDS * agreement:
            continue
        phase = _phase(turns, window)
        turned = phase[window:] - phase[:-window]
        if np.abs(turned - np.median(turned)).max() > TURNED:
            continue
        lag = turns - phase - np.arange(t.size)
        lost = np.rint(isotonic_regression(lag).x)
        if step > COARSE * period and more_even_than_chance(np.diff(lost)):
            continue
        off = float(np.var(lag - lost)) * period**2
        if off < nearest:
            best, nearest = np.asarray(1.0 + np.diff(lost)), off
    return best


def _periods(t: Array, usual: float, step: float) -> list[tuple[float, float]]:
    """Return the periods, s, at which phases agree best, and their squared resultant lengths.

    Stamps in steps agree at the steps' own rate whatever the clock's is: it counts where no other one does.
    """
    tried = [_Agreement.of(t, usual, step, block) for block in BLOCKS if t.size > block]
    best = max(tried, key=lambda one: one.clearness(), default=None)
    if best is None:
        return []
    return best.periods(best.on_grid()) or best.periods(best.in_steps())


@dataclass(frozen=True, slots=True, eq=False)
class _Agreement:
    """How well the phases of stamps in blocks agree at some rates (n,), Hz: their squared resultant lengths.

    shuffled (n,): the same of intervals in a random order. unsure: standard error of independent phases.
    """

    rates: Array
    squared: Array
    shuffled: Array
    unsure: float

    @classmethod
    def of(cls, t: Array, usual: float, step: float, block: int) -> _Agreement:
        starts = np.arange(0, t.size - block + 1, block)
        starts = starts[:: -(-starts.size * block // ENOUGH)]
        width = step if step > usual / CELLS else usual / CELLS
        length = FINER * round((1.0 + SHORTER) * block * usual / width)
        per = length * width / usual
        tried = np.arange(int((1.0 - LONGER) * per), int((1.0 + SHORTER) * per))
        steps = np.diff(t[starts[:, None] + np.arange(block)], axis=1)
        shuffled = np.random.default_rng(0).permuted(steps.ravel()).reshape(steps.shape)
        power = [_power(one / width, length)[tried % length] for one in (steps, shuffled)]
        # Independent phases have a squared resultant of `chance`, and of the same standard deviation.
        chance = float((_taper(block) ** 2).sum())
        squared, other = ((one - chance) / (1.0 - chance) for one in power)
        return cls(tried / per / usual, squared, other, chance / float(np.sqrt(starts.size)))

    def on_grid(self) -> Index:
        """Return where phases agree clearly, and best, and more than by the size of intervals."""
        top = self._peaks()
        return top[self.squared[top] > GRID * np.maximum(self.shuffled[top], 0.0)]

    def in_steps(self) -> Index:
        """Return where the intervals are whole numbers of a step."""
        top = self._peaks()
        return top[self.shuffled[top] > STEPS]

    def clearness(self) -> float:
        """Return by how many standard errors phases of a grid agree where they do best."""
        return float(self.squared[self.on_grid()].max(initial=0.0)) / self.unsure

    def periods(self, rows: Index) -> list[tuple[float, float]]:
        """Return the periods, s, of the rows where phases agree about best, and squared resultant lengths."""
        found = []
        for top in rows[self.squared[rows] >= AS_WELL * self.squared[rows].max(initial=0.0)]:
            before, at, after = self.squared[top - 1 : top + 2]
            off = 0.5 * (before - after) / (before - 2.0 * at + after)
            rate = self.rates[top] + off * (self.rates[1] - self.rates[0])
            found.append((1.0 / float(rate), float(at)))
        return found

    def _peaks(self) -> Index:
        inner = self.squared[1:-1]
        top = 1 + np.flatnonzero((inner >= self.squared[:-2]) & (inner > self.squared[2:]))
        return np.asarray(top[self.squared[top] >= CLEAR * self.unsure], dtype=np.int64)


def _taper(block: int) -> Array:
    return np.asarray(np.hanning(block + 2)[1:-1] / ((block + 1) / 2.0))


def _power(steps: Array, length: int) -> Array:
    """Return the mean squared resultant (length,) of the phases of stamps in blocks, by their intervals.

    steps: (blocks, stamps - 1) in cells. Phases go by the cell, in a ring of `length` of them.
    """
    cells = np.rint(np.cumsum(np.pad(steps, ((0, 0), (1, 0))), axis=1)).astype(np.int64) % length
    blocks, block = cells.shape
    rows = np.arange(blocks)[:, None] * length + cells
    weights = np.bincount(rows.ravel(), np.tile(_taper(block), blocks), blocks * length)
    return np.asarray((np.abs(np.fft.fft(weights.reshape(blocks, length), axis=1)) ** 2).mean(axis=0))


def _agreement(turns: Array, block: int) -> float:
    """Return the squared resultant length of the phases of stamps (n,), periods, in blocks of so many."""
    rows = turns[: turns.size // block * block].reshape(-1, block)
    squared = float(np.mean(np.abs(np.exp(2j * np.pi * rows).mean(axis=1)) ** 2))
    return (squared - 1.0 / block) / (1.0 - 1.0 / block)


def _phase(turns: Array, window: int) -> Array:
    """Return the phase (n,) of stamps (n,), both in periods, as the circular mean of `window` neighbours."""
    total = np.concatenate([[0.0], np.cumsum(np.exp(2j * np.pi * turns))])
    places = np.arange(turns.size)
    before = np.maximum(places - window // 2, 0)
    after = np.minimum(places + window // 2 + 1, turns.size)
    return np.asarray(np.unwrap(np.angle(total[after] - total[before])) / (2.0 * np.pi))
