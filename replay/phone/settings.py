"""What can be set about a phone's sensors, clock and heat: validated records, written as TOML.

Units are SI with degrees Celsius; densities are one-sided, per square root of hertz. `PerAxis` takes one
number for all axes or three. What physics does with these lives elsewhere.
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
PerAxis = float | Vector

IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def per_axis(value: PerAxis) -> Array:
    """Return one number or three as an array (3,)."""
    return np.broadcast_to(np.asarray(value, dtype=np.float64), (3,)).copy()


def require(condition: bool, field: str, value: Any, allowed: str) -> None:
    """Raise ValueError naming the field and the allowed range unless `condition` holds."""
    if not condition:
        raise ValueError(f"{field} = {value}: must be {allowed}")


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Base of all settings records: frozen, keyword-only, unknown keys refused."""


class Wandering(Settings, frozen=True, kw_only=True):
    """A first-order Gauss-Markov bias. sigma: stationary standard deviation; tau_s: correlation time."""

    sigma: PerAxis
    tau_s: float

    def __post_init__(self) -> None:
        require(self.tau_s >= 0.25, "tau_s", self.tau_s, "at least 0.25 s (faster is white noise)")


class Noise(Settings, frozen=True, kw_only=True):
    """Noise of one sensor.

    white: density, unit/sqrt(Hz). flicker: bias instability B of IEEE Std 952, unit. gauss_markov: slow
    biases. random_walk: unit/sqrt(s). tail_fraction of white samples are tail_ratio times larger.
    """

    white: PerAxis = 0.0
    flicker: PerAxis = 0.0
    gauss_markov: tuple[Wandering, ...] = ()
    random_walk: PerAxis = 0.0
    tail_fraction: float = 0.0
    tail_ratio: float = 1.0

    def __post_init__(self) -> None:
        for field in ("white", "flicker", "random_walk"):
            value = getattr(self, field)
            require(bool((per_axis(value) >= 0.0).all()), field, value, "0 or more")
        require(0.0 <= self.tail_fraction <= 1.0, "tail_fraction", self.tail_fraction, "from 0 to 1")


class SensorSettings(Settings, frozen=True, kw_only=True):
    """One triaxial sensor: raw = scale @ true + bias + noise, then bandwidth, range and lsb.

    rate_hz: samples a second by its own clock. bias: raw unit. scale: forward 3x3 matrix. lsb: step of
    the values, 0 for none. range: largest magnitude reported, element_range: largest that the sensing
    element bears, None for unlimited. cutoff_hz: -3 dB of a second-order low-pass, None for none.
    held_fraction: samples that repeat the one before.
    """

    rate_hz: float = 100.0
    bias: Vector = (0.0, 0.0, 0.0)
    scale: Matrix = IDENTITY
    noise: Noise = Noise()
    lsb: float = 0.0
    range: float | None = None
    element_range: float | None = None
    cutoff_hz: float | None = None
    held_fraction: float = 0.0

    def __post_init__(self) -> None:
        require(0.1 <= self.rate_hz <= 40_000.0, "rate_hz", self.rate_hz, "from 0.1 to 40,000 Hz")
        require(self.lsb >= 0.0, "lsb", self.lsb, "0 or more")
        for field in ("range", "element_range"):
            limit = getattr(self, field)
            require(limit is None or limit > 0.0, field, limit, "above 0")
        require(0.0 <= self.held_fraction < 1.0, "held_fraction", self.held_fraction, "from 0 to below 1")
        determinant = float(np.linalg.det(np.asarray(self.scale)))
        require(abs(determinant) > 1e-6, "scale", self.scale, "an invertible matrix")
        if self.cutoff_hz is not None:
            nyquist = self.rate_hz / 2.0
            require(
                0.0 < self.cutoff_hz < nyquist, "cutoff_hz", self.cutoff_hz, f"between 0 and {nyquist} Hz"
            )


class ClockSettings(Settings, frozen=True, kw_only=True):
    """How samples are timed and delivered.

    skew: the device's clock against true time, relative (positive: fast). jitter_s: standard deviation
    of a stamp. shared: both sensors sampled together, under one stamp, at the accelerometer's rate.
    latency_s, latency_jitter_s: constant and mean exponential delay to arrival. drop_fraction: samples lost;
    double_fraction: samples delivered twice. burst_fraction, burst_s: share of the time in which delivery
    stalls for burst_s and then comes at once. gaps_per_hour, gap_s: outages of that mean number, with
    lengths drawn from the range. gyro_delay_s: the gyroscope's motion is this old when stamped.
    """

    skew: float = 0.0
    jitter_s: float = 0.0
    shared: bool = False
    latency_s: float = 0.0
    latency_jitter_s: float = 0.0
    drop_fraction: float = 0.0
    double_fraction: float = 0.0
    burst_fraction: float = 0.0
    burst_s: float = 0.2
    gaps_per_hour: float = 0.0
    gap_s: tuple[float, float] = (0.2, 2.0)
    gyro_delay_s: float = 0.0

    def __post_init__(self) -> None:
        require(abs(self.skew) < 0.5, "skew", self.skew, "between -0.5 and 0.5")
        for field in ("jitter_s", "latency_s", "latency_jitter_s", "gaps_per_hour"):
            value = getattr(self, field)
            require(value >= 0.0, field, value, "0 or more")
        for field in ("drop_fraction", "double_fraction", "burst_fraction"):
            value = getattr(self, field)
            require(0.0 <= value < 1.0, field, value, "from 0 to below 1")
        require(0.0 < self.burst_s <= 10.0, "burst_s", self.burst_s, "above 0, at most 10 s")
        require(0.0 < self.gap_s[0] <= self.gap_s[1] <= 30.0, "gap_s", self.gap_s, "rising, within 0 to 30 s")


class HeatSettings(Settings, frozen=True, kw_only=True):
    """How the case warms: ambient plus use and charging, each through a fast and a slow first-order lag.

    use_k, charge_k: final rise at full use and while charging. fast_share of the rise follows with
    fast_tau_s (chip and board), the rest with slow_tau_s (case and battery). start_k: rise over ambient at
    the start. reference_c: where bias and scale are quoted. thermometer: whether a temperature is recorded,
    in steps of thermometer_lsb_c with noise thermometer_noise_c.
    """

    use_k: float = 8.0
    charge_k: float = 5.0
    fast_share: float = 0.3
    fast_tau_s: float = 90.0
    slow_tau_s: float = 1200.0
    start_k: float = 0.0
    reference_c: float = 25.0
    thermometer: bool = True
    thermometer_lsb_c: float = 0.0
    thermometer_noise_c: float = 0.0

    def __post_init__(self) -> None:
        require(0.0 <= self.fast_share <= 1.0, "fast_share", self.fast_share, "from 0 to 1")
        for field in ("fast_tau_s", "slow_tau_s"):
            value = getattr(self, field)
            require(value > 0.0, field, value, "above 0 s")
