"""What an effect is: its physics as a change of a sensor's output, its parameters, and what to say of it.

A subclass is all that the diagnosis knows of an effect. The columns of every regression, the search, the
finding, its sentence and equation, the comparison with a simulation and the catalogue in the docs are derived
from it. Physics of one's own is added by a subclass in another package, named under the entry point group
`stillcal.effects` (docs/effects.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.moments import Moments
from stillcal.calib_core.diagnosis.model.records import NAME

Grid = dict[str, float]
"""Parameters that an effect is not linear in: a time constant, the time of a step."""

BLOCKS_ACROSS = ("tangent",)
"""Residual blocks in which a support that gives way, or a nudge, looks like any course of a bias."""


@dataclass(frozen=True, slots=True)
class Linear:
    """`count` linear parameters of one name. size: what physics makes of them at most, their prior's sd."""

    name: str
    unit: str
    count: int
    size: float


@dataclass(frozen=True, slots=True, eq=False)
class Dictionary:
    """Many curves an effect may follow, of which the best few are fitted.

    curves: (K, q, n), each hypothesis q curves on every axis; grids: one grid point a hypothesis;
    multiplicity: how many of them are independent, about. pairs: (P, 2), if given the hypotheses are
    differences of two curves, not the curves. switching: the hypotheses are any courses between two levels
    that change at the borders, whose steps the curves are. driven: (n, 3) what the curves are multiplied by
    on each axis, the force for a gain; None for a bias.
    """

    grids: list[Grid]
    curves: Array
    multiplicity: int
    pairs: NDArray[np.int64] | None = None
    switching: bool = False
    driven: Array | None = None

    def curve(self, k: int) -> Array:
        """Return the curves (q, n) of hypothesis `k`."""
        if self.pairs is None:
            return np.asarray(self.curves[k])
        return np.asarray(self.curves[self.pairs[k, 0]] - self.curves[self.pairs[k, 1]])


class Effect:
    """An effect of one sensor. A subclass gives at least `name`, `follows`, `parameters` and `response`.

    name: as in findings; sensor: "accel" or "gyro"; follows: what drives it, in words; parameters: its linear
    parameters, in the order of the response's columns; sentence: one plain sentence, `{axes}` is filled in;
    noun: what it is called within a sentence.

    equation: the physics as a formula; remedy: what a person can do besides correcting it; look_alikes:
    effects that can imitate it; decides: the recording that tells them apart; grid_units: units of the grid's
    parameters.

    in_turns: whether it shows in turns between rests, not at rest. by_row: its parameters are a matrix, row
    by row of the axis they act on; else the axes in turn. recurs: whether it may be found more than once.
    several_of: the name of the effect of which it is several. prior_penalty: score (log10 of odds) that it
    must give away. rough: relative standard error that a curve which is only roughly known adds to sizes and
    time constants. blind: blocks of residuals in which it cannot be told from a true motion.
    """

    name: str
    sensor: str
    follows: str
    parameters: tuple[Linear, ...]
    sentence: str = ""
    noun: str = ""
    equation: ClassVar[str] = ""
    remedy: ClassVar[str] = ""
    look_alikes: tuple[str, ...] = ()
    decides: str = ""
    grid_units: ClassVar[dict[str, str]] = {}
    in_turns: bool = False
    by_row: bool = False
    recurs: bool = False
    several_of: str = ""
    prior_penalty: float = 0.0
    rough: float = 0.0
    blind: tuple[str, ...] = ()

    @property
    def key(self) -> tuple[str, str]:
        """Name and sensor, by which comparisons know it."""
        return self.name, self.sensor

    def called(self) -> str:
        """Return the noun; for an effect without one, words made of its driver."""
        return self.noun or f"effect of {self.follows} on the {NAME[self.sensor]}"

    def equation_at(self, grid: Mapping[str, float]) -> str:
        """Return the physics as a formula, of an effect at a grid point; "" for an effect without one."""
        return self.equation

    def points(self, moments: Moments) -> Sequence[Grid]:
        """Return the grid points to try; none where the recording lacks what drives the effect."""
        return [{}]

    def response(self, moments: Moments, grid: Grid) -> Array:
        """Return the change (n, 3, k) of the sensor's outputs by a unit of each linear parameter, SI."""
        raise NotImplementedError(f"{type(self).__name__} gives no response")

    def can_play(self, moments: Moments, grid: Grid) -> bool:
        """Whether a recording has what drives the effect, so that `response` can be had there."""
        needed = {"temperature": moments.temperature, "charging": moments.charging}
        if any(word in self.follows and column is None for word, column in needed.items()):
            return False
        return all(name in grid for name in self.grid_units)

    def finer(self, moments: Moments, grid: Grid) -> Sequence[Grid]:
        """Return grid points about one, more finely spaced; none where there is no grid."""
        return []

    def companions(self, moments: Moments) -> Sequence[Array]:
        """Return responses (n, 3, k) of what else one cause does, which must not be named besides."""
        return []

    def dictionary(self, moments: Moments) -> Dictionary | None:
        """Return curves of a bias that are too many to fit them all; then `points` gives none."""
        return None

    def nameless(self, penalty: float, sentence: str) -> Effect:
        """Return the same physics without a name. penalty: the least score that it gives away."""
        twin = copy(self)
        twin.name, twin.sentence = "unknown", sentence
        twin.prior_penalty = max(self.prior_penalty, penalty)
        return twin


def on_axes(curve: Array) -> Array:
    """Return the response (n, 3, 3) of an error `curve` (n,) or (n, 3), one parameter an axis."""
    values = curve if curve.ndim == 2 else np.repeat(curve[:, None], 3, axis=1)
    return np.asarray(values[:, :, None] * np.eye(3)[None])


def centred(curves: Array) -> Array:
    """Take means off curves (..., n) and scale each to a range of one."""
    away = curves - curves.mean(axis=-1, keepdims=True)
    return np.asarray(away / np.maximum(np.ptp(away, axis=-1, keepdims=True), 1e-9))
