"""A delay between the sensors that changes with time: clocks that run apart, or a queue that grows.

One delay then fits the middle of the recording only. Its growth with time is fitted beside it, and held
against how windows of motion, frequencies and directions disagree about it.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    Measured,
    direct_finding,
    of_chance,
)
from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.motion.axis_delays import ALIKE, UNLIKELY
from stillcal.calib_core.diagnosis.motion.block_regression import STRETCHES, Regression
from stillcal.calib_core.maths.f_distribution import log_tail

DRIVER = "rate of turn, with time"


class DelayTrend:
    """By how much a delay grows from the first window to the last.

    growth: s, with its error; middle: s, the delay halfway; log_chance: of a delay that stays being seen to
    grow so much.
    """

    def __init__(self, sums: Regression, apart: float, delay: float, growth: float) -> None:
        """Estimate both by the last two columns of a regression about `delay` and `growth`, s.

        The one delay that fits best is no middle of the course: it is that of the windows that tell most.
        apart: s, how parts disagree about the growth.
        """
        fitted, covariance, _ = sums.jackknifed(STRETCHES, in_a_row=True)
        error = float(np.sqrt(covariance[-1, -1] + apart**2 + ALIKE**2))
        self.middle = delay + float(fitted[-2])
        self.growth = Measured(growth + float(fitted[-1]), error)
        free = min(STRETCHES, len(sums.power)) - 1
        self.log_chance = log_tail((self.growth.value / error) ** 2, 1, free)

    @property
    def grows(self) -> bool:
        """Whether one delay at all times does not fit."""
        return self.log_chance < float(np.log(UNLIKELY))

    def finding(self, where: Where, least: float = 0.0) -> Finding | None:
        """State a delay that grows; least: nats for what shows anyway."""
        first, last = (1e3 * (self.middle + sign * self.growth.value) for sign in (-0.5, 0.5))
        say = (
            f"The gyroscope's delay behind the accelerometer changes from {first:.1f} to {last:.1f} ms in the"
            " course of the recording."
        )
        there = Where(where.t_start, where.t_end, where.band_hz, DRIVER)
        seen = DirectEvidence(max(of_chance(self.log_chance), least))
        sizes = {"growth": self.growth.parameter("s")}
        return direct_finding("unknown", "timing", [], there, sizes, statement=say, seen=seen)
