"""What the slow diagnosis says of one sensor, as findings alone."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.model.rotation_alignment import Aligned
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.findings import slow_statements, turn_statements
from stillcal.calib_core.diagnosis.slow.search import Step
from stillcal.calib_core.diagnosis.slow.standing import statements_of
from stillcal.calib_core.diagnosis.slow.turns.turn_residuals import turn_residuals


def slow_findings(residuals: SensorResiduals, without: Collection[str] = ()) -> list[Finding]:
    """Return what still bins show; `without`: effects left out of the catalogue."""
    return [s.finding for s in slow_statements(residuals, without)]


def turn_findings(made: Aligned, bins: Bins, gravity: float) -> list[Finding]:
    """Return what the turns between rests show; gravity: m/s^2."""
    return [s.finding for s in turn_statements(turn_residuals(made, bins, gravity))]


def findings_of(residuals: SensorResiduals, steps: Sequence[Step]) -> list[Finding]:
    """Return the findings that forward steps make."""
    return [s.finding for s in statements_of(residuals, steps)]
