"""What a phone does beyond an affine error and noise: the catalogue of effects a phone file can switch on.

Each effect is a small record whose name and parameters are those of a diagnosis, written in a phone file as
`[[effect]]` with `name = "..."`. It acts in one of three places: it changes a setting (range, lsb,
bandwidth, noise, clock), it disturbs the true input (lever arm, tones), or it adds a term to the output
before bandwidth, range and lsb are applied. Terms of different effects add up.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import msgspec
import numpy as np
from scipy.signal import lfilter

from stillcal.calib_core.samples import Array, Sensor
from stillcal.replay.phone.heat import Surroundings
from stillcal.replay.phone.settings import (
    ClockSettings,
    Matrix,
    Noise,
    SensorSettings,
    Settings,
    Vector,
    per_axis,
    require,
)

Which = Literal["accel", "gyro", "both"]
SENSORS: dict[Which, tuple[Sensor, ...]] = {
    "accel": (Sensor.ACCELEROMETER,),
    "gyro": (Sensor.GYROSCOPE,),
    "both": (Sensor.ACCELEROMETER, Sensor.GYROSCOPE),
}


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """All that a sensor can feel at n moments, body axes.

    t: (n,) s, true time. force m/s^2, rate rad/s, rate_dot rad/s^2: (n, 3), true. warmth: (n,) K over the
    reference temperature. charging: (n,) 0 or 1.
    """

    t: Array
    force: Array
    rate: Array
    rate_dot: Array
    warmth: Array
    charging: Array

    def felt_by(self, sensor: Sensor) -> Array:
        """Return the quantity that a sensor measures, (n, 3)."""
        return self.force if sensor is Sensor.ACCELEROMETER else self.rate


@dataclass(frozen=True, slots=True, eq=False)
class Circumstances:
    """What a term needs to know before it starts: the sensor's rate in Hz, surroundings, its own randomness."""

    rate_hz: float
    surroundings: Surroundings
    rng: np.random.Generator


Term = Callable[[Moment], Array]
"""Adds (n, 3), or something that broadcasts to it, in the sensor's unit; called on blocks in time order."""


class Effect(Settings, frozen=True, kw_only=True, tag_field="name"):
    """Base of all effects: does nothing anywhere."""

    sensors: ClassVar[tuple[Sensor, ...]] = ()

    @property
    def name(self) -> str:
        """The effect's name in phone files and diagnoses."""
        return str(self.__struct_config__.tag)

    def concerns(self, sensor: Sensor) -> bool:
        """Whether the effect acts on a sensor's samples."""
        return sensor in self.sensors

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Return the sensor's settings with the effect in them."""
        return settings

    def on_clock(self, clock: ClockSettings) -> ClockSettings:
        """Return the clock's settings with the effect in them."""
        return clock

    def input_term(self, about: Circumstances) -> Term | None:
        """Return what the effect adds to the true input, None for nothing."""
        return None

    def output_term(self, sensor: Sensor, about: Circumstances) -> Term | None:
        """Return what the effect adds to the output, None for nothing."""
        return None


class _OnAccel(Effect, frozen=True, kw_only=True):
    sensors: ClassVar[tuple[Sensor, ...]] = SENSORS["accel"]


class _OnGyro(Effect, frozen=True, kw_only=True):
    sensors: ClassVar[tuple[Sensor, ...]] = SENSORS["gyro"]


class _OnEither(Effect, frozen=True, kw_only=True):
    """Acts on the sensor that `sensor` says."""

    sensor: Which = "both"

    def concerns(self, sensor: Sensor) -> bool:
        """Whether the effect acts on a sensor's samples."""
        return sensor in SENSORS[self.sensor]


def _stretch(curve: Array, amplitude: Vector) -> Array:
    return np.outer(curve, amplitude)


class _BiasTemperature(Effect, frozen=True, kw_only=True):
    """Bias grows by `slope` per K over the reference temperature."""

    slope: Vector

    def output_term(self, sensor: Sensor, about: Circumstances) -> Term:
        """Slope times warmth."""
        return lambda m: _stretch(m.warmth, self.slope)


class AccelBiasTemperature(
    _BiasTemperature, _OnAccel, frozen=True, kw_only=True, tag="accel_bias_temperature"
):
    """Accelerometer bias against temperature; slope in m/s^2/K."""


