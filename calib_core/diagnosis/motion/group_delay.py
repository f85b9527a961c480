"""What a low-pass of one sensor does to motion: it delays it, and looks like a delay or like a lever arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, Measured
from stillcal.calib_core.diagnosis.model.records import AT_REST, Alternative, Finding, Where
from stillcal.calib_core.diagnosis.noise.low_pass import LowPass, Spectra, low_pass_finding

DELAY = "accel_gyro_time_offset"

UNSURE = 0.15
"""Part of 1 / (2 pi cutoff) by which a low-pass' delay is unsure, besides what its kinds that fit differ."""

ANY_ORDER = 0.8
"""The same where the order is not known: filters of the first to the fourth order delay by 1 to 2.6 of it."""

MOST = 3.0
"""A low-pass delays no motion by more than so many times 1 / (2 pi cutoff), up to the fourth order."""


@dataclass(frozen=True, slots=True, eq=False)
class FilterDelay:
    """The gyroscope's delay behind the accelerometer, s, by low-passes that the noise of the two shows.

    sensor: the later one; spectrum: its noise; unit: s, by how much 1 / (2 pi cutoff) of the two differ.
    """

    delay: Measured
    sensor: str
    spectrum: Spectra
    unit: float

    @classmethod
    def of(cls, spectra: Mapping[str, Spectra]) -> FilterDelay | None:
        """Return it; None where no low-pass is seen, or both sensors have the same one.

        spectra: of the sensors whose noise tells whether it is filtered. Where that of one does not, it may
        have the same low-pass as the other, as most chips have, or none. Of two alike, one may seem wider
        than what is a finding, and the other not. One of some axes alone delays these (`Stream.in_step`).
        """
        if all(one.low_pass is None for one in spectra.values()):
            return None
        every = {s: one.low_pass or one.wide for s, one in spectra.items()}
        seen = {s: one for s, one in every.items() if one is not None and one.on_all}
        late = {s: one.late.value for s, one in seen.items()}
        units = {s: _unit(one) for s, one in seen.items()}
        expected = late.get("gyro", 0.0) - late.get("accel", 0.0)
        if expected == 0.0:
            return None
        sensor = "gyro" if expected > 0.0 else "accel"
        unit = abs(units.get("gyro", 0.0) - units.get("accel", 0.0))
        own = [units[s] * one.cutoff.error / one.cutoff.value for s, one in seen.items()]
        own.extend(one.late.error for one in seen.values())
        unsure = UNSURE if all(one.order_known for one in seen.values()) else ANY_ORDER
        shared = 0.5 * expected if len(spectra) < 2 else 0.0
        error = float(np.linalg.norm([unsure * unit, *own, shared]))
        return cls(Measured(expected - shared, error), sensor, spectra[sensor], unit)

    def beyond(self, delay: Measured) -> Measured:
        """Return what is left of a delay that was measured."""
        return Measured(delay.value - self.delay.value, float(np.hypot(delay.error, self.delay.error)))

    def explains_arm(self, position: float, gravity: float) -> bool:
        """Whether a lever arm of a length `position`, m, is what a low-pass makes of gravity's own turning.

        To second order it takes its curvature for as much of an arm as gravity / (2 pi cutoff)^2.
        """
        return position < gravity * self.unit**2

    def explains_growth(self, growth: float) -> bool:
        """Whether a delay that grows by so much, s, may be one low-pass' for slow and for fast motion.

        A steeper one than of the fourth order delays by more.
        """
        return abs(growth) < max(MOST * self.unit, abs(self.delay.value))

    def finding(self, delay: Finding, total: Measured, *, alone: bool) -> Finding | None:
        """Return the low-pass that a delay confirms; None where the low-pass causes less than half of it.

        Many a sound phone has such a filter on both sensors, which then do not differ. On one of them alone
        it delays that one, so the delay is its evidence. alone: whether nothing else of a delay is stated:
        stamps that are late could then cause it too.
        """
        if abs(total.value - self.delay.value) > abs(self.delay.value):
            return None
        where = Where(delay.where.t_start, delay.where.t_end, (0.0, self.spectrum.rate / 2.0), AT_REST)
        own = delay.evidence
        others = [Alternative(DELAY, own.heldout_log_score_gain or 0.0, True)] if alone else []
        return low_pass_finding(
            self.spectrum, self.sensor, where, DirectEvidence(own.log_bayes_factor), others
        )


def _unit(low_pass: LowPass) -> float:
    return 1.0 / (2.0 * np.pi * low_pass.cutoff.value)
