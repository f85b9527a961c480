"""A bias that follows a curve: what all effects on a sensor's bias have in common."""

from __future__ import annotations

from abc import abstractmethod

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid, on_axes
from stillcal.calib_core.diagnosis.model.moments import Moments
from stillcal.calib_core.diagnosis.model.records import NAME

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
