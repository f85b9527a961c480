"""A simulation without a thermometer, judged as if its temperature had changed as the recording's did.

A bias or a scale that is steady over all of a simulation does not follow temperature, whatever that was: no
course of it would have left them steady. One that changes may follow it, and then nothing is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.diagnosis.comparison.linear import Wanted, kind_of, linear_quantities
from stillcal.calib_core.diagnosis.comparison.not_logged import NotLogged
from stillcal.calib_core.diagnosis.diagnose import Examination
from stillcal.calib_core.diagnosis.model.hypothesis import Scene
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.streams.course import Course


def course_over(recorded: Bins, span: tuple[float, float]) -> Course:
    """Return the temperature of a recording's bins, degC, stretched to another one's `span`, s."""
    assert recorded.temperature is not None, "asked for where the recording follows temperature"
    return Course(np.interp(recorded.t, recorded.span, span), recorded.temperature)


def warmed(simulated: Examination, recorded: Bins) -> Examination:
    """Return a simulation's examination with the temperature of the recording's bins, stretched to it."""
    course = course_over(recorded, simulated.bins.span)
    bins = _warmed(simulated.bins, course)
    turns = simulated.turns and replace(
        simulated.turns,
        bins=_warmed(simulated.turns.bins, course),
        turns=tuple(replace(t, temperature=float(course.at(t.t).mean())) for t in simulated.turns.turns),
    )
    scenes: list[Scene] = [replace(s, bins=_warmed(s.bins, course)) for s in simulated.scenes]
    return replace(simulated, bins=bins, scenes=scenes, turns=turns)


def _warmed(bins: Bins, course: Course) -> Bins:
    return replace(bins, temperature=course.mean(bins.t, bins.duration))


def excluded(
    simulated: Examination, recorded: Bins, wanted: Sequence[Wanted], missing: Sequence[NotLogged]
) -> list[NotLogged]:
    """Return which effects of temperature a simulation does not have, though it logged no temperature.

    missing: the effects that the recording was found to have and whose driver the simulation did not log. Of
    these it has none where it shows none with the recording's temperature, and nothing else that may be it.
    """
    of_temperature = [m for m in missing if "temperature" in m.effect.follows]
    if not of_temperature or not len(simulated.bins):
        return []
    shown = linear_quantities(warmed(simulated, recorded), wanted, {})
    return [
        m
        for m in of_temperature
        if (own := shown.get((m.effect.name, m.effect.sensor))) is not None
        and own.informed.any()
        and not own.shows()
        and not _may_have(simulated, m)
    ]


def _may_have(simulated: Examination, missing: NotLogged) -> bool:
    return any(
        s.scene is not None and missing.may_be(kind_of(s.scene), s.finding.effect)
        for s in simulated.statements
    )
