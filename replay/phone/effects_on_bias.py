"""Effects that move the bias or scale slowly: with temperature, time, the plug."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.phone.effect_base import (
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
    """Bias grows by `slope` per K over the reference temperature."""

    slope: Vector

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Slope times warmth."""
        return lambda m: stretch(m.warmth, self.slope)


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
        """Slope times warmth times the true input."""
        return lambda m: stretch(m.warmth, self.slope) * m.felt_by(sensor)


class AccelScaleTemperature(
    _ScaleTemperature, OnAccel, frozen=True, kw_only=True, tag="accel_scale_temperature"
):
    """Accelerometer scale factor against temperature."""


class GyroScaleTemperature(
    _ScaleTemperature, OnGyro, frozen=True, kw_only=True, tag="gyro_scale_temperature"
):
    """Gyroscope scale factor against temperature."""


class _Warmup(Effect, frozen=True, kw_only=True):
    """Bias rises by amplitude (1 - exp(-t / tau_s)) from switching on at t = 0."""

    amplitude: Vector
    tau_s: float

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Approach exponentially."""
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
        """Amplitude times the lagged heating."""
        hidden = circumstances.surroundings.heating().lagged(self.tau_s)
        return lambda m: stretch(hidden.at(m.t), self.amplitude)


class _BiasStep(Effect, frozen=True, kw_only=True):
    """Bias jumps by `step` at time at_s."""

    step: Vector
    at_s: float

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Jump."""
        return lambda m: stretch((m.t >= self.at_s).astype(float), self.step)


class AccelBiasStep(_BiasStep, OnAccel, frozen=True, kw_only=True, tag="accel_bias_step"):
    """Accelerometer bias step, m/s^2."""


class GyroBiasStep(_BiasStep, OnGyro, frozen=True, kw_only=True, tag="gyro_bias_step"):
    """Gyroscope bias step, rad/s."""


class _BiasDrift(Effect, frozen=True, kw_only=True):
    """Bias grows by `rate` per second."""

    rate: Vector

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Rate times time."""
        return lambda m: stretch(m.t, self.rate)


class AccelBiasDrift(_BiasDrift, OnAccel, frozen=True, kw_only=True, tag="accel_bias_drift"):
    """Accelerometer bias drift, m/s^3."""


class GyroBiasDrift(_BiasDrift, OnGyro, frozen=True, kw_only=True, tag="gyro_bias_drift"):
    """Gyroscope bias drift, rad/s^2."""


class _ChargingBias(Effect, frozen=True, kw_only=True):
    """Bias is `step` more while charging, at once."""

    step: Vector

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Add the step while the plug is in."""
        return lambda m: stretch(m.charging, self.step)


class AccelChargingBias(_ChargingBias, OnAccel, frozen=True, kw_only=True, tag="accel_charging_bias"):
    """Accelerometer bias by the supply, m/s^2."""


class GyroChargingBias(_ChargingBias, OnGyro, frozen=True, kw_only=True, tag="gyro_charging_bias"):
    """Gyroscope bias by the supply, rad/s."""


class _ThermalHysteresis(Effect, frozen=True, kw_only=True):
    """Bias differs between heating and cooling: coefficient times warmth less its own lag of tau_s."""

    needs_samples: ClassVar[bool] = True
    coefficient: Vector
    tau_s: float = 900.0

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Multiply coefficient and the lead of temperature over its lagged self."""
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
