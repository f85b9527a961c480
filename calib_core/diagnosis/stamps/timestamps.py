"""What the stamps alone say: jitter about an even grid, and places of the grid that are empty.

Stamps that come in bursts have no grid: they say when samples were delivered, and neither is judged.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import SHARE_PIECES, of_shares, of_spread
from stillcal.calib_core.diagnosis.model.measurement import (
    Measured,
    direct_finding,
    mean_of,
    of_measured,
    share_in_time,
    share_of,
)
from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.diagnosis.segments.sample_period import rounded_or_lost, rounded_to_intervals
from stillcal.calib_core.diagnosis.stamps.phase import periods_between
from stillcal.calib_core.diagnosis.stamps.rate_changes import stretches
from stillcal.calib_core.maths.robust import bulk

Mean = Callable[[Array, float, float], Measured]
"""Mean of pieces (n,), with a least error, and with the scatter of pieces where that is known."""

PIECES = 40
"""Parts of a recording that errors are taken from: enough for a standard error known to a tenth."""

LONGEST_GAP = 50
"""Periods: a longer gap is a pause, in which nothing was recorded."""

SHARP = 0.08
"""Scatter, in periods, up to which intervals tell by rounding how many periods they hold."""

LOCAL = 0.75
"""Periods by which an interval of neighbours may be off."""

FEW_TOGETHER = 1e-3
"""Part of the samples that may come together: with more, what is after a long interval may be late."""

APART, WANDERING = -0.5, -0.25
"""Correlation of neighbouring intervals where each stamp is off by itself, and half way from there to
intervals that are (0)."""

NEARLY = 0.1
"""Correlations that differ by less are one, which makes 13 % of a jitter at most."""

INDEPENDENT = 6.0
"""Variance of second differences over that of one jitter where each stamp is off by itself."""

PEAK = 10.0
"""Times as many intervals at two periods than between one and two, for the former to be gaps."""

NONE = 5e-4
"""Share of samples that is as good as none: what may be missing where nothing shows that any is."""

DECIMALS = (2, 3, 4, 5, 6)

LEAST_JITTER = 1e-4
"""Periods: jitter below this is none, on the logarithmic scale of populations."""

LEAST_SHARE = 1e-4
"""The same of a share of samples."""


LASTING = 0.5
"""Part of a recording beyond which what is there is there all along."""


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

    apart: (m,) second differences of neighbours in place, whose variance is `factor` times that of one
    jitter: `INDEPENDENT` where each stamp is off by itself, 2 where intervals are, which add up, and between.
    told: whether the stamps tell how many periods lie between them.
    """

    t: Array
    period: float
    multiples: Array
    step: float
    apart: Array
    factor: float
    told: bool

    @classmethod
    def of(cls, t: Array, period: float) -> Grid:
        """Place stamps on a grid; one period lies between them where they do not tell how many do."""
        steps = np.diff(t)
        rounded = rounded_to_intervals(t)
        step = float(np.median(steps)) if rounded else resolution(t)
        near = np.abs(steps - period) < LOCAL * period
        multiples = None if rounded else _by_intervals(steps, near, period)
        if multiples is None:
            multiples = periods_between(t, period, step)
        correlation = _correlation(steps, near if multiples is None else near & (multiples == 1.0))
        if multiples is None and correlation > WANDERING:
            multiples = _peaked(steps / period)
        told = multiples is not None or (
            not (rounded and rounded_or_lost(t))
            and _as_many_in_any_time(steps[steps <= LONGEST_GAP * period])
        )
        if multiples is None:
            multiples = np.ones(steps.size)
        single = (multiples == 1.0) & (steps < 2.0 * period)
        second = np.diff(steps)[single[1:] & single[:-1]]
        # Stamps off by s and intervals by i have intervals of the variance 2 s^2 + i^2, whose neighbours have
        # the covariance -s^2; second differences have 6 s^2 + 2 i^2, and the jitter of one is s^2 + i^2.
        factor = 2.0 * (1.0 - correlation) / (1.0 + correlation)
        return cls(t, period, multiples, step, second, factor, told)

    def mean_periods(self, parts: int) -> Array:
        """Return the mean period, s, of each of `parts` parts: missing samples count, pauses do not."""
        steps = np.diff(self.t)
        inside = steps <= LONGEST_GAP * self.period
        periods = [
            (float(one[here].sum()), float(count[here].sum()))
            for one, count, here in zip(
                *(np.array_split(each, parts) for each in (steps, self.multiples, inside)), strict=True
            )
        ]
        return np.array([time / count if count else self.period for time, count in periods])

    def mean_rate(self, parts: int, floor: float, mean: Mean = mean_of) -> tuple[Measured, Array]:
        """Return the logarithm of the mean rate, 1/s, its error at least `floor`, and that of each part.

        A part is off by what its two ends are off: by rounding, or by as much as neighbours scatter. mean: of
        the parts; `mean_in_time` for what another recording may have.
        """
        logs = -np.log(self.mean_periods(parts))
        scatter = float(np.mean(self.apart**2)) if self.apart.size else 0.0
        of_end = np.sqrt(max(scatter / INDEPENDENT, self.step**2 / 12.0))
        return mean(logs, floor, np.sqrt(2.0) * of_end * parts / (self.period * self.t.size)), logs

    @property
    def rounding(self) -> float:
        """Variance, s^2, that the stamps' own step seems to make: step^2 / 12 where each is off by itself.

        It is that of `apart`, step^2 / 2 for independent errors of rounding, over `factor`.
        """
        return self.step**2 / (2.0 * self.factor)

    def jitter(self, mean: Mean = mean_of) -> Measured | None:
        """Return the scatter of single stamps, s, what rounding does taken off; None with too few.

        mean: of the parts; `mean_in_time` for what another recording may have.

        Rounded even stamps repeat a pattern: the mean square of `apart` is anything between 0 and step^2, so
        what is taken off may be off by itself either way, which is taken for two standard deviations.
        """
        if self.apart.size < 100:
            return None
        parts = np.array_split(self.apart, PIECES)
        own = np.array([float(np.mean(p**2) / self.factor) for p in parts])
        pieces = np.sqrt(np.maximum(own - self.rounding, 0.0))
        sigma = mean(pieces, 1e-3 * self.period / np.sqrt(self.apart.size), 0.0)
        # Stamps that scatter by a fifth of the period and more are put in order, or held apart, by somebody.
        sorted_by = 0.15 * max(sigma.value / self.period - 0.2, 0.0) * sigma.value
        most, square = min(self.rounding, float(own.mean())), sigma.value**2
        rounded_by = (np.sqrt(square + most) - np.sqrt(max(square - most, 0.0))) / 2.0
        return Measured(sigma.value, float(np.linalg.norm([sigma.error, sorted_by, rounded_by])))

    def lost(self) -> Array:
        """Return how many places (n - 1,) of the grid are empty between stamps."""
        inside = (self.multiples >= 2.0) & (self.multiples <= LONGEST_GAP)
        return np.where(inside, self.multiples - 1.0, 0.0)

    def dropped(self) -> Array:
        """Return how many samples (n - 1,) were lost: none because a stretch has a lower rate."""
        lost = self.lost()
        for one in stretches(self.t):
            rows = slice(one.first, one.last)
            own = np.rint(np.diff(self.t)[rows] / one.period)
            lost[rows] = np.where(own <= LONGEST_GAP, np.maximum(own - 1.0, 0.0), 0.0)
        return lost

    def missing(self) -> Measured:
        """Return the part of the samples that is missing, and may be in another recording.

        Losses of several at once count as one event.
        """
        return share_in_time(*self._counted(self.dropped()))

    def share(self, lost: Array) -> Measured:
        """Return the part that samples (n - 1,) which were lost are of all."""
        hits, *counted = self._counted(lost)
        return share_of(float(hits.sum()), *counted)

    def _counted(self, lost: Array) -> tuple[Array, float, float]:
        """Return samples lost (n - 1,), among how many, and how many of them come together."""
        total = float(lost.sum())
        return lost, self.t.size + total, float((lost**2).sum()) / total if total else 1.0


