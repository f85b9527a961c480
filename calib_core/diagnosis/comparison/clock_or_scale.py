"""A gyroscope's scale that is alike on all axes: a clock whose stamps run fast or slow makes such a one.

A gyroscope gives rates, and stamps say how long they lasted. Stamps that run fast by a part make every turn
too large by it, and as many samples a second too few.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.comparison.quantity import Difference
from stillcal.calib_core.diagnosis.comparison.records import Discrepancy
from stillcal.calib_core.diagnosis.comparison.sample_rate import exactly_even
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.measurement import Measured
from stillcal.calib_core.diagnosis.model.records import Alternative
from stillcal.calib_core.diagnosis.stamps.clock import arrivals
from stillcal.calib_core.maths.chi_squared import log_tail

SCALE, CLOCK = "gyro_scale", "clock_skew"

ALIKE = np.log(0.01)
"""Chance of axes that differ as much, if they are alike, from which on they count as such."""

SURE = 3.0
"""Standard errors by which two numbers of one size may differ."""


def with_clock(
    found: Sequence[Discrepancy], compared: Sequence[Difference], exam: Examination, name: str
) -> list[Discrepancy]:
    """Return differences, a gyroscope's scale with the clock that may have made it.

    compared: all that was measured in both; exam, name: of the recording.
    """
    rates = [d for d in compared if d.recorded.effect == "sample_rate"]
    return [_with_clock(d, rates, exam, name) if d.effect == SCALE else d for d in found]


def _with_clock(scale: Discrepancy, rates: Sequence[Difference], exam: Examination, name: str) -> Discrepancy:
    common = None if scale.difference is None else _common(scale.difference)
    gyroscope = exam.gyroscope
    if scale.difference is None or common is None or gyroscope is None or arrivals(gyroscope) is not None:
        return scale
    size = f"{100.0 * abs(common.value):.2g} %"
    if any(_as_large(common, rate) for rate in rates):
        side = "fast" if common.value < 0.0 else "slow"
        why = f"the sample rates differ by as much: stamps that run {size} {side} make both"
    elif exactly_even(gyroscope.t):
        side = "faster" if common.value < 0.0 else "slower"
        why = (
            f"the stamps of {name} are even, as computed and not taken from a clock: samples that come {size}"
            f" {side} than they say make as much"
        )
    else:
        return scale
    note = f"Within its errors the scale is alike on all axes, and {why}."
    if _misaligned(scale.difference):
        note += " The misalignment is not the clock's."
    return replace(scale, alternatives=(Alternative(CLOCK, 0.0, True),), note=note)


def _common(difference: Difference) -> Measured | None:
    """Return the scale that all axes have in common; None where they differ, or it may be nothing.

    Misalignment is no clock's, and may be there as well.
    """
    one, own = np.ones(3), np.arange(0, 9, 4)
    apart = (difference.covariance + np.diag(difference.recorded.tolerance**2))[np.ix_(own, own)]
    weight, value = np.linalg.inv(apart), difference.value[own]
    error = float(1.0 / np.sqrt(one @ weight @ one))
    common = float(one @ weight @ value) * error**2
    left = value - common
    alike = log_tail(float(left @ weight @ left), one.size - 1) > ALIKE
    return Measured(common, error) if alike and abs(common) > SURE * error else None


def _misaligned(difference: Difference) -> bool:
    """Whether axes read more of each other than by chance, which no clock makes."""
    other = [i for i in range(9) if i % 4]
    apart = (difference.covariance + np.diag(difference.recorded.tolerance**2))[np.ix_(other, other)]
    value = difference.value[other]
    return bool(log_tail(float(value @ np.linalg.solve(apart, value)), len(other)) < ALIKE)


def _as_large(common: Measured, rate: Difference) -> bool:
    error = np.hypot(common.error, float(rate.sigma[0]))
    return bool(abs(common.value - float(rate.value[0])) < SURE * error)
