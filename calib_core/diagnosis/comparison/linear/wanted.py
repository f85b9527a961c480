"""The effects that recordings are asked for: what either was found to have and another can have too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.diagnosis.effects.catalogue import effects_in
from stillcal.calib_core.diagnosis.effects.warmup import SETTLED, Warmup
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.effect import Effect, Grid
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.slow.estimate import GRID_PARAMETERS


@dataclass(frozen=True, slots=True, eq=False)
class Wanted:
    """An effect to be measured, as one of the recordings has it. kind: "accel", "gyro" or "turn".

    grid: its time constant and the like, as they were estimated there.
    """

    kind: str
    hypothesis: Hypothesis
    grid: Grid

    @property
    def identity(self) -> tuple[str, str, str]:
        """Return what makes two of them the same effect: kind, name, driver."""
        effect = self.hypothesis.effect
        return self.kind, effect.name, effect.follows


def wanted_of(exam: Examination) -> list[Wanted]:
    """Return the linear effects that a recording was found to have and that another can be asked for."""
    return [
        Wanted(kind_of(s.residuals), s.hypothesis, _grid_of(s.hypothesis, s.finding))
        for s in exam.statements
        if s.hypothesis is not None and s.residuals is not None and transferable(s.hypothesis)
    ]


def _estimated(finding: Finding) -> dict[str, float]:
    """Return the estimates of what is not linear in an effect."""
    return {
        name: float(np.max(finding.parameters[name].value))
        for name in GRID_PARAMETERS
        if name in finding.parameters
    }


def _grid_of(hypothesis: Hypothesis, finding: Finding) -> Grid:
    """Return an effect's grid point as estimated; a settling counts from the start until biases are known."""
    counted = {SETTLED: 0.0} if isinstance(hypothesis.effect, Warmup) else {}
    return hypothesis.grid | _estimated(finding) | counted


def settled(wanted: Wanted) -> Wanted:
    """Return a wanted effect that counts, if it settles, up to the settled bias."""
    return replace(wanted, grid=wanted.grid | {SETTLED: 1.0}) if SETTLED in wanted.grid else wanted


def transferable(hypothesis: Hypothesis) -> bool:
    """Whether another recording can have the same effect; a step at one moment cannot be had again."""
    return hypothesis.effect.name != "unknown" and not hypothesis.effect.recurs


def kind_of(residuals: SensorResiduals) -> str:
    """Return what residuals are of: "accel" or "gyro" for rests, "turn" for the turns between them."""
    return "turn" if residuals.turns else residuals.sensor


def proposed(residuals: SensorResiduals, wanted: Wanted) -> Hypothesis | None:
    """Return the effect as this recording would have it, at the nearest fine point; None if it cannot.

    What comes at a moment is taken at that moment.
    """

    def nearest(points: Sequence[Hypothesis]) -> Hypothesis:
        return min(points, key=lambda h: _apart(h.grid, wanted.grid))

    for effect in effects_in(residuals):
        same = (wanted.kind, effect.name, effect.follows) == wanted.identity
        if not same or not _of_one_form(effect, wanted.hypothesis.effect):
            continue
        if effect.recurs:
            return residuals.measured(effect, wanted.hypothesis.grid)
        if found := residuals.hypotheses(effect):
            point = nearest(residuals.finer(nearest(found)))
            if SETTLED not in wanted.grid:
                return point
            return residuals.measured(
                effect, point.grid | {SETTLED: wanted.grid[SETTLED]}, point.multiplicity
            )
    return None


def _of_one_form(one: Effect, other: Effect) -> bool:
    """Whether two effects of one name have the same numbers: a polynomial of one degree, or a lag."""
    forms = [([p.name for p in effect.parameters], effect.grid_units) for effect in (one, other)]
    return forms[0] == forms[1]


def _apart(one: Mapping[str, float], other: Mapping[str, float]) -> float:
    """Return how far two grid points are from each other, positive numbers by their logarithms."""
    total = 0.0
    for name in one.keys() & other.keys():
        a, b = one[name], other[name]
        total += abs(np.log(a / b)) if a > 0.0 and b > 0.0 else abs(a - b)
    return total
