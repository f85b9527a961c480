"""Constant and slow parameters of one recording, fitted together: bias, scale, and what changes them.

A static bin's residual is linear in all of them. They are fitted with the noise averaged over its shapes
(`inference.likelihood`), the constants free beside the effects, so that a slope in temperature and the bias
at a reference temperature are one estimate and not two.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise, product

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.linear.constants import constant_quantities, constants, freed
from stillcal.calib_core.diagnosis.comparison.linear.shifts import SHIFTED, at_reference
from stillcal.calib_core.diagnosis.comparison.linear.wanted import Wanted, kind_of, proposed, transferable
from stillcal.calib_core.diagnosis.comparison.quantity import Part, Quantity, posterior
from stillcal.calib_core.diagnosis.effects.catalogue import effects_in
from stillcal.calib_core.diagnosis.effects.covariate import CovariateBias
from stillcal.calib_core.diagnosis.effects.warmup import SETTLED
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.inference.likelihood import fit_hypothesis, reduce_residuals
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Effect
from stillcal.calib_core.diagnosis.model.hypothesis import (
    Hypothesis,
    SensorResiduals,
    rows_of,
    together,
)
from stillcal.calib_core.diagnosis.model.records import SLOW_BAND, Where
from stillcal.calib_core.diagnosis.slow.about_force import about_point
from stillcal.calib_core.diagnosis.slow.estimate import averaged
from stillcal.calib_core.diagnosis.slow.relinearised import AboutTurns

FEWEST = 3
"""Bins that show a gyroscope's bias, which needs no attitudes; what changes it needs more of them."""

MODEL_ERROR = 0.03
"""Standard deviation of the model's own error in an effect's numbers, as a part of the largest of them:
residuals are linear in the effects, and no effect is exactly of its named form."""


def linear_quantities(
    exam: Examination,
    wanted: Sequence[Wanted],
    reference_c: Mapping[str, float],
    about: Mapping[str, float] | None = None,
) -> dict[tuple[str, str], Quantity]:
    """Measure the constants and the wanted effects; by effect and sensor.

    reference_c: by sensor, degC at which bias and scale are stated where they follow temperature. about: by
    column, the value at which the bias is stated where it follows that; the recording's own mean where it has
    none. An effect is missing where the recording lacks what drives it, all of them where it has too few
    static bins.
    """
    every = every_linear_quantity(exam, wanted, reference_c, about)
    return {(q.effect, q.sensor): q for q in every}


def every_linear_quantity(
    exam: Examination,
    wanted: Sequence[Wanted],
    reference_c: Mapping[str, float],
    about: Mapping[str, float] | None = None,
) -> list[Quantity]:
    """Return what `linear_quantities` does, also of effects that come more than once, such as steps."""
    out: list[Quantity] = []
    for residuals in exam.with_turns:
        enough = len(residuals.bins) >= thresholds.LEAST_BINS
        if enough or (residuals.sensor == "gyro" and len(residuals.bins) >= FEWEST):
            own = [w for w in wanted if enough and w.kind == kind_of(residuals)]
            out += _fitted(exam, residuals, own, reference_c.get(residuals.sensor), about or {})
    return out


def _fitted(
    exam: Examination,
    residuals: SensorResiduals,
    wanted: Sequence[Wanted],
    reference_c: float | None,
    about: Mapping[str, float],
) -> list[Quantity]:
    kind, about_turns = kind_of(residuals), exam.about_turns
    if kind == "turn" and about_turns is not None and _all_among(about_turns, residuals, wanted):
        exam, residuals = replace(exam, aligned=about_turns.affine), about_turns.residuals
    if kind == "accel":
        # A large effect makes the constants of a linear fit false where it was not searched for.
        residuals = about_point(residuals, [h for w in wanted if (h := proposed(residuals, w)) is not None])
    free = replace(residuals, views=tuple(freed(v, residuals.gravity) for v in residuals.views))
    effects = [h for w in wanted if (h := proposed(residuals, w)) is not None]
    hypotheses = [constants(kind, residuals), *effects]
    parts = rows_of(hypotheses)
    count = int(parts[-1][-1]) + 1
    value, covariance = _measured(free, hypotheses, _of_its_own(exam, residuals))
    if about_turns is not None and residuals is about_turns.residuals:
        for hypothesis, rows in zip(hypotheses[1:], parts[1:], strict=True):
            value[rows] += _taken_off(about_turns, hypothesis.effect)
    turned = at_reference(residuals, hypotheses, reference_c, about)
    roughly = np.zeros(count)
    for hypothesis, rows in zip(hypotheses[1:], parts[1:], strict=True):
        roughly[rows] = _model_error(hypothesis, value[rows])
    stated, of_constants = turned @ value, turned @ (covariance + np.diag(roughly**2)) @ turned.T
    covariance = turned @ covariance @ turned.T
    reference = {} if reference_c is None else {"temperature_c": reference_c}
    for one in effects:
        reference |= {name: at for name, at in one.grid.items() if name == SETTLED}
    out = constant_quantities(exam, kind, stated, of_constants, reference)
    for hypothesis, rows in zip(hypotheses[1:], parts[1:], strict=True):
        effect = effect_quantity(
            residuals.bins.span, hypothesis, stated[rows], covariance[np.ix_(rows, rows)]
        )
        if reference_c is not None and hypothesis.effect.name in SHIFTED:
            effect = replace(effect, reference=dict(effect.reference) | {"temperature_c": reference_c})
        if isinstance(column := hypothesis.effect, CovariateBias):
            at = about.get(column.column, residuals.column_means[column.column])
            effect = replace(effect, reference=dict(effect.reference) | {column.column: at})
        out.append(effect)
    return out


