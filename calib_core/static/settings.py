"""What is chosen, asked for and counted by the stationary detector: plain records, no arithmetic.

Sources: Grammenos et al. 2018, section 4.4 and Algorithm 1, called "the paper" in the stillness modules.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any


class Mode(StrEnum):
    """How the detector runs: `scan` looks at all it is fed, `probe` asks now and then (Algorithm 1)."""

    SCAN = "scan"
    PROBE = "probe"


class Label(StrEnum):
    """What became of one window, or of one candidate rest."""

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
    """The detector wants both sensors on now, and samples up to time `until`, s (inf: for good)."""

    until: float


@dataclass(frozen=True, slots=True)
class Sleep:
    """The detector wants no samples before time `until`, s."""

    until: float


Want = Sense | Sleep


@dataclass(frozen=True, slots=True)
class Range:
    """A closed range that a setting must lie in."""

    low: float
    high: float


_ALLOWED = {
    "window_s": Range(0.1, 5.0),
    "min_samples": Range(4, 1000),
    "gap_s": Range(0.01, 10.0),
    "max_lag_s": Range(0.0, 3600.0),
    "accel_factor": Range(1.0, 100.0),
    "gyro_factor": Range(1.0, 100.0),
    "accel_ceiling": Range(1e-6, 10.0),
    "gyro_ceiling": Range(1e-6, 10.0),
    "force_low": Range(0.0, 9.0),
    "force_high": Range(10.5, 100.0),
    "step_factor": Range(1.0, 100.0),
    "force_step": Range(0.0, 1.0),
    "rate_step": Range(0.0, 1.0),
    "max_tilt_rate": Range(0.0, 1.0),
    "w_min_s": Range(1.0, 3600.0),
    "w_spread_s": Range(0.0, 3600.0),
    "settle_s": Range(0.0, 600.0),
    "max_rest_s": Range(1.0, 3600.0),
    "probe_min_s": Range(0.0, 86400.0),
    "probe_max_s": Range(0.0, 86400.0),
    "startup_s": Range(0.0, 60.0),
    "half_life_s": Range(60.0, 1e7),
    "cluster_windows": Range(2, 1000),
    "cluster_share": Range(0.0, 0.5),
    "seed": Range(0, 2**63),
}


def check_ranges(record: Any, allowed: dict[str, Range]) -> None:
    """Raise ValueError naming the first field of `record` that lies outside its allowed range."""
    for name, span in allowed.items():
        value = getattr(record, name)
        if not span.low <= value <= span.high:
            raise ValueError(f"{name} = {value}: must lie between {span.low:g} and {span.high:g}")


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """Every knob of the stationary detector. Times s, forces m/s^2, rates rad/s, angles rad.

    Windows. window_s: length of the windows that are judged; edges of rests fall on them. min_samples:
    fewer samples make windows be joined two, four or eight at a time (slow sensors). gap_s: a longer
    pause between samples cuts. max_lag_s: how long an accelerometer window waits for its gyroscope
    samples before it is judged alone.

    Stillness. accel_factor, gyro_factor: the paper's 2 and 3 over the noise floor. accel_ceiling,
    gyro_ceiling: no window noisier than this is still, whatever the floor: three times the 0.05 m/s^2
    that Android's compatibility definition (7.3.1) allowed a phone's accelerometer, and well above what
    phone gyroscopes show. force_low, force_high: a rest's raw norm must lie between them (biases to
    2 m/s^2 and scale errors to 15 % do). step_factor: standard uncertainties by which a window's mean
    may leave the rest's running mean; force_step, rate_step: slow wander of the sensor's bias allowed
    on top. max_tilt_rate: a rest whose gravity direction turns significantly, and faster, is none.

    Rests. w_min_s: shortest rest (the paper: never below 1 s). w_spread_s: the paper's b, w_max is
    drawn from [w_min_s, w_min_s + w_spread_s]. settle_s: a rest that ends or begins by drifting off
    rather than by motion must be this long. max_rest_s: longest rest in scan mode.

    Probing. probe_min_s, probe_max_s: pause between probes, drawn uniformly. startup_s: how long the
    sensors may take to deliver the first whole window. seed: of all draws.

    Noise floor. half_life_s: of remembered windows, in time looked at. cluster_windows, cluster_share:
    how many windows, and which share of all remembered, make a level of noise a floor.
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
    """What the detector has asked for and read, and why it accepted or not. Counters only grow.

    asked_s: time for which it wanted the sensors on (their on-time is the energy), s; in scan mode the
    time it looked at. *_samples: read; *_on_s: time covered by windows read, s; *_unasked: samples fed
    outside asked intervals and not looked at; gyro_late: windows of gyroscope samples that came after
    the bounded wait. windows: windows by fate; rests: candidate rests by fate; probes: ended; abandoned:
    of these, cut off before w_min was full; lapsed: of these, nothing to read came.
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
        """Return a copy that counting on does not change."""
        return replace(self, windows=dict(self.windows), rests=dict(self.rests))
