"""By how much one sensor's readings come later than another's of the same motion, all axes or one of them.

Late readings differ by the delay times their own rate of change. In means over some seconds that looks like a
wrong scale, or like a bias that jumps with the motion, so readings are aligned before they are compared.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.effect import on_axes
from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    Measured,
    direct_finding,
    of_vector,
)
from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.motion.axis_delays import SPLIT, AxisDelays
from stillcal.calib_core.diagnosis.motion.block_regression import PARTS, Regression
from stillcal.calib_core.diagnosis.motion.group_delay import DELAY
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.streams.resample import interpolate, read_later
from stillcal.calib_core.streams.samples import Samples

PIECES = (4.0, 2.0, 1.0)
"""s that have an offset of their own, which takes out what is slow: the longest of which enough move. A turn
in the hand lasts some seconds, and a grid of pieces as long hardly fits it."""

LEAST_PIECES = 12
"""Pieces that move: of fewer, an error that comes from leaving pieces out is itself unknown."""

MOST_PIECES = 200
"""Pieces that are enough: a delay is then known to a small part of a sample."""

MEANS = (1, 2, 4, 8, 16)
"""Samples that are read as one, the fewest of which show enough motion: from sample to sample a smooth hand
moves a sensor by less than its noise at 100 Hz and more."""

LINEARISED = 3
"""Times that the model is taken about the delay found before."""

SINGULAR = 1e12
"""Condition of the equations from which motion does not tell a delay from a scale."""

LIVELY = 0.1
"""Part of the rms rate of change of the liveliest piece from which a piece counts as moving."""

NOISY = 0.02
"""Part of a piece's changes that may be noise of the other sensor, by which a delay would seem smaller."""

QUIETEST = 0.1
"""Part of a recording whose noise is taken for all of it: a single piece may hold values that are not new."""

SIZE = 0.01
"""Prior standard deviation of a delay, s: a sample of a phone's usual rate."""

COMMON = np.zeros((12, 10))
"""Takes what nine gains and the delays of three axes do to what the gains and one delay do."""
COMMON[:9, :9], COMMON[9:, 9] = np.eye(9), 1.0

APART = np.zeros((12, 12))
"""The same with what sets the delays of x and y against z apart."""
APART[:, :10], APART[9:, 10:] = COMMON, SPLIT

GAINS = np.array([*[True] * 9, False])
"""Of gains and one delay, the columns of the gains."""

SURE = 4.0
"""Standard errors from which readings are aligned."""

SURELY_APART = 1e-5
"""Chance of axes that are late alike being as far apart, below which each is aligned by itself."""

LEAST_ERROR = 2e-5
"""s: stamps are printed with six digits at best, and readings between them are interpolated."""


Response = Callable[[slice], Array]
"""What further effects do to some samples' readings, (n, 3, k)."""


@dataclass(frozen=True, slots=True, eq=False)
class Late:
    """A delay of one sensor's readings, s, with the normal equations about no delay that it comes from.

    axes: by how much each axis is later than their mean; by_axis: the delay (3,) of each, s, as far as it is
    sure; pieces: where the readings change enough to tell.
    """

    delay: Measured
    equations: Regression
    axes: AxisDelays
    by_axis: Array
    pieces: list[slice]

    @property
    def apart(self) -> bool:
        """Whether one delay of all axes does not fit."""
        return _apart(self.axes)


def _apart(axes: AxisDelays) -> bool:
    return axes.log_chance < float(np.log(SURELY_APART))


def late(own: Samples, true: Samples, sensor: str) -> Late | None:
    """Return by how much `own` reads later than `true`, at the same stamps; None with too little motion.

    Least squares of the difference of the readings on what scale and misalignment do, and on the rate of
    change, about the delay that fits best of those that longer means show: a vibration fits as well a whole
    period later. The error is that of leaving pieces out.
    """
    told = []
    for size in MEANS:
        both = _means(own, size), _means(true, size)
        every = (_moving(both[1], length) for length in PIECES)
        if (pieces := next((pieces for pieces in every if len(pieces) >= LEAST_PIECES), None)) is not None:
            told.append((size, both, pieces))
    if not told:
        return None
    coarser = [_late(*both, sensor, pieces, 0.0) for _, both, pieces in told[1:]]
    size, both, pieces = told[0]
    starts = [0.0, *(one.delay.value for one in coarser if one is not None)]
    found = _late(*both, sensor, pieces, min(starts, key=lambda start: _left(*both, pieces, start)))
    whole = [slice(size * p.start, size * p.stop) for p in pieces]
    return None if found is None else replace(found, pieces=whole)


def _left(own: Samples, true: Samples, pieces: list[slice], delay: float) -> float:
    """Return the sum of squares that a delay, s, and the gains that fit best with it leave."""
    about = linear_in_motion(own, read_later(true, delay), pieces).through(COMMON)
    return float(about.left(about.fitted()).sum())


def _means(samples: Samples, size: int) -> Samples:
    """Return the means of every `size` samples, what is left over in none."""
    if size == 1:
        return samples
    count = len(samples) // size
    t, xyz = samples.t[: count * size], samples.xyz[: count * size]
    return Samples(samples.sensor, t.reshape(-1, size).mean(axis=1), xyz.reshape(-1, size, 3).mean(axis=1))


