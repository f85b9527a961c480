"""The curves of one difference: of the recording, and of the simulation beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.model.residuals import View
from stillcal.replay.diagnosis.phone.phone_effects import MappedFinding, map_findings
from stillcal.replay.diagnosis.phone.twin import conditions_of, fit_affine
from stillcal.replay.diagnosis.report.curves import Curve, curves_of

PAIR = "pair_"
"""How the names of residuals against another sensor begin (`comparison.pair.pair_residuals`)."""


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One of the two that are compared. label, colour: in figures; key: of its parameters in the answer."""

    label: str
    colour: str
    key: Literal["parameters", "simulated"]
    exam: Examination

    @property
    def other(self) -> str:
        """The key of the other side's parameters."""
        return "simulated" if self.key == "parameters" else "parameters"

    @property
    def paired(self) -> bool:
        """Whether its residuals are those against another sensor of the same motion."""
        return in_pair(self.exam)

    def curves(self, answered: Mapping[str, Any]) -> list[Curve]:
        """Return what this side shows of a finding of the answer, one curve a named axis.

        A side that has nothing of it shows its residual alone.
        """
        bins, gravity = self.exam.bins, self.exam.claims.gravity
        if not len(bins):
            return []
        absent = not any(np.any(p["value"]) for p in answered[self.key].values())
        # What this side has nothing of is drawn over the driver of the other one.
        finding = _finding(answered, self.other if absent else self.key)
        conditions = conditions_of(bins)
        others = [s.finding for s in self.exam.statements if not _alike(s.finding, finding)]
        (own,) = [MappedFinding(finding, None)] if absent else map_findings([finding], bins, conditions)
        effects = [m.effect for m in (*map_findings(others, bins, conditions), own) if m.effect is not None]
        affine = fit_affine(bins, effects, conditions, gravity)
        pair = self._pair(finding.sensor)
        return curves_of(own, bins, conditions, affine, gravity, absent=absent, pair=pair)

    def _pair(self, sensor: str) -> tuple[View, ...]:
        """Return a sensor's residuals against another one of the same motion; none where there is none."""
        own = [s.views for s in self.exam.sensors if s.sensor == sensor]
        return next((views for views in own if _of_pair(views)), ())


def in_pair(exam: Examination) -> bool:
    """Whether what was examined are the readings of one sensor less those of another, moved or not."""
    return any(_of_pair(residuals.views) for residuals in exam.sensors)


def _of_pair(views: Sequence[View]) -> bool:
    return all(v.name.startswith(PAIR) for v in views)


def _alike(one: Finding, other: Finding) -> bool:
    return (one.effect, one.sensor) == (other.effect, other.sensor)


def _finding(answered: Mapping[str, Any], side: str) -> Finding:
    """Return a finding of the answer with the parameters of one side."""
    values = {name: Parameter(p["value"], p.get("ci95"), p["unit"]) for name, p in answered[side].items()}
    if values:
        at = {"tau_s": "s", "t_start": "s"}
        known = {k: v for k, v in answered.get("reference", {}).items() if k in at}
        values |= {k: Parameter(v, None, at[k]) for k, v in known.items() if k not in values}
    where = Where(**{**answered["where"], "band_hz": tuple(answered["where"]["band_hz"])})
    return Finding(
        answered["effect"], answered["sensor"], list(answered["axes"]), where, values, Evidence(0.0), [], ""
    )
