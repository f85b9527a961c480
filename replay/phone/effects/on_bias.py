"""Effects that change bias or scale slowly: with temperature, time or charging."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.phone.effects.base import (
    Circumstances,
    Effect,
    Moment,
    OnAccel,
    OnEither,
    OnGyro,
    Smoother,
    Term,
    stretch,
)
from stillcal.replay.phone.settings import (
    Vector,
    per_axis,
)


class _BiasTemperature(Effect, frozen=True, kw_only=True):
    """Bias grows by `slope` per K over the reference temperature; `quadratic` per K^2 and `cubic` per K^3."""

    slope: Vector
    quadratic: Vector = (0.0, 0.0, 0.0)
    cubic: Vector = (0.0, 0.0, 0.0)

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Return the polynomial in warmth."""

        def polynomial(m: Moment) -> Array:
            bent = stretch(m.warmth**2, self.quadratic) + stretch(m.warmth**3, self.cubic)
            return stretch(m.warmth, self.slope) + bent

        return polynomial


class AccelBiasTemperature(
    _BiasTemperature, OnAccel, frozen=True, kw_only=True, tag="accel_bias_temperature"
):
    """Accelerometer bias against temperature; slope in m/s^2/K."""


class GyroBiasTemperature(_BiasTemperature, OnGyro, frozen=True, kw_only=True, tag="gyro_bias_temperature"):
    """Gyroscope bias against temperature; slope in rad/s/K."""


class _ScaleTemperature(Effect, frozen=True, kw_only=True):
    """Each axis gains `slope` times warmth of its own true input, slope in 1/K."""

    slope: Vector

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Return the term slope times warmth times the true input."""
        return lambda m: stretch(m.warmth, self.slope) * m.felt_by(sensor)


class AccelScaleTemperature(
    _ScaleTemperature, OnAccel, frozen=True, kw_only=True, tag="accel_scale_temperature"
):
    """Scale factor of the accelerometer against temperature; slope in 1/K."""


class GyroScaleTemperature(
    _ScaleTemperature, OnGyro, frozen=True, kw_only=True, tag="gyro_scale_temperature"
):
    """Scale factor of the gyroscope against temperature; slope in 1/K."""


class _Warmup(Effect, frozen=True, kw_only=True):
    """Bias rises by amplitude (1 - exp(-t / tau_s)) from switching on at t = 0."""

    amplitude: Vector
    tau_s: float

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Return the term that approaches the amplitude exponentially."""
        return lambda m: stretch(-np.expm1(-m.t / self.tau_s), self.amplitude)


class AccelWarmup(_Warmup, OnAccel, frozen=True, kw_only=True, tag="accel_warmup"):
    """Accelerometer warm-up; amplitude in m/s^2."""


class GyroWarmup(_Warmup, OnGyro, frozen=True, kw_only=True, tag="gyro_warmup"):
    """Gyroscope warm-up; amplitude in rad/s."""


class ThermalLatent(OnEither, frozen=True, kw_only=True, tag="thermal_latent"):
    """Bias is amplitude times a hidden warmth: use plus charging (0 to 2) through a lag of tau_s."""

    amplitude: Vector
    tau_s: float

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Return the term amplitude times lagged heating."""
        hidden = circumstances.surroundings.heating().lagged(self.tau_s)
        return lambda m: stretch(hidden.at(m.t), self.amplitude)


class _BiasStep(Effect, frozen=True, kw_only=True):
    """Bias changes by `step` at the time at_s, s."""

    step: Vector
    at_s: float

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Return the term that jumps by the step at its time."""
        return lambda m: stretch((m.t >= self.at_s).astype(float), self.step)


class AccelBiasStep(_BiasStep, OnAccel, frozen=True, kw_only=True, tag="accel_bias_step"):
    """A step of the accelerometer's bias, m/s^2."""


class GyroBiasStep(_BiasStep, OnGyro, frozen=True, kw_only=True, tag="gyro_bias_step"):
    """A step of the gyroscope's bias, rad/s."""


class _BiasDrift(Effect, frozen=True, kw_only=True):
    """Bias grows by `rate` per second."""

    rate: Vector

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Return the term rate times time."""
        return lambda m: stretch(m.t, self.rate)


class AccelBiasDrift(_BiasDrift, OnAccel, frozen=True, kw_only=True, tag="accel_bias_drift"):
    """A drift of the accelerometer's bias, m/s^3."""


class GyroBiasDrift(_BiasDrift, OnGyro, frozen=True, kw_only=True, tag="gyro_bias_drift"):
    """A drift of the gyroscope's bias, rad/s^2."""


class _ChargingBias(Effect, frozen=True, kw_only=True):
    """Bias is larger by `step` while charging, without delay."""

    step: Vector

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Return the term that is the step while charging."""
        return lambda m: stretch(m.charging, self.step)


class AccelChargingBias(_ChargingBias, OnAccel, frozen=True, kw_only=True, tag="accel_charging_bias"):
    """Accelerometer bias while charging; step in m/s^2."""


class GyroChargingBias(_ChargingBias, OnGyro, frozen=True, kw_only=True, tag="gyro_charging_bias"):
    """Gyroscope bias while charging; step in rad/s."""


class _ThermalHysteresis(Effect, frozen=True, kw_only=True):
    """Bias differs between heating and cooling: coefficient times warmth less its own lag of tau_s."""

    needs_samples: ClassVar[bool] = True
    coefficient: Vector
    tau_s: float = 900.0

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Return the term coefficient times the temperature minus its lagged value."""
        lagging = Smoother(self.tau_s, circumstances.rate_hz)

        def term(m: Moment) -> Array:
            warmth = m.warmth[:, None]
            return (warmth - lagging(warmth, warmth[0])) * per_axis(self.coefficient)

        return term


class AccelThermalHysteresis(
    _ThermalHysteresis, OnAccel, frozen=True, kw_only=True, tag="accel_thermal_hysteresis"
):
    """Accelerometer bias between heating and cooling; coefficient in m/s^2/K."""


class GyroThermalHysteresis(
    _ThermalHysteresis, OnGyro, frozen=True, kw_only=True, tag="gyro_thermal_hysteresis"
):
    """Gyroscope bias between heating and cooling; coefficient in rad/s/K."""