def _correlation(steps: Array, even: NDArray[np.bool_]) -> float:
    """Return the correlation of neighbouring intervals, `APART` to 0; `APART` where they scatter by nothing.

    even: (n,) which of the intervals (n,) s hold one period. Where a large jitter makes some of two seem to,
    it is nearer to 0, by less than `NEARLY`.
    """
    own = steps - np.median(steps[even]) if even.any() else steps
    both = even[1:] & even[:-1]
    power = float((own[1:][both] ** 2).mean()) if both.any() else 0.0
    if power <= (1e-6 * float(np.median(steps))) ** 2:
        return APART
    together = float((own[1:][both] * own[:-1][both]).mean()) / power
    return APART if together < APART + NEARLY else min(together, 0.0)


def _even(steps: Array, near: NDArray[np.bool_], period: float) -> bool:
    """Whether intervals (n - 1,) s scatter so little that rounding tells how many periods they hold."""
    rough = np.diff(steps)[near[1:] & near[:-1]]
    return rough.size == 0 or float(np.mean(rough**2)) < 6.0 * (SHARP * period) ** 2


def _by_intervals(steps: Array, near: NDArray[np.bool_], period: float) -> Array | None:
    """Return the periods in intervals (n - 1,) s by rounding; None where they scatter too much for that."""
    apart = float(np.mean(steps < (1.0 - LOCAL) * period)) < FEW_TOGETHER
    sharp = apart and _even(steps, near, period)
    return np.asarray(np.where(near, 1.0, np.rint(steps / period))) if sharp else None


