"""What a catalogue entry is: an effect's forward equation as columns in each view, and what to say of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.residuals import View
from stillcal.calib_core.diagnosis.segments.static_bins import Bins


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One sensor's views and what the catalogue may use. up: (n, 3) unit gravity in every bin, or None."""

    sensor: str
    bins: Bins
    views: tuple[View, ...]
    gravity: float
    up: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """An effect at one point of its grid. columns: one (b, n, k) for each of the scene's views.

    trials: size of the bank it was taken from; 0 where all of its entry's hypotheses are fitted.
    """

    entry: Entry
    grid: dict[str, float]
    columns: tuple[Array, ...]
    trials: float = 0

    @property
    def axis_of(self) -> Array:
        """Which axis (k,) of the sensor each parameter belongs to."""
        count = sum(p.count for p in self.entry.parameters)
        axes = np.repeat(np.arange(3), count // 3) if self.entry.by_row else np.arange(count) % 3
        return np.asarray(axes)

    @property
    def sizes(self) -> Array:
        """Physical size (k,) of each parameter: its prior's standard deviation."""
        return np.concatenate([np.full(p.count, p.size) for p in self.entry.parameters])


@dataclass(frozen=True, slots=True)
class Linear:
    """`count` linear parameters of one name. size: what physics makes of them at most, their prior's sd."""

    name: str
    unit: str
    count: int
    size: float


TILTED = ("tangent",)
"""Views in which a support that gives way, or a nudge, looks like any course of a bias."""


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """Many curves an effect may follow, of which the best few are fitted.

    curves: (K, q, N), each hypothesis q curves on every axis; grids: one grid point a hypothesis; trials: how
    many of them are independent, about. pairs: (P, 2), if given the hypotheses are differences of two
    curves, not the curves. switching: the hypotheses are any courses between two levels that change at the
    borders, whose steps the curves are.
    """

    grids: list[dict[str, float]]
    curves: Array
    trials: int
    pairs: NDArray[np.int64] | None = None
    switching: bool = False

    def curve(self, k: int) -> Array:
        """Return the curves (q, N) of hypothesis `k`."""
        if self.pairs is None:
            return np.asarray(self.curves[k])
        return np.asarray(self.curves[self.pairs[k, 0]] - self.curves[self.pairs[k, 1]])


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """An effect of the catalogue.

    propose: all its hypotheses in a scene, none where the recording lacks what drives it. parameters:
    its linear parameters in the columns' order. look_alikes: effects that can imitate it; decides:
    the recording that tells them apart. sentence: one plain sentence, `{axes}` filled in. follows: driver.
    refine: hypotheses on a finer grid about a grid point. kin: what else
    belongs to the same cause and must not be named again once this is found. handicap: score it must
    give away.
    recurs: whether it may be found more than once. by_row: its parameters are a matrix, row by row of the
    axis they act on; else the axes in turn. bank: instead of `propose`, curves too many to fit them all.
    rough: relative standard error that a curve which is only roughly known adds to sizes and time constants.
    """

    effect: str
    sensor: str
    follows: str
    propose: Callable[[Entry, Scene], list[Hypothesis]]
    parameters: tuple[Linear, ...]
    sentence: str
    look_alikes: tuple[str, ...] = ()
    decides: str = ""
    grid_units: dict[str, str] = field(default_factory=dict)
    refine: Callable[[Entry, Scene, dict[str, float]], list[Hypothesis]] | None = None
    kin: Callable[[Entry, Scene], list[Hypothesis]] | None = None
    handicap: float = 0.0
    recurs: bool = False
    by_row: bool = False
    bank: Callable[[Scene], Bank | None] | None = None
    rough: float = 0.0


def no_hypotheses(_entry: Entry, _scene: Scene) -> list[Hypothesis]:
    """Propose nothing: for entries with a bank, and those whose columns are made elsewhere."""
    return []


def bias_columns(scene: Scene, curve: Array, views: tuple[str, ...] = ()) -> tuple[Array, ...]:
    """Return columns of a bias that follows `curve` (N,) on each axis; `views` names views to leave out."""
    return tuple(
        v.project * (0.0 if v.name in views else 1.0) * curve[v.bins][None, :, None] for v in scene.views
    )


def curves(
    drivers: Callable[[Scene], list[tuple[dict[str, float], Array]]],
) -> Callable[[Entry, Scene], list[Hypothesis]]:
    """Return the proposal of a bias on each axis that follows any of the drivers' curves."""

    def propose(entry: Entry, scene: Scene) -> list[Hypothesis]:
        return [Hypothesis(entry, grid, bias_columns(scene, curve)) for grid, curve in drivers(scene)]

    return propose


def moves(curve: Array, least: float = 1e-9) -> bool:
    """Whether a driver changes at all."""
    return curve.size > 0 and float(np.ptp(curve)) > least


def nothing(scene: Scene) -> Hypothesis:
    """Return a hypothesis with one column of nothing: the baseline phone itself."""
    entry = Entry("nothing", scene.sensor, "nothing", no_hypotheses, (Linear("none", "1", 1, 1.0),), "")
    return Hypothesis(entry, {}, tuple(np.zeros((*v.y.shape, 1)) for v in scene.views))
