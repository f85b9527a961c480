"""A bias that follows another logged column: battery voltage, load, screen, light, a motor's speed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.bias import SIZE, PolynomialBias
from stillcal.calib_core.diagnosis.effects.followed import driver_of
from stillcal.calib_core.diagnosis.effects.warmup import nearby, time_constants
from stillcal.calib_core.diagnosis.model.effect import Grid
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis
from stillcal.calib_core.diagnosis.model.moments import Moments, first_order, moves
from stillcal.calib_core.streams.time_series import TimeSeries

COPY = 0.999
"""Correlation from which a column is a copy of what drives another effect: rounded, or in another unit."""

ENDINGS = (
    "bias",
    "drift",
    "latent",
    "noise",
    "nonlinearity",
    "quantisation",
    "saturation",
    "scale",
    "sensitivity",
    "step",
    "temperature",
    "walk",
    "warmup",
)
"""Ends of other effects' names, by which it is told what they are."""

SUFFIX = "_column"
"""What a column's effect is called by besides, where the column has such an end."""


class CovariateBias(PolynomialBias):
    """The bias is a polynomial in a logged column. spread: by how much that changes, in its unit."""

    remedy = "calibrate at the values of use, or keep it constant"
    equation = "bias = bias0 + slope x [+ quadratic x^2 + cubic x^3], x the logged column about its mean"
    decides = "let it rise and fall several times while temperature stays the same"

    def __init__(self, sensor: str, column: str, spread: float, degree: int = 1) -> None:
        self.column, self.follows = column, driver_of(column)
        self.kind = kind_of_column(column)
        self.says, self.called_as = f"changes with {column}", f"change of {{bias}} with {self.follows}"
        unit = f"unit of {column}"
        per = (f" per {unit}", f" per squared {unit}", f" per cubed {unit}")
        super().__init__(sensor, degree, per, slope=SIZE[sensor] / spread, reach=spread)
        self.look_alikes = (f"{sensor}_bias_temperature", f"{sensor}_charging_bias")

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return one point where the column was logged and changes."""
        return [{}] if self.logged(moments) and moves(moments.column(self.column)) else []

    def logged(self, moments: Moments) -> bool:
        """Whether the column was logged."""
        return self.column in moments.history.columns

    def can_play(self, moments: Moments, grid: Grid) -> bool:
        """Whether the column was logged."""
        return self.logged(moments) and super().can_play(moments, grid)

    def course(self, moments: Moments, grid: Grid) -> TimeSeries:
        """Return what the bias follows: the column about its mean at rest, in its own unit."""
        return moments.history.columns[self.column]

    def curve(self, moments: Moments, grid: Grid) -> Array:
        """Return what the bias follows, as a mean over each moment."""
        return self.power(moments, grid, 1)

    def power(self, moments: Moments, grid: Grid, p: int) -> Array:
        """Return the mean of its power over each moment: a column may change much within one."""
        course = self.course(moments, grid)
        return replace(course, values=course.values**p).mean(moments.t, moments.duration)


class LaggedCovariateBias(CovariateBias):
    """The bias follows a logged column as a first-order system does: late, in balance at first."""

    equation = "tau_s z' = x - z, x the logged column about its mean; bias = bias0 + slope z"
    grid_units = {"tau_s": "s"}  # noqa: RUF012 - a constant of the class

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return time constants up to half the recording, where the column was logged and changes."""
        return time_constants(moments) if super().points(moments) else []

    def finer(self, moments: Moments, grid: Grid) -> Sequence[Grid]:
        """Return time constants within a factor of four."""
        return nearby(grid)

    def course(self, moments: Moments, grid: Grid) -> TimeSeries:
        """Return the column behind its lag, in its own unit."""
        return first_order(moments.history.columns[self.column], grid["tau_s"])


def kind_of_column(column: str) -> str:
    """Return what follows the sensor in the name of a column's effect: it ends as no other effect's does."""
    word = re.sub(r"\W+", "_", column).strip("_").lower() or "column"
    return f"bias_{word}{SUFFIX}" if word.endswith(ENDINGS) else f"bias_{word}"


def covariate_effects(sensor: str, column: str, spread: float) -> list[CovariateBias]:
    """Return every form of the effect of a column on a sensor's bias; arguments are those of the class."""
    straight = [CovariateBias(sensor, column, spread, degree) for degree in (1, 2, 3)]
    return [*straight, LaggedCovariateBias(sensor, column, spread)]


def of_column(hypothesis: Hypothesis) -> bool:
    """Whether an effect follows a further logged column."""
    return isinstance(hypothesis.effect, CovariateBias)


def copies(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether one of two effects follows a logged column, and that is a copy of what the other follows."""
    if not (of_column(one) or of_column(other)):
        return False
    if any(a.shape != b.shape for a, b in zip(one.columns, other.columns, strict=True)):
        return False
    a, b = (np.concatenate([c.reshape(-1, c.shape[2]) for c in h.columns]) for h in (one, other))
    lengths = np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0)
    return bool((np.abs((a * b).sum(axis=0)) >= COPY * lengths).all())
