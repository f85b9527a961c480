"""A recording against the built-in simulation: an ideal affine sensor with plain noise, moved as it moved.

That sensor's constants are the recording's own, so bias, scale and noise density cannot differ. Whatever else
the recording shows is lacking in it: the simulation's part of every difference is zero.
"""

from __future__ import annotations

from collections.abc import Sequence

from stillcal.calib_core.diagnosis.comparison.compare import Comparison, Discrepancy, NotCompared, p_of
from stillcal.calib_core.diagnosis.comparison.direct import smallest_direct
from stillcal.calib_core.diagnosis.comparison.looked_for import checks_of
from stillcal.calib_core.diagnosis.comparison.quantity import CERTAIN, Relation, posterior
from stillcal.calib_core.diagnosis.comparison.sensitivity import Sought, each_once, sought
from stillcal.calib_core.diagnosis.diagnose import Examination
from stillcal.calib_core.diagnosis.model.records import Finding


def compare_with_ideal(exam: Examination) -> Comparison:
    """Return what the recording shows beyond an ideal sensor, and what it could not show."""
    found = sought(exam)
    stated = [(s.finding, s.finding.evidence.log_bayes_factor) for s in exam.statements]
    checks = checks_of(exam, found)
    judged = [(f, e, posterior(e, max(len(checks), 1))) for f, e in stated]
    sure = [j for j in judged if j[2] >= CERTAIN and not j[0].evidence.contradicted]
    missing = [NotCompared(c.effect, c.sensor, c.reason) for c in checks if c.reason is not None]
    return Comparison(
        discrepancies=[_discrepancy(*one) for one in sorted(sure, key=lambda j: -j[1])],
        not_compared=missing,
        undecided=[_undecided(*one) for one in judged if one not in sure],
        comparisons=len(checks) - len(missing),
        p=p_of([*(e for _, e in stated), *_not_stated(found, stated)]),
        smallest=list(each_once([*(row for one in found for row in one.smallest), *smallest_direct(exam)])),
    )


def _not_stated(found: Sequence[Sought], stated: Sequence[tuple[Finding, float]]) -> list[float]:
    """Return the evidence for what was looked for and not found."""
    names = {(f.effect, f.sensor) for f, _ in stated}
    return [s.log_bayes_factor for s in found if s.smallest and (s.effect, s.sensor) not in names]


def _undecided(finding: Finding, _evidence: float, probability: float) -> NotCompared:
    seen = f"the fit suggests it (probability {probability:.2f})"
    if finding.evidence.contradicted:
        seen += ", but it does not predict the parts of the recording that were left out of the fit"
    return NotCompared(finding.effect, finding.sensor, seen)


def _discrepancy(finding: Finding, evidence: float, probability: float) -> Discrepancy:
    return Discrepancy(
        finding.effect,
        finding.sensor,
        list(finding.axes),
        finding.where,
        _relation(finding),
        probability,
        evidence,
        recorded=finding,
    )


def _relation(finding: Finding) -> Relation:
    """Return "lacking"; of a noise level, which the simulation has as it is claimed, how it is off."""
    ratio = finding.parameters.get("ratio")
    if finding.effect == "noise_level" and ratio is not None and isinstance(ratio.value, float):
        return "too_small" if ratio.value > 1.0 else "too_large"
    return "lacking"
