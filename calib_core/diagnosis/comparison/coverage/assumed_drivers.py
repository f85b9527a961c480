"""A simulation without a thermometer or a column, judged as if either had changed as the recording's did.

A bias or a scale that is steady over all of a simulation does not follow temperature, whatever course that
took. At one temperature any is steady, which is said with the finding. One that changes may follow it, and
then nothing is said. The same holds for a further logged column.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.coverage.not_logged import NotLogged
from stillcal.calib_core.diagnosis.comparison.linear.quantities import linear_quantities
from stillcal.calib_core.diagnosis.comparison.linear.wanted import Wanted, kind_of, proposed
from stillcal.calib_core.diagnosis.comparison.quantity import Key, Quantity
from stillcal.calib_core.diagnosis.effects.covariate import CovariateBias
from stillcal.calib_core.diagnosis.effects.followed import follows_temperature
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.effect import BLOCKS_ACROSS
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.streams.time_series import TimeSeries

LESS = 1.0 / 3.0
"""Part of the recording's effect below which a simulation lacks it: half of it would be too small."""


def course_over(recorded: Bins, span: tuple[float, float]) -> TimeSeries:
    """Return the temperature of a recording's bins, degC, stretched to another one's `span`, s."""
    assert recorded.temperature is not None, "asked for where the recording follows temperature"
    return TimeSeries(np.interp(recorded.t, recorded.span, span), recorded.temperature)


def warmed(simulated: Examination, recorded: Bins) -> Examination:
    """Return a simulation's examination with the temperature of the recording's bins, stretched to it."""
    course = course_over(recorded, simulated.bins.span)
    bins = _warmed(simulated.bins, course)
    turns = simulated.turns and replace(
        simulated.turns,
        bins=_warmed(simulated.turns.bins, course),
        turns=tuple(replace(t, temperature=float(course.at(t.t).mean())) for t in simulated.turns.turns),
    )
    sensors: list[SensorResiduals] = [replace(s, bins=_warmed(s.bins, course)) for s in simulated.sensors]
    return replace(simulated, bins=bins, sensors=sensors, turns=turns, about_turns=None)


def columns_over(
    courses: Mapping[str, TimeSeries], own: tuple[float, float], span: tuple[float, float]
) -> dict[str, TimeSeries]:
    """Return logged columns of a recording of one span, s, stretched to another's."""
    return {name: replace(c, t=np.interp(c.t, own, span)) for name, c in courses.items()}


def columns_of(missing: Iterable[NotLogged]) -> set[str]:
    """Return the columns that drive effects."""
    return {m.effect.column for m in missing if isinstance(m.effect, CovariateBias)}


def driven(simulated: Examination, recorded: Examination, missing: Sequence[NotLogged]) -> Examination:
    """Return a simulation's examination with what drives the missing effects, as the recording logged it."""
    made = simulated
    if any(_of_temperature(m) for m in missing):
        made = warmed(made, recorded.bins)
    names = columns_of(missing)
    if not names:
        return made
    logged = {name: recorded.sensors[0].covariates[name] for name in names}
    added = columns_over(logged, recorded.bins.span, simulated.bins.span)
    return replace(made, sensors=[replace(s, covariates={**s.covariates, **added}) for s in made.sensors])


def _of_temperature(missing: NotLogged) -> bool:
    return follows_temperature(missing.effect.follows)


def _warmed(bins: Bins, course: TimeSeries) -> Bins:
    return replace(bins, temperature=course.mean(bins.t, bins.duration))


def excluded(
    exams: tuple[Examination, Examination], wanted: Sequence[Wanted], missing: Sequence[NotLogged]
) -> list[NotLogged]:
    """Return which effects of temperature or a column a simulation does not have, though it logged none.

    missing: the effects that the recording was found to have and whose driver the simulation did not log. Of
    these it has none where it shows none, could have a small part of it at most, whatever course its driver
    took, and shows nothing else that may be it.
    """
    assumed = [m for m in missing if _of_temperature(m) or isinstance(m.effect, CovariateBias)]
    recorded, simulated = exams
    if not assumed or not len(simulated.bins):
        return []
    made = driven(simulated, recorded, assumed)
    had, shown = (linear_quantities(exam, wanted, {}) for exam in (recorded, made))
    most = _largest(made, wanted, assumed)
    return [
        m
        for m in assumed
        if (key := m.effect.key) in had
        and key in shown
        and not shown[key].shows()
        and np.linalg.norm(most[key] / had[key].size) < LESS * np.linalg.norm(had[key].value / had[key].size)
        and not _may_have(simulated, m)
    ]


def of_any_course(
    simulated: Examination,
    wanted: Sequence[Wanted],
    missing: Sequence[NotLogged],
    side: Mapping[Key, Quantity],
) -> dict[Key, Quantity]:
    """Return what a simulation shows, the missing effects with an error for any course of their driver.

    Any size up to the largest is as likely.
    """
    most = _largest(simulated, wanted, missing)
    return {
        key: replace(one, covariance=one.covariance + np.diag(most[key] ** 2 / 3.0)) if key in most else one
        for key, one in side.items()
    }


def _largest(
    simulated: Examination, wanted: Sequence[Wanted], missing: Sequence[NotLogged]
) -> dict[Key, Array]:
    """Return the largest size (k,) of each number of a missing effect, whatever course its driver took.

    An effect of some size leaves residuals as large as it is. What there is of them beyond white noise is the
    largest size that it may have.
    """
    keys = {m.effect.key for m in missing}
    out: dict[Key, Array] = {}
    for residuals in simulated.with_turns:
        for one in wanted:
            effect = one.hypothesis.effect
            hypothesis = proposed(residuals, one) if one.kind == kind_of(residuals) else None
            if hypothesis is not None and effect.key in keys:
                sizes = [_most(residuals, i, hypothesis) for i in _lengthwise(residuals)]
                out[effect.key] = np.max(sizes, axis=0)
    return out


def _lengthwise(residuals: SensorResiduals) -> list[int]:
    """Return which views of a sensor's residuals see what changes from rest to rest."""
    return [i for i, view in enumerate(residuals.views) if view.name not in BLOCKS_ACROSS]


def _most(residuals: SensorResiduals, index: int, hypothesis: Hypothesis) -> Array:
    """Return the size (k,) of each parameter that would leave all residuals of a view; 0 where it sees none.

    What calibration absorbs is projected out of both.
    """
    view, columns = residuals.views[index], hypothesis.columns[index]
    base = np.hstack(
        [view.nuisance(), *([] if residuals.shared is None else [residuals.shared.columns[index][0]])]
    )
    whole = np.column_stack([view.y[0], columns[0]])
    left = whole - base @ np.linalg.lstsq(base, whole, rcond=None)[0]
    power = (left**2).mean(axis=0)
    slow = max(float(power[0] - np.mean(view.variance)), 0.0)
    seen = power[1:] > 0.0
    return np.asarray(np.sqrt(np.where(seen, slow / np.where(seen, power[1:], 1.0), 0.0)))


def _may_have(simulated: Examination, missing: NotLogged) -> bool:
    return any(
        s.residuals is not None and missing.may_be(kind_of(s.residuals), s.finding.effect)
        for s in simulated.statements
    )