class GyroBiasTemperature(_BiasTemperature, _OnGyro, frozen=True, kw_only=True, tag="gyro_bias_temperature"):
    """Gyroscope bias against temperature; slope in rad/s/K."""


class _ScaleTemperature(Effect, frozen=True, kw_only=True):
    """Each axis gains `slope` times warmth of its own true input, slope in 1/K."""

    slope: Vector

    def output_term(self, sensor: Sensor, about: Circumstances) -> Term:
        """Slope times warmth times the true input."""
        return lambda m: _stretch(m.warmth, self.slope) * m.felt_by(sensor)


class AccelScaleTemperature(
    _ScaleTemperature, _OnAccel, frozen=True, kw_only=True, tag="accel_scale_temperature"
):
    """Accelerometer scale factor against temperature."""


class GyroScaleTemperature(
    _ScaleTemperature, _OnGyro, frozen=True, kw_only=True, tag="gyro_scale_temperature"
):
    """Gyroscope scale factor against temperature."""


class _Warmup(Effect, frozen=True, kw_only=True):
    """Bias rises by amplitude (1 - exp(-t / tau_s)) from switching on at t = 0."""

    amplitude: Vector
    tau_s: float

    def output_term(self, sensor: Sensor, about: Circumstances) -> Term:
        """Approach exponentially."""
        return lambda m: _stretch(-np.expm1(-m.t / self.tau_s), self.amplitude)


class AccelWarmup(_Warmup, _OnAccel, frozen=True, kw_only=True, tag="accel_warmup"):
    """Accelerometer warm-up; amplitude in m/s^2."""


class GyroWarmup(_Warmup, _OnGyro, frozen=True, kw_only=True, tag="gyro_warmup"):
    """Gyroscope warm-up; amplitude in rad/s."""


class ThermalLatent(_OnEither, frozen=True, kw_only=True, tag="thermal_latent"):
    """Bias follows a hidden temperature: use plus charging (0 to 2) through a lag of tau_s, times amplitude."""

    amplitude: Vector
    tau_s: float

    def output_term(self, sensor: Sensor, about: Circumstances) -> Term:
        """Amplitude times the lagged heating."""
        hidden = about.surroundings.heating().lagged(self.tau_s)
        return lambda m: _stretch(hidden.at(m.t), self.amplitude)


class _BiasStep(Effect, frozen=True, kw_only=True):
    """Bias jumps by `step` at time at_s."""

    step: Vector
    at_s: float

    def output_term(self, sensor: Sensor, about: Circumstances) -> Term:
        """Jump."""
        return lambda m: _stretch((m.t >= self.at_s).astype(float), self.step)


class AccelBiasStep(_BiasStep, _OnAccel, frozen=True, kw_only=True, tag="accel_bias_step"):
    """Accelerometer bias step, m/s^2."""


class GyroBiasStep(_BiasStep, _OnGyro, frozen=True, kw_only=True, tag="gyro_bias_step"):
    """Gyroscope bias step, rad/s."""


class _BiasDrift(Effect, frozen=True, kw_only=True):
    """Bias grows by `rate` per second."""

    rate: Vector

    def output_term(self, sensor: Sensor, about: Circumstances) -> Term:
        """Rate times time."""
        return lambda m: _stretch(m.t, self.rate)


class AccelBiasDrift(_BiasDrift, _OnAccel, frozen=True, kw_only=True, tag="accel_bias_drift"):
    """Accelerometer bias drift, m/s^3."""


class GyroBiasDrift(_BiasDrift, _OnGyro, frozen=True, kw_only=True, tag="gyro_bias_drift"):
    """Gyroscope bias drift, rad/s^2."""


class _ChargingBias(Effect, frozen=True, kw_only=True):
    """Bias is `step` more while charging, at once."""

    step: Vector

    def output_term(self, sensor: Sensor, about: Circumstances) -> Term:
        """Add the step while the plug is in."""
        return lambda m: _stretch(m.charging, self.step)


class AccelChargingBias(_ChargingBias, _OnAccel, frozen=True, kw_only=True, tag="accel_charging_bias"):
    """Accelerometer bias by the supply, m/s^2."""


class GyroChargingBias(_ChargingBias, _OnGyro, frozen=True, kw_only=True, tag="gyro_charging_bias"):
    """Gyroscope bias by the supply, rad/s."""


