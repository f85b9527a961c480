"""The time between the sensors, from turns between rests: gravity as the gyroscope carries it comes late.

A lever arm is fitted beside it, and what the hand does is known to last a quarter of a second.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.misfit import thresholds
from stillcal.calib_core.misfit.beyond import Regression, beyond_gravity, of_arm, of_delay, whitened
from stillcal.calib_core.misfit.quick import SIGNIFICANT, Measured, Seen, direct_finding
from stillcal.calib_core.misfit.records import Alternative, Finding, Where
from stillcal.calib_core.misfit.turns import Turn
from stillcal.calib_core.misfit.views import Baseline
from stillcal.calib_core.samples import Array, Samples

PARTS = 40
LONGEST = 0.1
LINEARISED = 3
"""Times that the model is taken about the delay found before."""

SURE = 4.0
"""Standard errors from nothing: 6e-5 two-sided, one number a recording."""

LEAST_ERROR = 2e-4
FREE = np.array([True, True, True, False])
"""What is fitted with no delay either: the arm."""


def carried_delay(
    accelerometer: Samples, baseline: Baseline, found: list[Turn], gravity: float
) -> Finding | None:
    """Find the delay of the gyroscope behind the accelerometer that all turns agree on."""
    interval = float(np.median(np.diff(found[0].t)))
    designs = [np.concatenate([of_arm(turn), of_delay(turn, gravity)], axis=2) for turn in found]
    designs = [whitened(d, interval) for d in designs]
    total = 0.0
    for _ in range(LINEARISED):
        lefts = [beyond_gravity(accelerometer, baseline, turn, gravity, total) for turn in found]
        sums = Regression.of(designs, [whitened(y, interval) for y in lefts])
        total += float(sums.fitted()[3])
        if abs(total) > LONGEST:
            return None
    error = max(float(np.sqrt(sums.jackknifed(PARTS)[1][3, 3])), _of_scatter(sums, lefts, interval))
    lefts = [whitened(beyond_gravity(accelerometer, baseline, turn, gravity), interval) for turn in found]
    # Errors from few turns are themselves uncertain: as Student's t, to first order.
    delay = Measured(total, max(error * (1.0 + 2.0 / len(found)), LEAST_ERROR))
    seen = Regression.of(designs, lefts).seen(delay.beyond(0.0, 0.0), interval, FREE)
    where = Where(found[0].end - found[0].duration, found[-1].end, (0.1, 0.5 / interval), "rate of turn")
    return delay_finding(delay, seen, where, interval, SURE)


def _of_scatter(sums: Regression, lefts: list[Array], interval: float) -> float:
    """Return the standard error that what is left of the force implies, its memory kept."""
    pairs = [whitened(y, interval) for y in lefts]
    alike = sum(float((y[1:] * y[:-1]).sum()) for y in pairs) / sum(float((y**2).sum()) for y in pairs)
    power = float(sums.left(sums.fitted()).sum() / sums.count.sum()) / 3.0
    error = power * np.linalg.inv(sums.information.sum(axis=0))[3, 3] * (1.0 + alike) / (1.0 - alike)
    return float(np.sqrt(error))


def delay_finding(
    delay: Measured, seen: Seen, where: Where, interval: float, least: float = SIGNIFICANT
) -> Finding | None:
    """State a delay that is surely not nothing and outside its tolerance; interval: of samples, s."""
    tolerance = thresholds.DELAY_TOLERANCE
    if seen.sigmas < least or delay.beyond(-tolerance, tolerance) <= thresholds.OUTSIDE:
        return None
    side = "behind" if delay.value > 0 else "ahead of"
    say = f"The gyroscope is {abs(delay.value) * 1e3:.1f} ms {side} the accelerometer; shift its stamps."
    # A second-order low-pass of this cutoff delays as much; beyond the band no noise would show it.
    cutoff = np.sqrt(2.0) / (2.0 * np.pi * abs(delay.value))
    hidden = bool(cutoff > thresholds.BANDWIDTH_LIMIT / interval)
    return direct_finding(
        "accel_gyro_time_offset",
        "timing",
        [],
        where,
        {"delay": delay.parameter("s")},
        statement=say,
        seen=seen,
        alternatives=[Alternative("bandwidth", seen.gain, indistinguishable=hidden)],
    )
