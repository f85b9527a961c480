"""An effect at one point of its grid as columns in each block of residuals, for one sensor's recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid, Linear
from stillcal.calib_core.diagnosis.model.moments import Moments, mean_in, moments_of, turning
from stillcal.calib_core.diagnosis.model.residuals import View
from stillcal.calib_core.diagnosis.model.rotation_alignment import Turn
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.streams.time_series import TimeSeries


@dataclass(frozen=True, eq=False)
class SensorResiduals:
    """One sensor's residuals and what may drive them. up: (n, 3) unit gravity in every bin, or None.

    turns: the turns between rests that the one view holds, two residuals each; none where the views hold
    rests. covariates: further logged columns by name. shared: what all views see together whatever effect
    there is (the Earth's rate, of the gyroscope); None for nothing. sensed: (n, 3) m/s^2, gravity along the
    sensor's own axes, as their scale and misalignment read it; None where these are the body's. force_powers:
    means (n, 3) of powers of the force by exponent, where bins hold motion. unsure: (3,) up to what sd means
    in motion may differ by what was put on two sensors to make them comparable; None for nothing.
    """

    sensor: str
    bins: Bins
    views: tuple[View, ...]
    gravity: float
    up: Array | None
    turns: tuple[Turn, ...] = ()
    covariates: Mapping[str, TimeSeries] = field(default_factory=dict)
    shared: Hypothesis | None = None
    sensed: Array | None = None
    force_powers: Mapping[int, Array] = field(default_factory=dict)
    unsure: Array | None = None

    @cached_property
    def moments(self) -> Moments:
        """The drivers in the bins."""
        force = self.sensed
        if force is None and self.up is not None:
            force = self.gravity * self.up
        return replace(moments_of(self.bins, force, self.covariates), force_powers=self.force_powers)

    @cached_property
    def column_means(self) -> dict[str, float]:
        """The means of further logged columns in the bins, from which they count."""
        return {name: mean_in(course, self.bins) for name, course in self.covariates.items()}

    @cached_property
    def turning(self) -> list[Moments]:
        """The drivers during each turn."""
        return [turning(self.moments, t.t, t.rate, t.temperature) for t in self.turns]

    def columns(self, effect: Effect, grid: Grid) -> tuple[Array, ...]:
        """Return what an effect's linear parameters do to each view, (b, n, k) each.

        The same operator for every effect: the change of the sensor's output is projected on what a view
        looks at (along gravity, across it, an axis), or carried through a turn.
        """
        if self.turns:
            return (self._through_turns(effect, grid),)
        return self.columns_of(effect.response(self.moments, grid), effect.blind)

    def columns_of(self, response: Array, blind: tuple[str, ...] = ()) -> tuple[Array, ...]:
        """Return the same of a response (n, 3, k) in the bins. blind: names of views that are left out."""
        return tuple(
            np.einsum("bni,nik->bnk", v.project, response[v.bins]) * (v.name not in blind) for v in self.views
        )

    def _through_turns(self, effect: Effect, grid: Grid) -> Array:
        across = self.views[0].project.reshape(-1, 2, 3)
        moved = np.array(
            [
                turn.columns(effect.response(moments, grid))
                for turn, moments in zip(self.turns, self.turning, strict=True)
            ]
        )
        return np.asarray(np.einsum("kbi,kip->kbp", across, moved).reshape(1, 2 * len(self.turns), -1))

    def hypotheses(self, effect: Effect) -> list[Hypothesis]:
        """Return an effect at all of its grid points."""
        return [self.hypothesis(effect, grid) for grid in effect.points(self._drivers())]

    def hypothesis(self, effect: Effect, grid: Grid) -> Hypothesis:
        """Return an effect at one grid point."""
        return Hypothesis(effect, grid, self.columns(effect, grid))

    def finer(self, hypothesis: Hypothesis) -> list[Hypothesis]:
        """Return a hypothesis on a finer grid about its own point; itself where there is no grid."""
        grids = hypothesis.effect.finer(self.moments, hypothesis.grid)
        found = [self.measured(hypothesis.effect, g, hypothesis.multiplicity) for g in grids]
        return found or [hypothesis]

    def measured(self, effect: Effect, grid: Grid, multiplicity: float = 0) -> Hypothesis:
        """Return an effect at one grid point, also in views in which it is not sought.

        Where a gyroscope told that the phone was not nudged, a bias shows across gravity too.
        """
        if self.turns or self.bins.pose is None:
            columns = self.columns(effect, grid)
        else:
            columns = self.columns_of(effect.response(self.moments, grid))
        return Hypothesis(effect, grid, columns, multiplicity)

    def companions(self, effect: Effect) -> list[Hypothesis]:
        """Return what else the cause of an effect may do."""
        return [
            Hypothesis(effect, {}, self.columns_of(r, effect.blind)) for r in effect.companions(self.moments)
        ]

    def _drivers(self) -> Moments:
        """Return the drivers that decide whether an effect can show: those in turns, where these are seen."""
        if not self.turns:
            return self.moments
        every = self.turning
        warm = [m.temperature for m in every if m.temperature is not None]
        return replace(
            every[0],
            t=np.concatenate([m.t for m in every]),
            duration=np.concatenate([m.duration for m in every]),
            rate=np.concatenate([m.rate for m in every if m.rate is not None]),
            temperature=np.concatenate(warm) if warm else None,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """An effect at one point of its grid. columns: one (b, n, k) for each of the sensor's views.

    multiplicity: size of the dictionary it was taken from; 0 where all hypotheses of its effect are fitted.
    """

    effect: Effect
    grid: Grid
    columns: tuple[Array, ...]
    multiplicity: float = field(default=0)

    @property
    def axis_of(self) -> Array:
        """Which axis (k,) of the sensor each parameter belongs to."""
        count = sum(p.count for p in self.effect.parameters)
        axes = np.repeat(np.arange(3), count // 3) if self.effect.by_row else np.arange(count) % 3
        return np.asarray(axes)

    @property
    def sizes(self) -> Array:
        """Physical size (k,) of each parameter: its prior's standard deviation."""
        return np.concatenate([np.full(p.count, p.size) for p in self.effect.parameters])


def difference(one: Hypothesis, other: Hypothesis) -> Hypothesis:
    """Return what an effect does at one point of its grid and not at another."""
    columns = tuple(a - b for a, b in zip(one.columns, other.columns, strict=True))
    return Hypothesis(one.effect, one.grid, columns)


class Parameters(Effect):
    """Linear parameters whose columns are made elsewhere: constants, or several effects at once."""

    follows = "nothing"

    def __init__(self, name: str, sensor: str, parameters: tuple[Linear, ...]) -> None:
        self.name, self.sensor, self.parameters = name, sensor, parameters


def together(residuals: SensorResiduals, hypotheses: Sequence[Hypothesis]) -> Hypothesis:
    """Return several hypotheses as one, their parameters one after another."""
    parameters = tuple(p for h in hypotheses for p in h.effect.parameters)
    columns = zip(*(h.columns for h in hypotheses), strict=True)
    every = tuple(np.concatenate(c, axis=2) for c in columns)
    return Hypothesis(Parameters("all", residuals.sensor, parameters), {}, every)


def rows_of(hypotheses: Sequence[Hypothesis]) -> list[NDArray[np.int64]]:
    """Return which numbers of a joint fit belong to each of the hypotheses."""
    ends = np.cumsum([0, *(h.sizes.size for h in hypotheses)])
    return [np.arange(a, b) for a, b in pairwise(ends)]