class _Nonlinearity(Effect, frozen=True, kw_only=True):
    """Each axis gains quadratic a^2 + cubic a^3 of its own true input a."""

    quadratic: Vector = (0.0, 0.0, 0.0)
    cubic: Vector = (0.0, 0.0, 0.0)

    def output_term(self, sensor: Sensor, about: Circumstances) -> Term:
        """Add the even and the odd term."""
        k2, k3 = per_axis(self.quadratic), per_axis(self.cubic)

        def term(m: Moment) -> Array:
            a = m.felt_by(sensor)
            return (k2 + k3 * a) * a**2

        return term


class AccelNonlinearity(_Nonlinearity, _OnAccel, frozen=True, kw_only=True, tag="accel_nonlinearity"):
    """Accelerometer nonlinearity, 1/(m/s^2) and 1/(m/s^2)^2."""


class GyroNonlinearity(_Nonlinearity, _OnGyro, frozen=True, kw_only=True, tag="gyro_nonlinearity"):
    """Gyroscope nonlinearity, 1/(rad/s) and 1/(rad/s)^2."""


class GyroGSensitivity(_OnGyro, frozen=True, kw_only=True, tag="gyro_g_sensitivity"):
    """The gyroscope feels the specific force through a matrix, (rad/s)/(m/s^2)."""

    matrix: Matrix

    def output_term(self, sensor: Sensor, about: Circumstances) -> Term:
        """Matrix times force."""
        G = np.asarray(self.matrix)
        return lambda m: m.force @ G.T


class AccelVibrationRectification(_OnAccel, frozen=True, kw_only=True, tag="accel_vibration_rectification"):
    """Bias follows vibration power: coefficient, 1/(m/s^2), times the square of the force's fast part.

    Fast is what a first-order low-pass of lag_s leaves over; the square is smoothed by the same lag.
    """

    coefficient: Vector
    lag_s: float = 0.5

    def output_term(self, sensor: Sensor, about: Circumstances) -> Term:
        """Coefficient times smoothed power."""
        slow, power = _Smoother(self.lag_s, about.rate_hz), _Smoother(self.lag_s, about.rate_hz)
        coefficient = per_axis(self.coefficient)

        def term(m: Moment) -> Array:
            fast = m.force - slow(m.force, m.force[0])
            return coefficient * power(fast**2, np.zeros(3))

        return term


class AccelThermalHysteresis(_OnAccel, frozen=True, kw_only=True, tag="accel_thermal_hysteresis"):
    """Bias differs between heating and cooling: coefficient, m/s^2/K, times warmth less its own lag of tau_s."""

    coefficient: Vector
    tau_s: float = 900.0

    def output_term(self, sensor: Sensor, about: Circumstances) -> Term:
        """Coefficient times the lead of temperature over its lagged self."""
        lagging = _Smoother(self.tau_s, about.rate_hz)

        def term(m: Moment) -> Array:
            warmth = m.warmth[:, None]
            return (warmth - lagging(warmth, warmth[0])) * per_axis(self.coefficient)

        return term


class Spikes(_OnEither, frozen=True, kw_only=True, tag="spikes"):
    """Single samples off by `amplitude` with either sign, per_hour of them on average."""

    amplitude: Vector
    per_hour: float

    def output_term(self, sensor: Sensor, about: Circumstances) -> Term:
        """Rare signed impulses."""
        chance = self.per_hour / 3600.0 / about.rate_hz

        def term(m: Moment) -> Array:
            hit = about.rng.random((m.t.size, 2))
            sign = np.where(hit[:, 0] < chance, np.where(hit[:, 1] < 0.5, -1.0, 1.0), 0.0)
            return _stretch(sign, self.amplitude)

        return term


class LeverArm(_OnAccel, frozen=True, kw_only=True, tag="lever_arm"):
    """The accelerometer sits at `position` m from the point that the motion is told of."""

    position: Vector

    def input_term(self, about: Circumstances) -> Term:
        """rate_dot x r + rate x (rate x r)."""
        r = np.asarray(self.position)

        def term(m: Moment) -> Array:
            return np.cross(m.rate_dot, r) + np.cross(m.rate, np.cross(m.rate, r))

        return term


