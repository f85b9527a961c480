"""By how much one sensor's readings come later than another's of the same motion.

Late readings differ by the delay times their own rate of change. In means over some seconds that looks like a
wrong scale, or like a bias that jumps with the motion, so readings are aligned before they are compared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.diagnosis.model.measurement import Measured, Seen, direct_finding, of_vector
from stillcal.calib_core.diagnosis.model.records import Finding, Where
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

LINEARISED = 3
"""Times that the model is taken about the delay found before."""

SINGULAR = 1e12
"""Condition of the equations from which motion does not tell a delay from a scale."""

LIVELY = 0.1
"""Part of the rms rate of change of the liveliest piece from which a piece counts as moving."""

NOISY = 0.02
"""Part of a piece's changes that may be noise of the other sensor, by which a delay would seem smaller."""

SIZE = 0.01
"""Prior standard deviation of a delay, s: a sample of a phone's usual rate."""

GAINS = np.array([*[True] * 9, False])
"""The columns of scale and misalignment; the tenth is the delay's."""

SURE = 4.0
"""Standard errors from which readings are aligned."""

LEAST_ERROR = 2e-5
"""s: stamps are printed with six digits at best, and readings between them are interpolated."""


@dataclass(frozen=True, slots=True, eq=False)
class Late:
    """A delay of one sensor's readings, s, with the normal equations that it comes from."""

    delay: Measured
    equations: Regression


def late(own: Samples, true: Samples) -> Late | None:
    """Return by how much `own` reads later than `true`, at the same stamps; None with too little motion.

    Least squares of the difference of the readings on what scale and misalignment do, and on the rate of
    change. The error is that of leaving pieces out.
    """
    every = (_moving(true, length) for length in PIECES)
    pieces = next((pieces for pieces in every if len(pieces) >= LEAST_PIECES), None)
    if pieces is None:
        return None
    total, error = 0.0, 0.0
    for _ in range(LINEARISED):
        equations = _equations(own, true, pieces, total)
        if np.linalg.cond(equations.information.sum(axis=0)) > SINGULAR:
            return None
        value, covariance, _ = equations.jackknifed(PARTS)
        total += float(value[-1])
        error = float(np.sqrt(covariance[-1, -1]))
    return Late(Measured(total, float(np.hypot(error, LEAST_ERROR))), _equations(own, true, pieces, 0.0))


def _moving(true: Samples, length: float) -> list[slice]:
    """Return the unbroken pieces of `length` s in which the readings change most, `MOST_PIECES` at most."""
    period = sample_period(true.t)
    n = max(round(length / period), 8)
    every = [slice(i, i + n) for i in range(1, len(true) - n - 1, n)]
    every = [p for p in every if true.t[p.stop] - true.t[p.start] < 1.5 * n * period]
    power = np.array([float((np.diff(true.xyz[p], axis=0) ** 2).mean()) for p in every])
    # White noise has twice its variance in first differences, 70 times in fourth ones; motion next to none.
    noise = np.array([float((np.diff(true.xyz[p], 4, axis=0) ** 2).mean()) / 35.0 for p in every])
    sure = (power > LIVELY**2 * power.max(initial=0.0)) & (noise < NOISY * power)
    moving = [p for p, use in zip(every, sure, strict=True) if use]
    return moving[:: -(-len(moving) // MOST_PIECES)] if moving else []


def _equations(own: Samples, true: Samples, pieces: list[slice], delay: float) -> Regression:
    """Return the normal equations of nine gains and of what is left of the delay, s; a piece each."""
    designs, lefts = [], []
    period = sample_period(true.t)
    for rows in pieces:
        t = own.t[rows]
        before, now, after = (
            interpolate(t - delay + step, true.t, true.xyz) for step in (-period, 0.0, period)
        )
        gain = np.einsum("ab,nc->nabc", np.eye(3), now).reshape(t.size, 3, 9)
        change = (before - after) / (2.0 * period)
        design, left = np.concatenate([gain, change[:, :, None]], axis=2), own.xyz[rows] - now
        designs.append(design - design.mean(axis=0))
        lefts.append(left - left.mean(axis=0))
    return Regression.of(designs, lefts)


def aligned(true: Samples, found: Late | None) -> Samples:
    """Return what the other reads, as late as the recording reads it where that is sure."""
    sure = found is not None and abs(found.delay.value) >= SURE * found.delay.error
    return read_later(true, found.delay.value) if found is not None and sure else true


def delay_between(force: Late, rate: Late, samples: Samples, unsure: float = 0.0) -> Finding | None:
    """Return a delay of the gyroscope against the accelerometer that the other does not have.

    samples: of the recording, whose span and rate it is; unsure: s, a standard error that it has besides. A
    delay of both alike is one of the stamps.
    """
    error = float(np.linalg.norm([rate.delay.error, force.delay.error, unsure]))
    delay = Measured(rate.delay.value - force.delay.value, error)
    clearer = max((force, rate), key=lambda one: abs(one.delay.value) / one.delay.error)
    span = float(samples.t[0]), float(samples.t[-1])
    nats = of_vector(np.array([delay.value]), np.array([[delay.error**2]]), SIZE)
    side = "behind" if delay.value > 0 else "ahead of"
    return direct_finding(
        DELAY,
        "timing",
        [],
        Where(*span, (0.1, 0.5 / sample_period(samples.t)), "rate of turn"),
        {"delay": delay.parameter("s")},
        statement=f"The gyroscope is {abs(delay.value) * 1e3:.2f} ms further {side} the accelerometer.",
        seen=Seen(nats, clearer.equations.held_out(GAINS)),
    )
