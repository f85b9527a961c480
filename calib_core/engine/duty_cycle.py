"""How much sensing the engine allows itself: an allowance of sensor on-time that refills slowly.

Power is the paper's central claim (Grammenos et al. 2018, 5.3). Instead of one duty cycle for all
times, on-time is saved up and spent where it brings a calibration nearer: a new phone is watched
without a break while its burst lasts, then probed, and a calibrated one is left alone.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EnergySettings:
    """burst_s: s of unbroken sensing that can be saved up. on_time_fraction: share of time earned."""

    burst_s: float = 3600.0
    on_time_fraction: float = 0.03

    def __post_init__(self) -> None:
        if not 0 <= self.burst_s < float("inf"):
            raise ValueError(f"burst_s = {self.burst_s}: must be 0 or more seconds")
        if not 0 <= self.on_time_fraction <= 1:
            raise ValueError(f"on_time_fraction = {self.on_time_fraction}: must be within 0..1")


@dataclass(frozen=True, slots=True)
class DutyBudget:
    """On-time saved up, in s, as it stood at time t (s), when the sensors had been on for `used` s."""

    t: float
    saved: float
    used: float

    def at(self, t: float, used: float, settings: EnergySettings) -> DutyBudget:
        """Bring the allowance to time t, with `used` s of on-time spent since the beginning."""
        earned = settings.on_time_fraction * (t - self.t)
        saved = min(self.saved + earned - (used - self.used), settings.burst_s)
        return DutyBudget(t, saved, used)

    def remaining_s(self, settings: EnergySettings) -> float:
        """Return how many s of unbroken sensing the allowance pays for."""
        if self.saved <= 0:
            return 0.0
        if settings.on_time_fraction >= 1:
            return float("inf")
        return self.saved / (1 - settings.on_time_fraction)
