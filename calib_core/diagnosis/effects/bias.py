"""A bias that follows a curve: what all effects on a sensor's bias have in common."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid, Linear, on_axes
from stillcal.calib_core.diagnosis.model.moments import Moments
from stillcal.calib_core.diagnosis.model.records import NAME
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT

SIZE = {"accel": 0.3, "gyro": 0.02}
"""Prior standard deviation of a bias that comes and goes, m/s^2 and rad/s: 30 mg and 1 deg/s, what shocks and
the heat of the phone do at most (BMI270 and LSM6DSO zero-level offsets)."""


class BiasEffect(Effect):
    """A bias on each axis in proportion to one curve."""

    kind: str
    """What follows the sensor in the effect's name."""

    says: str
    """What the bias does, for "The accelerometer's bias ... on x, y."."""

    called_as: str
    """The noun, `{bias}` filled in."""

    def __init__(self, sensor: str) -> None:
        self.sensor, self.name = sensor, f"{sensor}_{self.kind}"
        self.noun = self.called_as.format(bias=f"the {NAME[sensor]}'s bias")
        self.sentence = f"The {NAME[sensor]}'s bias {self.says} on {{axes}}."

    @abstractmethod
    def curve(self, moments: Moments, grid: Grid) -> Array:
        """Return the curve (n,) at a grid point."""

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return the curve on each axis, (n, 3, 3)."""
        return on_axes(self.curve(moments, grid))


class PolynomialBias(BiasEffect):
    """A bias on each axis that is a polynomial in one driver: a straight line, or bent, or turning twice.

    degree: 1, 2 or 3. per: what follows the sensor's unit in those of the coefficients, one after another.
    slope: prior standard deviation of the first of them. reach: the change of the driver over which a bend is
    at most as large as the slope.
    """

    def __init__(
        self, sensor: str, degree: int, per: tuple[str, str, str], *, slope: float, reach: float
    ) -> None:
        super().__init__(sensor)
        self.degree = degree
        self.parameters = tuple(
            Linear(name, UNIT[sensor] + per[i], 3, slope / reach**i)
            for i, name in enumerate(("slope", "quadratic", "cubic")[:degree])
        )

    def power(self, moments: Moments, grid: Grid, p: int) -> Array:
        """Return the driver (n,) to the power of p."""
        return np.asarray(self.curve(moments, grid) ** p)

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return the powers of the driver on each axis, (n, 3, 3 degree)."""
        powers = [self.power(moments, grid, p) for p in range(1, self.degree + 1)]
        return np.concatenate([on_axes(power) for power in powers], axis=2)