class VibrationTone(_OnEither, frozen=True, kw_only=True, tag="vibration_tone"):
    """True vibration at one frequency in Hz, amplitude in the sensor's unit, from start_s for duration_s."""

    frequency: float
    amplitude: Vector
    sensor: Which = "accel"
    start_s: float = 0.0
    duration_s: float = math.inf

    def input_term(self, about: Circumstances) -> Term:
        """Add the sinusoid while it lasts."""

        def term(m: Moment) -> Array:
            on = ((m.t >= self.start_s) & (m.t < self.start_s + self.duration_s)).astype(float)
            return _stretch(on * np.sin(2.0 * math.pi * self.frequency * m.t), self.amplitude)

        return term


class _Smoother:
    """First-order low-pass of samples at a steady rate, carried from block to block."""

    def __init__(self, tau: float, rate_hz: float) -> None:
        self._keep = math.exp(-1.0 / (tau * rate_hz))
        self._last: Array | None = None

    def __call__(self, values: Array, initial: Array) -> Array:
        last = initial if self._last is None else self._last
        zi = (self._keep * last)[None]
        smooth, _ = lfilter([1.0 - self._keep], [1.0, -self._keep], values, axis=0, zi=zi)
        self._last = smooth[-1]
        return np.asarray(smooth)


class _Saturation(Effect, frozen=True, kw_only=True):
    """Values stop at plus and minus `limit`."""

    limit: float

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Narrow the range."""
        return msgspec.structs.replace(settings, range=min(self.limit, settings.range or math.inf))


class AccelSaturation(_Saturation, _OnAccel, frozen=True, kw_only=True, tag="accel_saturation"):
    """Accelerometer clipping, m/s^2."""


class GyroSaturation(_Saturation, _OnGyro, frozen=True, kw_only=True, tag="gyro_saturation"):
    """Gyroscope clipping, rad/s."""


class _Quantisation(Effect, frozen=True, kw_only=True):
    """Values come in multiples of `step`."""

    step: float

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Coarsen the lsb."""
        return msgspec.structs.replace(settings, lsb=max(self.step, settings.lsb))


class AccelQuantisation(_Quantisation, _OnAccel, frozen=True, kw_only=True, tag="accel_quantisation"):
    """Accelerometer resolution, m/s^2."""


class GyroQuantisation(_Quantisation, _OnGyro, frozen=True, kw_only=True, tag="gyro_quantisation"):
    """Gyroscope resolution, rad/s."""


class Bandwidth(_OnEither, frozen=True, kw_only=True, tag="bandwidth"):
    """A low-pass with -3 dB at `cutoff` Hz."""

    cutoff: float

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Lower the cutoff."""
        return msgspec.structs.replace(settings, cutoff_hz=min(self.cutoff, settings.cutoff_hz or math.inf))


class HeldSamples(_OnEither, frozen=True, kw_only=True, tag="held_samples"):
    """A fraction of samples repeats the one before."""

    fraction: float

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Hold more."""
        return msgspec.structs.replace(settings, held_fraction=max(self.fraction, settings.held_fraction))


def _louder(settings: SensorSettings, **changes: object) -> SensorSettings:
    return msgspec.structs.replace(settings, noise=msgspec.structs.replace(settings.noise, **changes))


def _scaled_white(noise: Noise, ratio: Array) -> Vector:
    x, y, z = per_axis(noise.white) * ratio
    return (float(x), float(y), float(z))


class NoiseLevel(_OnEither, frozen=True, kw_only=True, tag="noise_level"):
    """White noise `ratio` times the phone's own."""

    ratio: float

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Scale the white noise."""
        return _louder(settings, white=_scaled_white(settings.noise, per_axis(self.ratio)))


class NoiseUnequalAxes(_OnEither, frozen=True, kw_only=True, tag="noise_unequal_axes"):
    """White noise `ratio` times the phone's own, axis by axis."""

    ratio: Vector

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Scale the white noise by axis."""
        return _louder(settings, white=_scaled_white(settings.noise, per_axis(self.ratio)))


class NoiseHeavyTailed(_OnEither, frozen=True, kw_only=True, tag="noise_heavy_tailed"):
    """A `fraction` of white-noise values is `ratio` times larger."""

    ratio: float
    fraction: float = 0.02

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Fatten the tails."""
        return _louder(settings, tail_ratio=self.ratio, tail_fraction=self.fraction)


