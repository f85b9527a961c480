"""The static detector's settings, its requests to the sensors, its labels and its ledger, as plain records.

Source: Grammenos et al. 2018, section 4.4 and Algorithm 1, called "the paper" in this package.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum

from stillcal.calib_core.ranges import check_ranges


class Mode(StrEnum):
    """How the detector runs: `scan` uses all samples, `probe` asks for some now and then (Algorithm 1)."""

    SCAN = "scan"
    PROBE = "probe"


class Label(StrEnum):
    """How one window, or one candidate rest, was classified."""

    STILL = "still"
    ACCEL_MOVING = "accel_moving"
    GYRO_MOVING = "gyro_moving"
    STEPPED = "stepped"
    FROZEN = "frozen"
    GAP = "gap"
    SPARSE = "sparse"
    IMPLAUSIBLE = "implausible"
    SHORT = "short"
    TILTING = "tilting"


@dataclass(frozen=True, slots=True)
class Sense:
    """A request for both sensors on now, and for samples up to time `until`, s (inf: without end)."""

    until: float


@dataclass(frozen=True, slots=True)
class Sleep:
    """No samples are wanted before time `until`, s."""

    until: float


Want = Sense | Sleep


_ALLOWED = {
    "window_s": (0.1, 5.0),
    "min_samples": (4, 1000),
    "gap_s": (0.01, 10.0),
    "max_lag_s": (0.0, 3600.0),
    "accel_factor": (1.0, 100.0),
    "gyro_factor": (1.0, 100.0),
    "accel_ceiling": (1e-6, 10.0),
    "gyro_ceiling": (1e-6, 10.0),
    "force_low": (0.0, 9.0),
    "force_high": (10.5, 100.0),
    "step_factor": (1.0, 100.0),
    "force_step": (0.0, 1.0),
    "rate_step": (0.0, 1.0),
    "max_tilt_rate": (0.0, 1.0),
    "w_min_s": (1.0, 3600.0),
    "w_spread_s": (0.0, 3600.0),
    "settle_s": (0.0, 600.0),
    "max_rest_s": (1.0, 3600.0),
    "probe_min_s": (0.0, 86400.0),
    "probe_max_s": (0.0, 86400.0),
    "startup_s": (0.0, 60.0),
    "half_life_s": (60.0, 1e7),
    "cluster_windows": (2, 1000),
    "cluster_share": (0.0, 0.5),
    "seed": (0, 2**63),
}


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """The settings of the static detector. Times s, forces m/s^2, rates rad/s, angles rad.

    Windows. window_s: length of the windows that are classified; rests begin and end at their borders.
    min_samples: with fewer samples a window, windows are joined two, four or eight at a time (slow sensors).
    gap_s: a longer pause between samples ends a rest; for a slow sensor, one of two sample intervals.
    max_lag_s: how long an accelerometer window waits for its gyroscope samples before it is classified alone.

    Thresholds. accel_factor, gyro_factor: the paper's 2 and 3 times the noise floor. accel_ceiling,
    gyro_ceiling: no window noisier than this is still, whatever the floor: three times the 0.05 m/s^2
    that Android's compatibility definition (7.3.1) allowed a phone's accelerometer, and well above what
    phone gyroscopes show. force_low, force_high: bounds of a rest's raw norm; biases up to 2 m/s^2 and scale
    errors up to 15 % stay within them. step_factor: a window's mean may differ from the rest's running mean
    by this many standard uncertainties; force_step, rate_step: and by this much more, for slow wander of the
    sensor's bias. max_tilt_rate: a rest is refused where gravity's direction turns faster than this and
    significantly.

    Rests. w_min_s: shortest rest (the paper: never below 1 s). w_spread_s: the paper's b; w_max is
    drawn from [w_min_s, w_min_s + w_spread_s]. settle_s: shortest rest that begins or ends by drifting away
    rather than by motion. max_rest_s: longest rest in scan mode.

    Probing. probe_min_s, probe_max_s: the pause between probes is drawn uniformly between these. startup_s:
    how long the sensors may take to deliver the first whole window. seed: of all random draws; for 0 the
    daemon draws one at its first start, so that phones do not all probe at the same times.

    Noise floor. half_life_s: after this much time looked at, a window counts half. cluster_windows,
    cluster_share: how many windows, and which share of all remembered ones, make a level of noise the floor.
    """

    mode: Mode = Mode.SCAN
    window_s: float = 0.5
    min_samples: int = 8
    gap_s: float = 0.3
    max_lag_s: float = 30.0
    accel_factor: float = 2.0
    gyro_factor: float = 3.0
    accel_ceiling: float = 0.15
    gyro_ceiling: float = 0.03
    force_low: float = 5.0
    force_high: float = 15.0
    step_factor: float = 4.0
    force_step: float = 0.005
    rate_step: float = 0.0005
    max_tilt_rate: float = 0.001
    w_min_s: float = 1.0
    w_spread_s: float = 9.0
    settle_s: float = 5.0
    max_rest_s: float = 300.0
    probe_min_s: float = 30.0
    probe_max_s: float = 300.0
    startup_s: float = 2.0
    seed: int = 0
    half_life_s: float = 7200.0
    cluster_windows: int = 8
    cluster_share: float = 0.01

    def __post_init__(self) -> None:
        check_ranges(self, _ALLOWED)
        if self.probe_max_s < self.probe_min_s:
            raise ValueError(f"probe_max_s = {self.probe_max_s}: must not be below probe_min_s")
        if self.max_rest_s < self.w_min_s:
            raise ValueError(f"max_rest_s = {self.max_rest_s}: must not be below w_min_s")


@dataclass(slots=True)
class Ledger:
    """Counts of what the detector asked for, what it read, and how it classified that. Counts only grow.

    asked_s: s for which it wanted the sensors on (their on-time is the energy spent); in scan mode the time
    that it looked at. accel_samples, gyro_samples: samples read. accel_on_s, gyro_on_s: s covered by windows
    read. accel_unasked: samples that came while none were asked for and were not looked at. gyro_late:
    windows of gyroscope samples that came after the accelerometer had waited for max_lag_s. probes: probes
    ended. abandoned: of these, ended before w_min was reached. lapsed: of these, without any sample. windows,
    rests: windows and candidate rests by label.
    """

    asked_s: float = 0.0
    accel_samples: int = 0
    gyro_samples: int = 0
    accel_on_s: float = 0.0
    gyro_on_s: float = 0.0
    accel_unasked: int = 0
    gyro_late: int = 0
    probes: int = 0
    abandoned: int = 0
    lapsed: int = 0
    windows: dict[Label, int] = field(default_factory=dict)
    rests: dict[Label, int] = field(default_factory=dict)

    def count_rest(self, label: Label) -> None:
        """Count one candidate rest more under its label."""
        self.rests[label] = self.rests.get(label, 0) + 1

    def copy(self) -> Ledger:
        """Return a copy that further counting does not change."""
        return replace(self, windows=dict(self.windows), rests=dict(self.rests))
