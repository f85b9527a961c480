"""Effects that depend on the input: nonlinearity, g-sensitivity, vibration, lever arm; and spikes."""

from __future__ import annotations

import math
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
    Which,
    stretch,
)
from stillcal.replay.phone.settings import (
    Matrix,
    Vector,
    per_axis,
)


class _Nonlinearity(Effect, frozen=True, kw_only=True):
    """Each axis gains quadratic a^2 + cubic a^3 of its own true input a."""

    quadratic: Vector = (0.0, 0.0, 0.0)
    cubic: Vector = (0.0, 0.0, 0.0)

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Return the term with the quadratic and the cubic part."""
        k2, k3 = per_axis(self.quadratic), per_axis(self.cubic)

        def term(m: Moment) -> Array:
            a = m.felt_by(sensor)
            return (k2 + k3 * a) * a**2

        return term


class AccelNonlinearity(_Nonlinearity, OnAccel, frozen=True, kw_only=True, tag="accel_nonlinearity"):
    """Accelerometer nonlinearity, 1/(m/s^2) and 1/(m/s^2)^2."""


class GyroNonlinearity(_Nonlinearity, OnGyro, frozen=True, kw_only=True, tag="gyro_nonlinearity"):
    """Gyroscope nonlinearity, 1/(rad/s) and 1/(rad/s)^2."""


class GyroGSensitivity(OnGyro, frozen=True, kw_only=True, tag="gyro_g_sensitivity"):
    """The gyroscope's output contains the specific force times a matrix, (rad/s)/(m/s^2)."""

    matrix: Matrix

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Return the term matrix times force."""
        G = np.asarray(self.matrix)
        return lambda m: m.force @ G.T


class _VibrationRectification(Effect, frozen=True, kw_only=True):
    """Bias follows vibration power: coefficient times the square of the force's fast part, axis by axis.

    Fast is what a first-order low-pass of lag_s leaves over; the square is smoothed by the same lag.
    """

    needs_samples: ClassVar[bool] = True
    coefficient: Vector
    lag_s: float = 0.5

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Return the term coefficient times smoothed power."""
        slow, power = Smoother(self.lag_s, circumstances.rate_hz), Smoother(self.lag_s, circumstances.rate_hz)
        coefficient = per_axis(self.coefficient)

        def term(m: Moment) -> Array:
            fast = m.force - slow(m.force, m.force[0])
            return coefficient * power(fast**2, np.zeros(3))

        return term


class AccelVibrationRectification(
    _VibrationRectification, OnAccel, frozen=True, kw_only=True, tag="accel_vibration_rectification"
):
    """Accelerometer bias under vibration; coefficient in 1/(m/s^2)."""


class GyroVibrationRectification(
    _VibrationRectification, OnGyro, frozen=True, kw_only=True, tag="gyro_vibration_rectification"
):
    """Gyroscope bias under vibration; coefficient in (rad/s)/(m/s^2)^2."""


class Spikes(OnEither, frozen=True, kw_only=True, tag="spikes"):
    """Single samples off by `amplitude` with either sign, per_hour of them on average."""

    needs_samples: ClassVar[bool] = True
    amplitude: Vector
    per_hour: float

    def output_term(self, sensor: Sensor, circumstances: Circumstances) -> Term:
        """Return the term of rare impulses with random signs."""
        chance = self.per_hour / 3600.0 / circumstances.rate_hz

        def term(m: Moment) -> Array:
            hit = circumstances.rng.random((m.t.size, 2))
            sign = np.where(hit[:, 0] < chance, np.where(hit[:, 1] < 0.5, -1.0, 1.0), 0.0)
            return stretch(sign, self.amplitude)

        return term


class LeverArm(OnAccel, frozen=True, kw_only=True, tag="lever_arm"):
    """The accelerometer is at `position`, m, from the point whose motion is simulated."""

    position: Vector

    def input_term(self, circumstances: Circumstances) -> Term:
        """Return the term rate_dot x r + rate x (rate x r)."""
        r = np.asarray(self.position)

        def term(m: Moment) -> Array:
            acceleration: Array = np.cross(m.rate_dot, r) + np.cross(m.rate, np.cross(m.rate, r))
            return acceleration

        return term


class VibrationTone(OnEither, frozen=True, kw_only=True, tag="vibration_tone"):
    """True vibration at one frequency in Hz, amplitude in the sensor's unit, from start_s for duration_s."""

    of_whole_phone: ClassVar[bool] = True
    frequency: float
    amplitude: Vector
    sensor: Which = "accel"
    start_s: float = 0.0
    duration_s: float = math.inf

    def input_term(self, circumstances: Circumstances) -> Term:
        """Return the term of the sinusoid while it lasts."""

        def term(m: Moment) -> Array:
            on = ((m.t >= self.start_s) & (m.t < self.start_s + self.duration_s)).astype(float)
            return stretch(on * np.sin(2.0 * math.pi * self.frequency * m.t), self.amplitude)

        return term