class _RandomWalk(Effect, frozen=True, kw_only=True):
    """Bias walks at random with `density` per sqrt(s), beside the phone's own."""

    density: Vector

    def on_sensor(self, settings: SensorSettings) -> SensorSettings:
        """Add the walk's power."""
        x, y, z = np.hypot(per_axis(self.density), per_axis(settings.noise.random_walk))
        return _louder(settings, random_walk=(float(x), float(y), float(z)))


class AccelBiasRandomWalk(_RandomWalk, _OnAccel, frozen=True, kw_only=True, tag="accel_bias_random_walk"):
    """Accelerometer bias random walk, m/s^2/sqrt(s)."""


class GyroBiasRandomWalk(_RandomWalk, _OnGyro, frozen=True, kw_only=True, tag="gyro_bias_random_walk"):
    """Gyroscope bias random walk, rad/s/sqrt(s)."""


class ClockSkew(Effect, frozen=True, kw_only=True, tag="clock_skew"):
    """The device's clock runs fast by `relative`: true sample rate over nominal, less 1."""

    relative: float

    def on_clock(self, clock: ClockSettings) -> ClockSettings:
        """Set the skew on top of the phone's own."""
        return msgspec.structs.replace(clock, skew=clock.skew + self.relative)


class TimestampJitter(Effect, frozen=True, kw_only=True, tag="timestamp_jitter"):
    """Stamps scatter by `sigma` s."""

    sigma: float

    def on_clock(self, clock: ClockSettings) -> ClockSettings:
        """Add the jitter's variance."""
        return msgspec.structs.replace(clock, jitter_s=math.hypot(clock.jitter_s, self.sigma))


class DroppedSamples(Effect, frozen=True, kw_only=True, tag="dropped_samples"):
    """A `fraction` of samples never arrives."""

    fraction: float

    def on_clock(self, clock: ClockSettings) -> ClockSettings:
        """Drop more."""
        kept = (1.0 - clock.drop_fraction) * (1.0 - self.fraction)
        return msgspec.structs.replace(clock, drop_fraction=1.0 - kept)


class ArrivalBursts(Effect, frozen=True, kw_only=True, tag="arrival_bursts"):
    """A `fraction` of the time delivery stalls for burst_s and then comes at once."""

    fraction: float
    burst_s: float = 0.2

    def on_clock(self, clock: ClockSettings) -> ClockSettings:
        """Set the bursts."""
        return msgspec.structs.replace(clock, burst_fraction=self.fraction, burst_s=self.burst_s)


class AccelGyroTimeOffset(Effect, frozen=True, kw_only=True, tag="accel_gyro_time_offset"):
    """The gyroscope tells of motion `delay` s before its stamp (late is positive)."""

    delay: float

    def on_clock(self, clock: ClockSettings) -> ClockSettings:
        """Delay the gyroscope further."""
        return msgspec.structs.replace(clock, gyro_delay_s=clock.gyro_delay_s + self.delay)


class TiltCreep(Effect, frozen=True, kw_only=True, tag="tilt_creep"):
    """What the phone lies on gives way: each rest turns by amplitude rad with time constant tau_s. True motion."""

    amplitude: float
    tau_s: float = 300.0

    def __post_init__(self) -> None:
        require(self.tau_s > 0.0, "tau_s", self.tau_s, "above 0 s")


AnyEffect = (
    AccelBiasTemperature | GyroBiasTemperature | AccelScaleTemperature | GyroScaleTemperature
    | AccelWarmup | GyroWarmup | ThermalLatent | AccelBiasStep | GyroBiasStep
    | AccelBiasDrift | GyroBiasDrift | AccelBiasRandomWalk | GyroBiasRandomWalk
    | AccelChargingBias | GyroChargingBias | AccelNonlinearity | GyroNonlinearity | GyroGSensitivity
    | AccelVibrationRectification | AccelThermalHysteresis | Spikes | LeverArm | VibrationTone
    | AccelSaturation | GyroSaturation | AccelQuantisation | GyroQuantisation
    | Bandwidth | HeldSamples | NoiseLevel | NoiseUnequalAxes | NoiseHeavyTailed
    | ClockSkew | TimestampJitter | DroppedSamples | ArrivalBursts | AccelGyroTimeOffset | TiltCreep
)  # fmt: skip
