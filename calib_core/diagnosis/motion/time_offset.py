"""What motion says of the time between the sensors, and of where the accelerometer sits."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.measurement import Measured, direct_finding, of_measured
from stillcal.calib_core.diagnosis.model.records import Alternative, Finding, Where
from stillcal.calib_core.diagnosis.model.rotation_alignment import Aligned
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.diagnosis.motion.axis_delays import AxisDelays
from stillcal.calib_core.diagnosis.motion.block_regression import PARTS
from stillcal.calib_core.diagnosis.motion.delay_fit import Fit, drawn, fitted, summed
from stillcal.calib_core.diagnosis.motion.group_delay import DELAY, FilterDelay
from stillcal.calib_core.diagnosis.motion.lever_arm import lever_arm
from stillcal.calib_core.diagnosis.motion.turning_windows import LONGEST, WINDOW, Motion, RateNoise, Span
from stillcal.calib_core.diagnosis.segments.sample_period import bunched, sample_period
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Samples

LEAST_WINDOWS = 12
SLOW = 0.05
"""Part of the sample rate that a figure is made of."""

LEAST_ERROR = 2e-4

DELIVERED = "the stamps come in bursts: they say when samples were delivered, not when they were measured"
"""Why nothing is looked for: in a burst a turn seems faster than it was, by more than a delay or an arm."""

NOISY = "the noise of its rates hides how it turns"
"""Why nothing is looked for: in turns there is no frequency at which most of the rate is motion."""

ARM = np.array([True, True, True, False])
"""The columns of an arm; the fourth is the delay's."""

TRAPEZOID = 12.0
"""Straight lines between samples at an interval h turn the phone otherwise by h^2 / 12 of the rate's slope,
and gravity with it, as an arm of gravity h^2 / 12 does. A shorter one may be what happens between samples."""


@dataclass(frozen=True, slots=True)
class Shown:
    """What motion shows.

    delay: of the gyroscope behind the accelerometer, s, less what low-passes cause; None where it is not
    known, or not one number. why_none: the reason, "" where motion is too little to look for it.
    """

    findings: list[Finding]
    delay: Measured | None = None
    why_none: str = ""


def shown_in_motion(
    accelerometer: Samples,
    gyroscope: Samples,
    affine: Aligned | None,
    gravity: float,
    usual: Usual,
    *,
    spoiled: Sequence[Span] = (),
    filters: FilterDelay | None = None,
    untold: Collection[str] = (),
    noise: RateNoise | None = None,
) -> Shown:
    """Return what motion shows; nothing where there is too little.

    affine: what rests and turns say of the sensors, None without rests; usual: of the delay, s; spoiled: when
    not to look; filters: what low-passes delay, which is no delay of the stamps.
    """
    if len(gyroscope) < 200:
        return Shown([])
    if bunched(accelerometer.t) or bunched(gyroscope.t):
        return Shown([], why_none=DELIVERED)
    motion = Motion.of(accelerometer, gyroscope, affine, gravity, spoiled, noise=noise)
    if sum(w.moves.any() for w in motion.windows) < LEAST_WINDOWS:
        return Shown([], why_none=NOISY if len(motion.windows) >= LEAST_WINDOWS else "")
    interval = sample_period(gyroscope.t)
    fit = fitted(motion)
    where = Where(*motion.span(), (0.1, 0.5 / interval), "rate of turn")
    error = float(np.hypot(np.sqrt(fit.last.sums.jackknifed(PARTS)[1][3, 3]), fit.delay_apart))
    # Errors from few windows are themselves uncertain: about Student's t at four standard deviations.
    total = Measured(fit.delay, max(error * (1.0 + 6.0 / len(motion.windows)), LEAST_ERROR))
    delayed = partial(_delayed, fit=fit, usual=usual, where=where, interval=interval, untold=untold)
    filters = _likely(filters, total, delayed)
    beyond = total if filters is None else filters.beyond(total)
    whole, late = delayed(total), delayed(beyond)
    axes, trend = fit.axes(motion), fit.trend(motion)
    grows = trend.grows and not (filters is not None and filters.explains_growth(trend.growth.value))
    surely = 0.0 if late is None else late.evidence.log_bayes_factor
    several = axes.differ or grows
    by_time = trend.log_chance < axes.log_chance and (grows or not axes.differ)
    if several or (late is None and filters is None):
        late = trend.finding(where, surely) if by_time else _apart(axes, where, surely)
    arm, cause = lever_arm(fit.last.sums.only(ARM), fit.arm_apart, where), None
    length = 0.0 if arm is None else float(np.linalg.norm(arm.parameters["position"].value))
    if length < gravity * interval**2 / TRAPEZOID or (filters and filters.explains_arm(length, gravity)):
        arm = None
    if filters is not None:
        cause = None if whole is None else filters.finding(whole, total, alone=late is None)
    findings = [f for f in (late, arm, cause) if f]
    if several:
        return Shown(findings, None, _why_several(by_time=by_time, sure=late is not None))
    if abs(beyond.value) >= LONGEST:
        return Shown(findings, None, f"its turns tell none below {LONGEST} s")
    return Shown(findings, beyond)


