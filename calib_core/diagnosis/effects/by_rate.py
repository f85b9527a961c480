"""Effects of the rate of turn: nonlinearity of the gyroscope, seen in turns between rests."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid, Linear, on_axes
from stillcal.calib_core.diagnosis.model.moments import Moments

TURN_PENALTY = 0.6
"""Score that effects of the rate give away: errors of turns have longer tails than those of rests."""


class RateNonlinearity(Effect):
    """The gyroscope's error grows with the square, or the cube, of the rate on each axis."""

    name = "gyro_nonlinearity"
    sensor = "gyro"
    follows = "rate of turn"
    noun = "nonlinearity of the gyroscope"
    sentence = "The gyroscope is nonlinear on {axes}."
    equation = "error = quadratic w^2 [+ cubic w^3], w the rate about the axis"
    look_alikes = ("gyro_saturation",)
    decides = "turn at several speeds, both ways"
    in_turns = True
    prior_penalty = TURN_PENALTY

    def __init__(self, degree: int) -> None:
        self.degree = degree
        both = (Linear("quadratic", "1/(rad/s)", 3, 0.02), Linear("cubic", "1/(rad/s)^2", 3, 0.01))
        self.parameters = both[: degree - 1]

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return powers of the rate about each axis, (n, 3, 3 (degree - 1))."""
        assert moments.rate is not None, "a turn has a rate"
        return np.concatenate([on_axes(moments.rate**p) for p in range(2, self.degree + 1)], axis=2)
