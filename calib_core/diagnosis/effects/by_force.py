"""Effects of the force itself: nonlinearity of the accelerometer, g-sensitivity of the gyroscope."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid, Linear, on_axes
from stillcal.calib_core.diagnosis.model.moments import Moments
from stillcal.calib_core.diagnosis.model.residuals import attitudes

FEWEST_OF_G = 3
"""Attitudes that a g-sensitivity needs."""

FEWEST_OF_DEGREE = {2: 6, 3: 10}
"""Attitudes that a quadratic, and a cubic beside it, need: one more than affine parameters leave free."""

QUADRATIC, CUBIC = 3e-3, 3e-4
"""Prior sizes of a nonlinearity, 1/(m/s^2) and 1/(m/s^2)^2: 3 % of the force at 1 g."""


def distinct(up: Array, angle: float = 0.2) -> int:
    """Return the number of attitudes further than `angle` (rad) from each other."""
    return int(attitudes(up, angle).max(initial=-1)) + 1


def seen_in(moments: Moments, fewest: int) -> bool:
    """Whether the phone lay in that many attitudes."""
    return moments.up is not None and distinct(moments.up) >= fewest


class ForceNonlinearity(Effect):
    """The accelerometer's error grows with the square, or the cube, of the force on each axis."""

    name = "accel_nonlinearity"
    sensor = "accel"
    follows = "own force"
    noun = "nonlinearity of the accelerometer"
    sentence = "The accelerometer is nonlinear on {axes}."
    equation = "error = quadratic f^2 [+ cubic f^3], f the force on the axis"
    look_alikes = ("accel_saturation",)
    decides = "rest in more attitudes, edges and corners"

    def __init__(self, degree: int) -> None:
        self.degree = degree
        both = (Linear("quadratic", "1/(m/s^2)", 3, QUADRATIC), Linear("cubic", "1/(m/s^2)^2", 3, CUBIC))
        self.parameters = both[: degree - 1]

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return one point where attitudes suffice."""
        return [{}] if seen_in(moments, FEWEST_OF_DEGREE[self.degree]) else []

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return powers of the force on each axis, (n, 3, 3 (degree - 1))."""
        powers = [on_axes(moments.force_power(p)) for p in range(2, self.degree + 1)]
        return np.concatenate(powers, axis=2)


class GSensitivity(Effect):
    """The gyroscope's rate changes with specific force: a matrix on the force."""

    name = "gyro_g_sensitivity"
    sensor = "gyro"
    follows = "attitude"
    parameters = (Linear("matrix", "(rad/s)/(m/s^2)", 9, 1e-3),)
    noun = "sensitivity of the gyroscope to acceleration"
    sentence = "The gyroscope is sensitive to acceleration (g-sensitivity) on {axes}."
    equation = "rate as read = rate + matrix f, f the specific force"
    look_alikes = ("gyro_bias_temperature",)
    decides = "return to the same attitudes at another temperature"
    by_row = True

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return one point where attitudes suffice."""
        return [{}] if seen_in(moments, FEWEST_OF_G) else []

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return each axis' rate by all three components of the force, (n, 3, 9), row by row."""
        assert moments.force is not None, "no grid points without attitudes"
        return np.asarray(
            (np.eye(3)[None, :, :, None] * moments.force[:, None, None, :]).reshape(len(moments), 3, 9)
        )
