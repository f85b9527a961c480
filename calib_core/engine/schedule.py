"""What the engine looks at and when it calibrates: every timing decision, as pure functions.

Times are s of sample time. The engine asks; nothing here remembers anything.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal


class Watch(StrEnum):
    """How the engine is looking at the moment."""

    CONTINUOUS = "continuous"
    PROBING = "probing"
    IDLE = "idle"


@dataclass(frozen=True, slots=True)
class ScheduleSettings:
    """When the engine does what; all times in s of sample time.

    watch: "auto" spends the energy allowance; "continuous" and "probing" force one way of looking.
    check_interval_s: between quality checks (4.7: hourly). review_interval_s: between looks at what is
    gathered. recalibrate_interval_s: at least this long between two full calibrations on charging.
    attitudes_wanted: distinct attitudes after which gathering rests (Algorithm 1's s). gravity: local g
    in m/s^2 if known, else None. gyro_patience_s: how far the gyroscope's stream may lag.
    diagnose_after_checks: how many checks in a row may fail after a calibration before it asks for help.
    """

    watch: Literal["auto", "continuous", "probing"] = "auto"
    check_interval_s: float = 3600.0
    review_interval_s: float = 60.0
    recalibrate_interval_s: float = 6 * 3600.0
    attitudes_wanted: int = 30
    gravity: float | None = None
    gyro_patience_s: float = 5.0
    diagnose_after_checks: int = 3

    def __post_init__(self) -> None:
        for name in ("check_interval_s", "review_interval_s", "recalibrate_interval_s", "gyro_patience_s"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} = {getattr(self, name)}: must be positive seconds")
        if self.gravity is not None and not 9.7 <= self.gravity <= 9.9:
            raise ValueError(f"gravity = {self.gravity}: must be the earth's, 9.7..9.9 m/s^2")
        if self.watch not in {"auto", *(str(w) for w in Watch if w is not Watch.IDLE)}:
            raise ValueError(f"watch = {self.watch!r}: must be auto, continuous or probing")
        if self.attitudes_wanted < 6:
            raise ValueError(f"attitudes_wanted = {self.attitudes_wanted}: must be 6 or more")
        if self.diagnose_after_checks < 1:
            raise ValueError(f"diagnose_after_checks = {self.diagnose_after_checks}: must be 1 or more")


@dataclass(frozen=True, slots=True)
class Need:
    """What is still wanted. rests: attitudes are missing; check: a check waits for a rest."""

    rests: bool
    check: bool


def watch_for(
    need: Need, current: Watch, remaining_s: float, capacity_s: float, settings: ScheduleSettings
) -> Watch:
    """Choose how to look on, given how long (s) the energy allowance would last.

    Unbroken watching begins only with half the burst saved up and goes on until it is spent, so that the
    sensors are not switched to and fro; a check alone is worth probing only, and worth an overdraft.
    """
    if settings.watch != "auto":
        return Watch(settings.watch)
    if need.rests and remaining_s > 0 and (current is Watch.CONTINUOUS or remaining_s >= capacity_s / 2):
        return Watch.CONTINUOUS
    return Watch.PROBING if need.check or (need.rests and remaining_s > 0) else Watch.IDLE


def next_on_grid(began: float, interval: float, after: float) -> float:
    """Return the first of the times began + k interval (k = 1, 2, ...) that lies past `after`.

    Deadlines stay on their grid across gaps, so that schedules do not drift.
    """
    return began + interval * max(1, math.floor((after - began) / interval) + 1)


class Occasion(StrEnum):
    """What may bring about a full calibration."""

    CHARGING = "charging"
    UNPLUGGED = "no charger was ever reported"
    END = "the recording ended"
    ASKED = "asked for"


@dataclass(frozen=True, slots=True)
class Standing:
    """Where calibration stands.

    fresh: rests gathered since the last try to fit. since_try: s since that try, inf where there was none.
    """

    has_record: bool
    degraded: bool
    fresh: int
    since_try: float


def calibration_due(standing: Standing, occasion: Occasion, settings: ScheduleSettings) -> bool:
    """Say whether a full calibration is worth trying: never without rests gathered since the last try.

    A phone without a calibration does not wait; one whose calibration failed its check waits for the
    next. A recording that ends has no later chance. Who asks is always answered.
    """
    if occasion is Occasion.ASKED:
        return True
    if standing.fresh == 0:
        return False
    if not standing.has_record or occasion is Occasion.END:
        return True
    return standing.since_try >= least_wait(standing.degraded, settings)


def least_wait(degraded: bool, settings: ScheduleSettings) -> float:
    """Return how long (s) after a try to fit the next may come, where there is a calibration already."""
    return settings.check_interval_s if degraded else settings.recalibrate_interval_s
