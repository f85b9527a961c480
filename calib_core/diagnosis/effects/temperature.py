"""Bias and scale that follow the recorded temperature."""

from __future__ import annotations

from collections.abc import Sequence

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.bias import PolynomialBias
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid, Linear, on_axes
from stillcal.calib_core.diagnosis.model.moments import Moments, moves
from stillcal.calib_core.diagnosis.model.records import NAME

LEAST_SPAN = 0.3
"""K that temperature must change by: thermometers of phones read in steps of 0.1 K or more."""

PER_KELVIN = {"accel": 0.02, "gyro": 2e-3}
"""Prior sd of the bias' slope: twice what Android allows, 1 mg/K and 0.05 deg/s/K (CDD 7.3)."""

REACH_K = 20.0
"""K over which a curve's bend is at most as large as its slope: consumer parts are specified over +-60 K with
curves that turn once or twice."""


def known(moments: Moments) -> Sequence[Grid]:
    """Return one grid point where the temperature was recorded and changed."""
    return [{}] if moments.temperature is not None and moves(moments.temperature, LEAST_SPAN) else []


def _warmth(moments: Moments) -> Array:
    assert moments.temperature is not None, "no grid points without a temperature"
    return moments.temperature


class BiasTemperature(PolynomialBias):
    """The bias is a polynomial in temperature."""

    kind = "bias_temperature"
    says = "changes with temperature"
    called_as = "change of {bias} with temperature"
    follows = "temperature"
    equation = "bias(T) = bias(T0) + slope (T - T0) [+ quadratic (T - T0)^2 + cubic (T - T0)^3]"
    decides = "let the phone warm and cool twice, in several attitudes"

    def __init__(self, sensor: str, degree: int = 1) -> None:
        super().__init__(sensor, degree, ("/K", "/K^2", "/K^3"), slope=PER_KELVIN[sensor], reach=REACH_K)
        self.look_alikes = (f"{sensor}_warmup", f"{sensor}_bias_drift", f"{sensor}_scale_temperature")

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return one point where temperature changed enough to show the curve's degree."""
        enough = moments.temperature is not None and moves(moments.temperature, LEAST_SPAN * 10.0)
        return known(moments) if self.degree == 1 or enough else []

    def curve(self, moments: Moments, grid: Grid) -> Array:
        """Return temperature about its mean, K."""
        return _warmth(moments)


class ScaleTemperature(Effect):
    """The scale follows temperature: of the accelerometer by its own force, of the gyroscope by its rate."""

    equation = "scale(T) = scale(T0) (1 + slope (T - T0))"
    remedy = "calibrate at the temperature of use"
    parameters = (Linear("slope", "1/K", 3, 1e-3),)

    def __init__(self, sensor: str) -> None:
        self.sensor, self.name = sensor, f"{sensor}_scale_temperature"
        self.in_turns = sensor == "gyro"
        self.follows = f"temperature x {'rate of turn' if self.in_turns else 'own force'}"
        self.noun = f"change of the {NAME[sensor]}'s scale with temperature"
        self.sentence = f"The {NAME[sensor]}'s scale changes with temperature on {{axes}}."
        self.look_alikes = (f"{sensor}_bias_temperature",)
        self.decides = (
            "turn the phone about every axis, cold and warm"
            if self.in_turns
            else "turn the phone over while it is warm"
        )

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return one point where the input is known and temperature changed."""
        return [] if self._input(moments) is None else known(moments)

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return temperature times the axis' own input, (n, 3, 3)."""
        own = self._input(moments)
        assert own is not None, "no grid points without an input"
        return on_axes(own * _warmth(moments)[:, None])

    def _input(self, moments: Moments) -> Array | None:
        return moments.rate if self.in_turns else moments.force