def _all_among(about: AboutTurns, residuals: SensorResiduals, wanted: Sequence[Wanted]) -> bool:
    """Whether every number of the effects that were taken off the turns is measured."""
    effects = [h.effect for w in wanted if (h := proposed(residuals, w)) is not None]
    measured = {place for effect in effects for place in _places(effect)}
    return all(measured.issuperset(_places(h.effect)) for h in about.found)


def _taken_off(about: AboutTurns, effect: Effect) -> Array:
    """Return what was taken off the turns (k,) of an effect's numbers, SI; 0 of those that were not found."""
    taken: dict[tuple[str, str, str, int], float] = {}
    for hypothesis, values in zip(about.found, about.values, strict=True):
        taken |= dict(zip(_places(hypothesis.effect), values.tolist(), strict=True))
    return np.array([taken.get(place, 0.0) for place in _places(effect)])


def _places(effect: Effect) -> list[tuple[str, str, str, int]]:
    """Return what tells each number of an effect from others, whatever other numbers it has."""
    return [(effect.name, effect.follows, p.name, i) for p in effect.parameters for i in range(p.count)]


def _of_its_own(exam: Examination, residuals: SensorResiduals) -> list[tuple[Hypothesis, float]]:
    """Return what a recording alone has, a step or something unknown, and the probability that it has it.

    It is fitted beside, and stated elsewhere. Left out, it would be a part of the constants, which would then
    differ too.
    """
    looked_for = len(effects_in(residuals))
    return [
        (_in_these(residuals, s.hypothesis), posterior(s.finding.evidence.log_bayes_factor, looked_for))
        for s in exam.statements
        if s.hypothesis is not None
        and s.residuals is not None
        and kind_of(s.residuals) == kind_of(residuals)
        and not transferable(s.hypothesis)
    ]


def _in_these(residuals: SensorResiduals, hypothesis: Hypothesis) -> Hypothesis:
    """Return an effect as residuals have it: of turns others may be left out than where it was found."""
    return residuals.hypothesis(hypothesis.effect, hypothesis.grid) if residuals.turns else hypothesis


def _measured(
    residuals: SensorResiduals,
    hypotheses: Sequence[Hypothesis],
    beside: Sequence[tuple[Hypothesis, float]],
) -> tuple[Array, Array]:
    """Fit hypotheses together; return their numbers (k,) and covariance (k, k), SI.

    beside: other hypotheses and how probable each of them is: the numbers are averaged over fits with and
    without each.
    """
    fits, weight = [], []
    for chosen in product((True, False), repeat=len(beside)):
        own = [h for (h, _), there in zip(beside, chosen, strict=True) if there]
        whole = together(residuals, [*hypotheses, *own])
        fits.append(fit_hypothesis(reduce_residuals(residuals, [whole]), 0))
        odds = [p if there else 1.0 - p for (_, p), there in zip(beside, chosen, strict=True)]
        weight.append(float(np.prod(odds)))
    return averaged(fits, np.array(weight), np.concatenate([h.sizes for h in hypotheses]))


def _rows(hypothesis: Hypothesis) -> list[slice]:
    """Return which of a hypothesis' numbers belong to each of its parameters."""
    ends = np.cumsum([0, *(p.count for p in hypothesis.effect.parameters)]).tolist()
    return [slice(a, b) for a, b in pairwise(ends)]


def effect_quantity(
    span: tuple[float, float], hypothesis: Hypothesis, value: Array, covariance: Array
) -> Quantity:
    """Return the numbers (k,) of an effect as a quantity, the model's own error in their covariance.

    span: s, when the recording began and ended.
    """
    effect = hypothesis.effect
    return Quantity(
        effect.name,
        effect.sensor,
        tuple(Part(p.name, p.unit, p.count) for p in effect.parameters),
        value,
        covariance + np.diag(_model_error(hypothesis, value) ** 2),
        hypothesis.sizes,
        1e-9 * hypothesis.sizes,
        np.asarray(hypothesis.axis_of),
        reference=dict(hypothesis.grid),
        where=Where(*span, SLOW_BAND, effect.follows),
    )


def _model_error(hypothesis: Hypothesis, value: Array) -> Array:
    """Return the standard deviation (k,) that an effect's numbers (k,) have because it is only a model."""
    largest = [float(np.abs(value[rows]).max()) for rows in _rows(hypothesis)]
    return np.concatenate(
        [
            np.full(p.count, MODEL_ERROR * x)
            for p, x in zip(hypothesis.effect.parameters, largest, strict=True)
        ]
    )