def _peaked(ratio: Array) -> Array | None:
    """Return the periods in intervals that scatter; None where they do not gather at one and two."""
    at_two, between = int((np.abs(ratio - 2.0) < 0.25).sum()), int((np.abs(ratio - 1.5) < 0.25).sum())
    gathered = at_two > PEAK * between or between < NONE * ratio.size
    return np.asarray(np.maximum(np.rint(ratio), 1.0)) if gathered else None


def _as_many_in_any_time(steps: Array) -> bool:
    """Whether equal numbers of intervals (n,) s take equal times, so that no sample is missing by chance.

    If a share of samples is lost by chance, the time of so many scatters by this share of their number, in
    periods squared. Each part is held against the next one, as the clock's rate may change slowly.
    """
    parts = np.array_split(steps / steps.mean() - 1.0, PIECES)
    late = np.array([float(p.sum()) for p in parts])
    return float(np.mean((late[1::2] - late[::2]) ** 2)) / 2.0 < NONE * steps.size / PIECES


def jitter(grid: Grid, usual: Usual, where: Where) -> Finding | None:
    """Find stamps that scatter by more than a sound phone's. usual: of log10 of sigma in periods."""
    sigma = grid.jitter()
    if sigma is None or sigma.value <= 1.5 * np.sqrt(grid.rounding):
        return None
    relative = Measured(sigma.value / grid.period, sigma.error / grid.period).log(LEAST_JITTER)
    sound = grid.period * 10.0**usual.highest
    seen = of_measured(relative, usual, of_spread(grid.apart / np.sqrt(grid.factor), sound))
    say = f"Time stamps jitter by {sigma.value * 1e3:.2f} ms about an even rate."
    parameter = {"sigma": sigma.parameter("s")}
    return direct_finding("timestamp_jitter", "timing", [], where, parameter, statement=say, seen=seen)


def drops(grid: Grid, usual: Usual, where: Where) -> Finding | None:
    """Find places of the grid that are empty. usual: of log10 of the part missing plus `LEAST_SHARE`."""
    lost = grid.dropped()
    fraction = grid.share(lost)
    parts = np.array_split(lost, SHARE_PIECES)
    hits = np.array([float(p.sum()) for p in parts])
    of = np.array([float(p.size) for p in parts]) + hits
    held_out = of_shares(hits, of, 10.0**usual.highest)
    seen = of_measured(fraction.log(LEAST_SHARE), usual, held_out)
    where, when = located(grid.t[1:], lost, where)
    say = f"{fraction.value:.2%} of the samples are missing, in {np.count_nonzero(lost)} gaps{when}."
    parameter = {"fraction": fraction.parameter("1")}
    return direct_finding("dropped_samples", "timing", [], where, parameter, statement=say, seen=seen)


def located(t: Array, hits: Array, where: Where) -> tuple[Where, str]:
    """Return when nearly all of the hits (n,) at stamps t (n,) s are, and words for a while."""
    if not hits.any():
        return where, ""
    start, end = (float(t[k]) for k in bulk(hits))
    if end - start > LASTING * (where.t_end - where.t_start):
        return where, ""
    return replace(where, t_start=start, t_end=end), f", nearly all from {start:z.0f} to {end:z.0f} s"
