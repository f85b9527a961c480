"""What has no name in one recording, and may be what another recording has as well.

A curve or a wander without a name tells how a bias went, and not why. Few rests of a drift show as a wander,
more of them as a curve from a moment on, many as the drift. That the other recording has none of it is said
only where its rests would show it, and where it has nothing that may be the same in another shape.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import obstacle
from stillcal.calib_core.diagnosis.comparison.linear.wanted import kind_of, proposed, wanted_of
from stillcal.calib_core.diagnosis.effects.followed import follows_time
from stillcal.calib_core.diagnosis.effects.unknown import SmoothCurve
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Finding
from stillcal.calib_core.diagnosis.model.settings import CERTAIN, CERTAIN_NAMELESS, MODELLED
from stillcal.calib_core.diagnosis.slow.between_rest_variance import DRIVER as REST
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.diagnosis.slow.wander import NO_DRIVER, probability_beyond

SAME = "it shows something without a name as well, which may be the same"
BY_NAME = "an effect that it has by name may be the same"
NOT_TOLD = "its rests do not tell whether its bias wanders as much"


def may_be_had(finding: Finding, own: Examination, other: Examination) -> str | None:
    """Say why another recording may have what has no name in its own; None where nothing speaks for that."""
    if not is_course(finding):
        return None
    if finding.where.driver == NO_DRIVER:
        if (why := obstacle(other, finding.effect, finding.sensor)) is not None:
            return why
        if _wander(own, finding.sensor, other) < CERTAIN_NAMELESS:
            return BY_NAME
        if _wander(other, finding.sensor, own) > 1.0 - CERTAIN:
            return NOT_TOLD
    size = _size(own, finding)
    alike = [f for s in other.statements if is_course(f := s.finding) and f.sensor == finding.sensor]
    return SAME if any(_size(other, f) >= MODELLED * size for f in alike) else None


def is_course(finding: Finding) -> bool:
    """Whether a finding is how a bias went in the course of one recording, for a reason without a name."""
    slow = finding.effect == "unknown" and finding.where.band_hz == SLOW_BAND
    driver, comes_again = finding.where.driver, "period_s" in finding.parameters
    return slow and not comes_again and (driver in (NO_DRIVER, REST) or follows_time(driver))


def by_its_driver(finding: Finding, own: Examination) -> str | None:
    """Say why the size of what follows a driver in both is not compared; None where it can be.

    A smooth curve without a name is known over the range in which its driver ran, and no further.
    """
    stated = next((s for s in own.statements if s.finding is finding), None)
    if stated is None or stated.hypothesis is None or not isinstance(stated.hypothesis.effect, SmoothCurve):
        return None
    return f"it follows {finding.where.driver}, and how large it is goes with how that ran in each"


def _wander(exam: Examination, sensor: str, other: Examination) -> float:
    """Return the probability of more wander than a phone may have, beside what either has by name."""
    of_sensor = (s for s in exam.sensors if s.sensor == sensor)
    return max((probability_beyond(s, _named(exam, s, other)) for s in of_sensor), default=0.0)


def _named(exam: Examination, residuals: SensorResiduals, other: Examination) -> list[Hypothesis]:
    """Return the effects that a recording has, and those of another by name, as these residuals have them."""
    found = [h for s in exam.statements if s.residuals is residuals for h in s.fitted]
    names = {h.effect.name for h in found}
    asked = [
        w for w in wanted_of(other) if w.kind == kind_of(residuals) and w.hypothesis.effect.name not in names
    ]
    return [*found, *(h for w in asked if (h := proposed(residuals, w)) is not None)]


def _size(exam: Examination, finding: Finding) -> float:
    """Return the standard deviation of a bias in its course, on the axis that moves most."""
    own: Stated = next(s for s in exam.statements if s.finding is finding)
    if own.hypothesis is None or own.residuals is None:
        return float(np.max(finding.parameters["size"].value))
    seen = zip(own.residuals.views, own.hypothesis.columns, strict=True)
    return max(float((columns @ own.sizes).std()) for view, columns in seen if view.name != "tangent")