def _late(own: Samples, true: Samples, sensor: str, pieces: list[slice], start: float) -> Late | None:
    """Return what `late` does, of samples that move enough in `pieces`. start: s, near the delay."""
    total, error = start, 0.0
    for _ in range(LINEARISED):
        common = linear_in_motion(own, read_later(true, total), pieces).through(COMMON)
        if np.linalg.cond(common.information.sum(axis=0)) > SINGULAR:
            return None
        value, covariance, _ = common.jackknifed(PARTS)
        total += float(value[-1])
        error = float(np.sqrt(covariance[-1, -1]))
    delay = Measured(total, float(np.hypot(error, LEAST_ERROR)))
    about = linear_in_motion(own, read_later(true, total), pieces)
    axes = AxisDelays(about.through(APART), np.full(2, LEAST_ERROR), [sensor])
    by_axis = np.full(3, total * (abs(total) >= SURE * delay.error))
    if _apart(axes):
        by_axis = total + about.fitted()[9:]
        for _ in range(LINEARISED - 1):
            by_axis = by_axis + linear_in_motion(own, read_later(true, by_axis), pieces).fitted()[9:]
    return Late(delay, linear_in_motion(own, true, pieces).through(COMMON), axes, by_axis, pieces)


def _moving(true: Samples, length: float) -> list[slice]:
    """Return the unbroken pieces of `length` s in which the readings change most, `MOST_PIECES` at most.

    A motor or a heel makes motion rough, as noise is. A sensor's noise is at most what it reads in its
    quietest tenth.
    """
    period = sample_period(true.t)
    n = max(round(length / period), 8)
    every = [slice(i, i + n) for i in range(1, len(true) - n - 1, n)]
    every = [p for p in every if true.t[p.stop] - true.t[p.start] < 1.5 * n * period]
    power = np.array([float((np.diff(true.xyz[p], axis=0) ** 2).mean()) for p in every])
    # White noise has twice its variance in first differences, 70 times in fourth ones; motion next to none.
    rough = np.array([float((np.diff(true.xyz[p], 4, axis=0) ** 2).mean()) / 35.0 for p in every])
    noise = np.minimum(rough, np.quantile(rough, QUIETEST)) if every else rough
    sure = (power > LIVELY**2 * power.max(initial=0.0)) & (noise < NOISY * power)
    moving = [p for p, use in zip(every, sure, strict=True) if use]
    return moving[:: -(-len(moving) // MOST_PIECES)] if moving else []


def linear_in_motion(
    own: Samples, true: Samples, pieces: list[slice], more: Response | None = None
) -> Regression:
    """Return the normal equations of nine gains and three delays about none, and `more`; a piece each."""
    designs, lefts = [], []
    period = sample_period(true.t)
    for rows in pieces:
        t, now = own.t[rows], true.xyz[rows]
        before, after = (interpolate(t + step, true.t, true.xyz) for step in (-period, period))
        gain = np.einsum("ab,nc->nabc", np.eye(3), now).reshape(t.size, 3, 9)
        columns = [gain, on_axes((before - after) / (2.0 * period))]
        columns += [] if more is None else [more(rows)]
        design, left = np.concatenate(columns, axis=2), own.xyz[rows] - now
        designs.append(design - design.mean(axis=0))
        lefts.append(left - left.mean(axis=0))
    return Regression.of(designs, lefts)


def aligned(true: Samples, found: Late | None, whole: Samples | None = None) -> Samples:
    """Return what the other reads, as late as the recording reads it where that is sure.

    whole: all of its samples, where `true` lacks some: across a gap of those no spline tells what was read.
    """
    if found is None or not found.by_axis.any():
        return true
    return replace(true, xyz=read_later(whole or true, found.by_axis, true.t).xyz)


def delay_between(force: Late, rate: Late, unsure: float = 0.0) -> Measured:
    """Return by how much later the gyroscope reads against the accelerometer than the other's does, s.

    unsure: s, a standard error that it has besides. A delay of both alike is one of the stamps.
    """
    error = float(np.linalg.norm([rate.delay.error, force.delay.error, unsure]))
    return Measured(rate.delay.value - force.delay.value, error)


def hidden_delay(delay: Measured, unsure: float) -> str | None:
    """Say which delay motion shows that may be the low-passes'; None where it shows none.

    unsure: s, the standard error of what these delay, 0 without any.
    """
    if not unsure or abs(delay.value) < SURE * delay.error:
        return None
    side = "behind" if delay.value > 0 else "ahead of"
    return (
        f"the gyroscope is {abs(delay.value) * 1e3:.1f} ms further {side} the accelerometer, but what the"
        f" low-passes delay is known to {2e3 * unsure:.1f} ms only"
    )


def found_delays(
    delay: Measured, force: Late, rate: Late, samples: Samples, unsure: float = 0.0
) -> list[Finding]:
    """Return a delay between the sensors that the other does not have. samples: whose span and rate it is.

    Where the axes of a sensor have none in common, that is said, unless it may be the low-passes'. unsure: as
    for `delay_between`.
    """
    clearer = max((force, rate), key=lambda one: abs(one.delay.value) / one.delay.error)
    where = Where(
        float(samples.t[0]), float(samples.t[-1]), (0.1, 0.5 / sample_period(samples.t)), "rate of turn"
    )
    unlike = [one.axes for one in (force, rate) if one.apart and one.axes.longest > SURE * unsure]
    apart = [axes.finding(where) for axes in unlike]
    if apart:
        return [f for f in apart if f is not None]
    nats = of_vector(np.array([delay.value]), np.array([[delay.error**2]]), SIZE)
    side = "behind" if delay.value > 0 else "ahead of"
    said = direct_finding(
        DELAY,
        "timing",
        [],
        where,
        {"delay": delay.parameter("s")},
        statement=f"The gyroscope is {abs(delay.value) * 1e3:.2f} ms further {side} the accelerometer.",
        seen=DirectEvidence(nats, clearer.equations.held_out(GAINS)),
    )
    return [said] if said is not None else []
