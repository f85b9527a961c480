"""The budget of sensor on-time: a token bucket that refills slowly and is spent where it helps most.

Low power is the central claim of Grammenos et al. 2018 (5.3). Instead of one fixed duty cycle, on-time is
saved up and spent where it brings a calibration nearer: a new phone is sensed without a break until the
bucket is empty, then probed now and then; a calibrated phone is left alone.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EnergySettings:
    """The size of the bucket and the rate at which it refills.

    burst_s: s of sensing that can be saved up, the bucket's capacity; an hour lets a new phone gather its
    first attitudes unbroken. on_time_fraction: s of sensing earned per s, the long-term duty cycle.
    """

    burst_s: float = 3600.0
    on_time_fraction: float = 0.03

    def __post_init__(self) -> None:
        if not 0 <= self.burst_s < float("inf"):
            raise ValueError(f"burst_s = {self.burst_s}: must be 0 or more seconds")
        if not 0 <= self.on_time_fraction <= 1:
            raise ValueError(f"on_time_fraction = {self.on_time_fraction}: must be within 0..1")


@dataclass(frozen=True, slots=True)
class DutyBudget:
    """The budget at one time.

    t: s, that time. saved: s of on-time in the bucket. used: s for which the sensors had been on until then.
    """

    t: float
    saved: float
    used: float

    def at(self, t: float, used: float, settings: EnergySettings) -> DutyBudget:
        """Return the budget at a later time t (s); used: s of on-time since the beginning."""
        earned = settings.on_time_fraction * (t - self.t)
        saved = min(self.saved + earned - (used - self.used), settings.burst_s)
        return DutyBudget(t, saved, used)

    def remaining_s(self, settings: EnergySettings) -> float:
        """Return for how long the budget allows unbroken sensing, s."""
        if self.saved <= 0:
            return 0.0
        if settings.on_time_fraction >= 1:
            return float("inf")
        return self.saved / (1 - settings.on_time_fraction)
