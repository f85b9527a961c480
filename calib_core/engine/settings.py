"""The settings of the engine: its schedule, and the settings of all the parts that it runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from stillcal.calib_core.calibration.candidate import CalibrateSettings
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.rest_pool import PoolSettings
from stillcal.calib_core.engine.duty_cycle import EnergySettings
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegmentSettings
from stillcal.calib_core.static.settings import DetectorSettings


class Watch(StrEnum):
    """How the sensors are used at the moment: without a break, in probes now and then, or not at all."""

    CONTINUOUS = "continuous"
    PROBING = "probing"
    IDLE = "idle"


MOST_INTERVAL_S = 1e9
"""The longest time between two of anything, s: 32 years."""

MOST_PATIENCE_S = 3600.0
"""How long samples of one sensor may have to be kept for want of the other's, s."""


@dataclass(frozen=True, slots=True)
class ScheduleSettings:
    """When the engine does what; all times in s of sample time.

    watch: "auto" spends the duty-cycle budget; "continuous" and "probing" force one way of sensing.
    check_interval_s: between two checks of the calibration (hourly: Grammenos et al. 2018, 4.7).
    review_interval_s: between two reviews of what was gathered. recalibrate_interval_s: at least this long
    between two full calibrations on charging. attitudes_wanted: number of distinct attitudes after which
    gathering pauses (s in Algorithm 1). gravity: local g in m/s^2 if it is known, else None.
    gyro_patience_s: how far the gyroscope's stream may lag behind the accelerometer's.
    diagnose_after_checks: how many checks in a row may fail after a new calibration before a diagnosis is
    asked for. learn_temperature: whether biases are learnt by temperature and time. wanted_force,
    wanted_rate: m/s^2 and rad/s; where a bias is expected to wander by more (1 sd) before the next check is
    due, it is checked earlier, as long as any of the duty-cycle budget is left.
    """

    watch: Literal["auto", "continuous", "probing"] = "auto"
    check_interval_s: float = 3600.0
    review_interval_s: float = 60.0
    recalibrate_interval_s: float = 6 * 3600.0
    attitudes_wanted: int = 30
    gravity: float | None = None
    gyro_patience_s: float = 5.0
    diagnose_after_checks: int = 3
    learn_temperature: bool = True
    wanted_force: float = 1e-3
    wanted_rate: float = 1e-5

    def __post_init__(self) -> None:
        for name in ("check_interval_s", "review_interval_s", "recalibrate_interval_s"):
            if not 1.0 <= getattr(self, name) <= MOST_INTERVAL_S:
                raise ValueError(f"{name} = {getattr(self, name)}: must be within 1..{MOST_INTERVAL_S:g} s")
        if not 0 < self.gyro_patience_s <= MOST_PATIENCE_S:
            raise ValueError(
                f"gyro_patience_s = {self.gyro_patience_s}: must be above 0, at most {MOST_PATIENCE_S:g} s"
            )
        if self.gravity is not None and not 9.7 <= self.gravity <= 9.9:
            raise ValueError(f"gravity = {self.gravity}: must be the earth's, 9.7..9.9 m/s^2")
        if self.watch not in {"auto", *(str(w) for w in Watch if w is not Watch.IDLE)}:
            raise ValueError(f"watch = {self.watch!r}: must be auto, continuous or probing")
        if self.attitudes_wanted < 6:
            raise ValueError(f"attitudes_wanted = {self.attitudes_wanted}: must be 6 or more")
        for name in ("wanted_force", "wanted_rate"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} = {getattr(self, name)}: must be positive")
        if self.diagnose_after_checks < 1:
            raise ValueError(f"diagnose_after_checks = {self.diagnose_after_checks}: must be 1 or more")


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """All settings of the engine, by part."""

    schedule: ScheduleSettings = field(default_factory=ScheduleSettings)
    energy: EnergySettings = field(default_factory=EnergySettings)
    detector: DetectorSettings = field(default_factory=DetectorSettings)
    pool: PoolSettings = field(default_factory=PoolSettings)
    turns: RotationSegmentSettings = field(default_factory=RotationSegmentSettings)
    calibrate: CalibrateSettings = field(default_factory=CalibrateSettings)
    quality: QualitySettings = field(default_factory=QualitySettings)