def _likely(
    filters: FilterDelay | None, total: Measured, delayed: Callable[[Measured], Finding | None]
) -> FilterDelay | None:
    """Return the low-passes; None where motion shows no delay, and stamps would have to undo theirs.

    More likely is then a spectrum that vibration at rest has shaped. delayed: states a delay, or nothing.
    """
    if filters is None or delayed(total) is not None or delayed(filters.beyond(total)) is None:
        return filters
    return None


def _apart(axes: AxisDelays, where: Where, surely: float) -> Finding | None:
    """State axes that are late by different times; nothing by `LONGEST` and more, which is something else's.

    A road that shakes a car pushes and turns a phone in it at once, as delays of 2 s would.
    """
    return axes.finding(where, surely) if axes.longest < LONGEST else None


def _why_several(*, by_time: bool, sure: bool) -> str:
    """Say why there is no one delay. sure: whether that there are several is a finding."""
    if by_time:
        return "it changes in the course of the recording" if sure else f"its early and late turns {UNTOLD}"
    return "its axes are late by different times" if sure else f"its axes {UNTOLD}"


UNTOLD = "do not agree about it, by how the hand moves it or by more than one delay"
"""Said where one delay does not fit, and that there are several is not sure either."""


def power_over_delays(
    accelerometer: Samples,
    gyroscope: Samples,
    affine: Aligned | None,
    delays: Array,
    gravity: float = STANDARD,
    *,
    spoiled: Sequence[Span] = (),
) -> Array | None:
    """Return what motion leaves if the gyroscope is late by each of `delays` (n,) s, over the least, (n,).

    It is the weighed power of the accelerometer less gravity as the gyroscope carries it, with the lever arm
    fitted at each delay, from `DRAWN` windows at most and below `SLOW` of the accelerometer's rate: there the
    power does not depend on where between two samples a delay falls. None where the phone turns too little.
    """
    motion = Motion.of(accelerometer, gyroscope, affine, gravity, spoiled)
    if len(motion.windows) < LEAST_WINDOWS:
        return None
    motion = replace(motion, windows=drawn(motion.windows))
    weight = fitted(motion).last.weight
    highest = SLOW / sample_period(accelerometer.t)
    weight = np.where(np.arange(weight.shape[1]) / WINDOW <= highest, weight, 0.0)
    left = []
    for delay in delays:
        arm = summed(*motion.equations(float(delay)), weight).only(ARM)
        left.append(float(arm.left(arm.fitted()).sum()))
    return np.asarray(left) / min(left)


def _delayed(
    delay: Measured, fit: Fit, usual: Usual, where: Where, interval: float, *, untold: Collection[str]
) -> Finding | None:
    """State a delay that no sound phone has; interval: of samples, s; untold: sensors of hidden noise."""
    if abs(delay.value) >= LONGEST:
        return None
    side = "behind" if delay.value > 0 else "ahead of"
    say = f"The gyroscope is {abs(delay.value) * 1e3:.1f} ms {side} the accelerometer; shift its time stamps."
    seen = of_measured(delay, usual, fit.last.sums.held_out(ARM, without=fit.first))
    # A second-order low-pass of this cutoff delays as much; beyond the band no noise would show it.
    cutoff = np.sqrt(2.0) / (2.0 * np.pi * abs(delay.value))
    late = "gyro" if delay.value > 0 else "accel"
    hidden = bool(cutoff > thresholds.BANDWIDTH_LIMIT / interval) or late in untold
    return direct_finding(
        DELAY,
        "timing",
        [],
        where,
        {"delay": delay.parameter("s")},
        statement=say,
        seen=seen,
        alternatives=[Alternative("bandwidth", seen.held_out.gain, True)] if hidden and seen.held_out else [],
    )
