"""A bias that follows another logged column: battery voltage, load, screen, light, a motor's speed."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.bias import SIZE, BiasEffect
from stillcal.calib_core.diagnosis.model.effect import Grid, Linear
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis
from stillcal.calib_core.diagnosis.model.moments import Moments, moves
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT

COPY = 0.999
"""Correlation from which a column is a copy of what drives another effect: rounded, or in another unit."""


class CovariateBias(BiasEffect):
    """The bias changes in proportion to a logged column. spread: by how much that changes, in its unit."""

    remedy = "calibrate at the values of use, or keep it constant"
    equation = "bias = bias0 + slope (x - mean of x), x the logged column"
    decides = "let it rise and fall several times while temperature stays the same"

    def __init__(self, sensor: str, column: str, spread: float) -> None:
        self.column, self.follows = column, f"the column {column}"
        self.kind = "bias_" + (re.sub(r"\W+", "_", column).strip("_").lower() or "column")
        self.says, self.called_as = f"changes with {column}", f"change of {{bias}} with {column}"
        super().__init__(sensor)
        self.parameters = (Linear("slope", f"{UNIT[sensor]} per unit of {column}", 3, SIZE[sensor] / spread),)
        self.look_alikes = (f"{sensor}_bias_temperature", f"{sensor}_charging_bias")

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return one point where the column was logged and changes."""
        return [{}] if self.can_play(moments, {}) and moves(moments.column(self.column)) else []

    def can_play(self, moments: Moments, grid: Grid) -> bool:
        """Whether the column was logged."""
        return self.column in moments.history.columns

    def curve(self, moments: Moments, grid: Grid) -> Array:
        """Return the column about its mean at rest, in its own unit."""
        return moments.column(self.column)


def of_column(hypothesis: Hypothesis) -> bool:
    """Whether an effect follows a further logged column."""
    return isinstance(hypothesis.effect, CovariateBias)


def copies(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether one of two effects follows a logged column, and that is a copy of what the other follows."""
    if not (of_column(one) or of_column(other)):
        return False
    if any(a.shape != b.shape for a, b in zip(one.columns, other.columns, strict=True)):
        return False
    a, b = (np.concatenate([c.ravel() for c in h.columns]) for h in (one, other))
    return bool(abs(a @ b) > COPY * np.linalg.norm(a) * np.linalg.norm(b))
