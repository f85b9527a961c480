"""Effects on range, resolution, bandwidth, noise, timing and support: they change a phone's settings."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.phone.effects.base import (
    Effect,
    OnAccel,
    OnEither,
    OnGyro,
)
from stillcal.replay.phone.settings import (
    ClockSettings,
    Noise,
    SensorSettings,
    Vector,
    per_axis,
    require,
)


class _Saturation(Effect, frozen=True, kw_only=True):
    """Values are clipped at plus and minus `limit`, after the filter or, with before_filter, before it."""

    limit: float
    before_filter: bool = False

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Return the settings with the range limited."""
        if self.before_filter:
            limit = min(self.limit, settings.element_range or math.inf)
            return msgspec.structs.replace(settings, element_range=limit)
        return msgspec.structs.replace(settings, range=min(self.limit, settings.range or math.inf))


class AccelSaturation(_Saturation, OnAccel, frozen=True, kw_only=True, tag="accel_saturation"):
    """Saturation of the accelerometer, m/s^2."""


class GyroSaturation(_Saturation, OnGyro, frozen=True, kw_only=True, tag="gyro_saturation"):
    """Saturation of the gyroscope, rad/s."""


class _Quantisation(Effect, frozen=True, kw_only=True):
    """Values come in multiples of `step`."""

    step: float

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Return the settings with the coarser lsb."""
        return msgspec.structs.replace(settings, lsb=max(self.step, settings.lsb))


class AccelQuantisation(_Quantisation, OnAccel, frozen=True, kw_only=True, tag="accel_quantisation"):
    """Quantisation of the accelerometer, m/s^2."""


class GyroQuantisation(_Quantisation, OnGyro, frozen=True, kw_only=True, tag="gyro_quantisation"):
    """Quantisation of the gyroscope, rad/s."""


FILTERS_ALL = "a simulated phone filters all axes of a sensor, or none"


class Bandwidth(OnEither, frozen=True, kw_only=True, tag="bandwidth"):
    """A low-pass with -3 dB at `cutoff` Hz."""

    cutoff: float

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Return the settings with the lower cutoff."""
        return msgspec.structs.replace(settings, cutoff_hz=min(self.cutoff, settings.cutoff_hz or math.inf))


class HeldSamples(OnEither, frozen=True, kw_only=True, tag="held_samples"):
    """A fraction of samples repeats the one before."""

    fraction: float

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Return the settings with the larger share held."""
        return msgspec.structs.replace(settings, held_fraction=max(self.fraction, settings.held_fraction))


def _louder(settings: SensorSettings, **changes: object) -> SensorSettings:
    return msgspec.structs.replace(settings, noise=msgspec.structs.replace(settings.noise, **changes))


def _scaled_white(noise: Noise, ratio: Array) -> Vector:
    x, y, z = per_axis(noise.white) * ratio
    return (float(x), float(y), float(z))


class NoiseLevel(OnEither, frozen=True, kw_only=True, tag="noise_level"):
    """White noise `ratio` times the phone's own."""

    ratio: float

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Return the settings with the white noise scaled."""
        return _louder(settings, white=_scaled_white(settings.noise, per_axis(self.ratio)))


class NoiseUnequalAxes(OnEither, frozen=True, kw_only=True, tag="noise_unequal_axes"):
    """White noise `ratio` times the phone's own, axis by axis."""

    ratio: Vector

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Return the settings with the white noise scaled, axis by axis."""
        return _louder(settings, white=_scaled_white(settings.noise, per_axis(self.ratio)))


class NoiseHeavyTailed(OnEither, frozen=True, kw_only=True, tag="noise_heavy_tailed"):
    """A `fraction` of white-noise values is `ratio` times larger."""

    ratio: float
    fraction: float = 0.02

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Return the settings with heavier tails."""
        return _louder(settings, tail_ratio=self.ratio, tail_fraction=self.fraction)


class _RandomWalk(Effect, frozen=True, kw_only=True):
    """Bias walks at random with `density` per sqrt(s), beside the phone's own."""

    density: Vector

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Return the settings with the random walk added in power."""
        x, y, z = np.hypot(per_axis(self.density), per_axis(settings.noise.random_walk))
        return _louder(settings, random_walk=(float(x), float(y), float(z)))


class AccelBiasRandomWalk(_RandomWalk, OnAccel, frozen=True, kw_only=True, tag="accel_bias_random_walk"):
    """Accelerometer bias random walk, m/s^2/sqrt(s)."""


class GyroBiasRandomWalk(_RandomWalk, OnGyro, frozen=True, kw_only=True, tag="gyro_bias_random_walk"):
    """Gyroscope bias random walk, rad/s/sqrt(s)."""


class ClockSkew(Effect, frozen=True, kw_only=True, tag="clock_skew"):
    """The device's clock runs fast by `relative`: true sample rate over nominal, less 1."""

    relative: float

    def on_clock(self, clock: ClockSettings) -> ClockSettings:
        """Return the settings with the skew added to the phone's own."""
        return msgspec.structs.replace(clock, skew=clock.skew + self.relative)


class TimestampJitter(Effect, frozen=True, kw_only=True, tag="timestamp_jitter"):
    """Time stamps have random errors of standard deviation `sigma`, s."""

    sigma: float

    def on_clock(self, clock: ClockSettings) -> ClockSettings:
        """Return the settings with the jitter's variance added."""
        return msgspec.structs.replace(clock, jitter_s=math.hypot(clock.jitter_s, self.sigma))


class DroppedSamples(Effect, frozen=True, kw_only=True, tag="dropped_samples"):
    """A `fraction` of the samples is lost."""

    fraction: float

    def on_clock(self, clock: ClockSettings) -> ClockSettings:
        """Return the settings with more samples lost."""
        delivered = (1.0 - clock.drop_fraction) * (1.0 - self.fraction)
        return msgspec.structs.replace(clock, drop_fraction=1.0 - delivered)


class DoubledSamples(Effect, frozen=True, kw_only=True, tag="doubled_samples"):
    """A `fraction` of samples is delivered twice, stamp and all."""

    fraction: float

    def on_clock(self, clock: ClockSettings) -> ClockSettings:
        """Return the settings with the larger share delivered twice."""
        return msgspec.structs.replace(clock, double_fraction=max(self.fraction, clock.double_fraction))


class ArrivalBursts(Effect, frozen=True, kw_only=True, tag="arrival_bursts"):
    """For a `fraction` of the time, delivery stalls for burst_s; the samples then arrive at once."""

    fraction: float
    burst_s: float = 0.2

    def on_clock(self, clock: ClockSettings) -> ClockSettings:
        """Return the settings with these bursts."""
        return msgspec.structs.replace(clock, burst_fraction=self.fraction, burst_s=self.burst_s)


class AccelGyroTimeOffset(Effect, frozen=True, kw_only=True, tag="accel_gyro_time_offset"):
    """The gyroscope measures the motion `delay` s before its time stamp (late is positive)."""

    delay: float

    def on_clock(self, clock: ClockSettings) -> ClockSettings:
        """Return the settings with the delay added to the gyroscope's own."""
        return msgspec.structs.replace(clock, gyro_delay_s=clock.gyro_delay_s + self.delay)


class TiltCreep(Effect, frozen=True, kw_only=True, tag="tilt_creep"):
    """What the phone lies on gives way, a true motion: each rest turns by amplitude rad, lagging by tau_s."""

    amplitude: float
    tau_s: float = 300.0

    def __post_init__(self) -> None:
        require(self.tau_s > 0.0, "tau_s", self.tau_s, "above 0 s")
