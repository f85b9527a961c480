"""How small an effect one recording would have shown, from the covariance of the model that looked for it.

The search states an effect where the gain in log likelihood passes its threshold (`inference.score`). An
effect on one axis is put into the recording's own residuals, so large that it just does: chance takes half of
such effects below the threshold. Nine in ten are found that are 1.28 standard errors larger.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.comparison.linear.wanted import kind_of
from stillcal.calib_core.diagnosis.comparison.quantity import INFORMED, Difference
from stillcal.calib_core.diagnosis.effects.catalogue import effects_in
from stillcal.calib_core.diagnosis.effects.followed import follows_time
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.inference.likelihood import (
    fit_hypothesis,
    joint_log_likelihood,
    log_terms,
    null_log_likelihood,
    reduce_residuals,
    squares_left,
)
from stillcal.calib_core.diagnosis.inference.reduction import Reduced
from stillcal.calib_core.diagnosis.inference.score import degrees, gain_of
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Effect, Linear
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.measurement import NINE_IN_TEN
from stillcal.calib_core.diagnosis.model.records import AXES
from stillcal.calib_core.diagnosis.slow.statement import Stated

SMALLEST, LARGEST, HALVINGS = 1e-9, 4.0, 12
"""Sizes are looked for from and up to so many times their prior's, to one part in 4000."""

ONE_IN_TEN = 1.645
"""Prior standard deviations that one effect in ten exceeds: what shows only beyond them is not shown."""

ALL_AXES, ONE_AXIS = 2, 6
"""What an effect on all axes, or on one alone, pays for in trials, as the search counts them."""

FOLDS = float(np.log(1e3))
"""Logarithm of the largest ratio of two recordings' numbers that is worth telling of."""


@dataclass(frozen=True, slots=True)
class Smallest:
    """The smallest value of a parameter, on one axis, that is found nine times in ten, in `unit`.

    reference: the time constant or moment it is stated for, where the effect has one. reason: why the effect
    is hardly shown at all; "" where it is. hidden: the axes on which it does not show, such as those that lie
    across gravity in every rest, where a support that gives way does the same.
    """

    effect: str
    sensor: str
    parameter: str
    value: float
    unit: str
    reference: dict[str, float] = field(default_factory=dict)
    reason: str = ""
    hidden: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Sought:
    """A slow effect that was looked for. log_bayes_factor: nats for it, against none; follows: its driver.

    smallest: one for each of its parameters that the recording shows, at sizes that one in ten such effects
    has. hardly: whether it shows others only beyond these sizes.
    """

    effect: str
    sensor: str
    log_bayes_factor: float
    smallest: tuple[Smallest, ...]
    follows: str
    hardly: bool


def sought(exam: Examination) -> list[Sought]:
    """Return every named slow effect that the recording's rests and turns could be asked for.

    A recording is compared with several simulations: what it could be asked for is worked out once.
    """
    if "sought" not in exam.memo:
        exam.memo["sought"] = _every_sought(exam)
    found: list[Sought] = exam.memo["sought"]
    return found


def _every_sought(exam: Examination) -> list[Sought]:
    sensors = [*exam.sensors, *([] if exam.turns is None else [exam.turns])]
    out = []
    for residuals in sensors:
        if len(residuals.bins) >= thresholds.LEAST_BINS and residuals.sensor != exam.exchanged:
            every = effects_in(residuals)
            named = [e for e in every if e.name != "unknown" and (exam.timed or not follows_time(e.follows))]
            out += _of_one(residuals, named, _stated(exam, residuals))
    return out


def _stated(exam: Examination, residuals: SensorResiduals) -> list[Hypothesis]:
    """Return the hypotheses that were stated of a sensor's residuals."""
    return [
        s.hypothesis
        for s in exam.statements
        if s.hypothesis is not None and s.residuals is not None and kind_of(s.residuals) == kind_of(residuals)
    ]


def _of_one(
    residuals: SensorResiduals, effects: Sequence[Effect], stated: Sequence[Hypothesis]
) -> list[Sought]:
    """Fit one hypothesis of every effect, beside those stated of other effects."""
    asked = [one for effect in effects if (one := _typical(residuals, effect)) is not None]
    found = {h.effect.name for h in stated}
    groups = [[h for h in asked if h.effect.name not in found]]
    groups += [[h for h in asked if h.effect.name == name] for name in sorted(found)]
    out = []
    for group in groups:
        beside = [h for h in stated if h.effect.name not in {own.effect.name for own in group}]
        reduced = reduce_residuals(residuals, group, beside) if group else []
        out += [_sought(reduced, i, h) for i, h in enumerate(group)]
    return out


def _typical(residuals: SensorResiduals, effect: Effect) -> Hypothesis | None:
    """Return the middle one of an effect's hypotheses; of a step, one in the middle of the rests.

    Its multiplicity is that of all of them, which compete with it.
    """
    found = residuals.hypotheses(effect)
    if found:
        return replace(found[len(found) // 2], multiplicity=len(found))
    dictionary = effect.dictionary(residuals.moments)
    if dictionary is None or "t_start" not in effect.grid_units:
        return None
    middle = residuals.hypothesis(effect, {"t_start": float(np.median(residuals.bins.t))})
    return replace(middle, multiplicity=dictionary.multiplicity)


def _sought(reduced: Sequence[Reduced], index: int, hypothesis: Hypothesis) -> Sought:
    fit, effect = fit_hypothesis(reduced, index), hypothesis.effect
    gain = fit.log_likelihood - null_log_likelihood(reduced)
    evidence = gain + 0.5 * float(np.linalg.slogdet(fit.covariance)[1])
    variance = fit.covariance.diagonal()
    # The prior is taken off again: what is wanted is the error of the data alone.
    sigma = np.sqrt(variance / np.maximum(1.0 - variance, 1e-9))
    informed = np.sqrt(variance) < INFORMED
    needed = gain_of(
        thresholds.SCORE + effect.prior_penalty,
        int(np.count_nonzero(hypothesis.axis_of == 0)),
        degrees(reduced, index),
        hypothesis.multiplicity * ONE_AXIS,
    )
    smallest, first, hardly = [], 0, False
    for parameter in effect.parameters:
        rows = np.arange(first, first + parameter.count)
        first += parameter.count
        if informed[rows].any():
            worst = int(rows[informed[rows]][np.argmax(sigma[rows][informed[rows]])])
            half = _found_half_the_time(reduced, index, fit.every, worst, needed, start=sigma[worst])
            needed_size = half + NINE_IN_TEN * sigma[worst]
            if needed_size <= ONE_IN_TEN:
                size = float(needed_size * hypothesis.sizes[worst])
                hidden = hidden_axes(hypothesis.axis_of[rows], informed[rows])
                smallest.append(_smallest(hypothesis, parameter, size, hidden))
            else:
                hardly = True
    return Sought(effect.name, effect.sensor, evidence, tuple(smallest), effect.follows, hardly)


def _found_half_the_time(
    reduced: Sequence[Reduced], index: int, beta: Array, row: int, needed: float, *, start: float
) -> float:
    """Return the size of one parameter at which the gain is as large as needed, in units of its prior.

    start: about the right size, to look at first.
    """
    unit, without = np.eye(beta.size)[row], _likelihood(reduced, index, beta)

    def gain(size: float) -> float:
        return _gain(reduced, index, beta, size * unit, without)

    high = min(start, LARGEST)
    while high > SMALLEST and gain(0.5 * high) >= needed:
        high *= 0.5
    while gain(high) < needed and high < LARGEST:
        high *= 2.0
    low = high / 2.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if gain(middle) < needed else (low, middle)
    return high


def shows_as_large(exam: Examination, found: Stated) -> bool:
    """Whether a recording would have shown nine times in ten what another was found to have.

    It is put into this recording's own residuals, at a moment in the middle of the rests or, with a begin and
    an end, at the same part of the recording; all axes together or the largest alone must pass the search's
    threshold, as much smaller as chance makes one in ten. What this recording cannot be given, without what
    drives it, is taken to show: nothing speaks against it.
    """
    own, of = found.hypothesis, found.residuals
    if own is None or of is None:
        return True
    alike = [s for s in exam.with_turns if kind_of(s) == kind_of(of)]
    residuals = next((s for s in alike if len(s.bins) >= thresholds.LEAST_BINS), None)
    if residuals is None:
        return False
    effect, grid = own.effect, _moved(own, of, residuals)
    if any(p.name not in found.finding.parameters for p in effect.parameters):
        return True
    if not effect.can_play(residuals.moments, grid):
        return True
    there = replace(residuals.hypothesis(effect, grid), multiplicity=own.multiplicity)
    reduced = reduce_residuals(
        residuals, [there], [h for h in _stated(exam, residuals) if h.effect.name != effect.name]
    )
    size = found.sizes / there.sizes
    largest = there.axis_of == there.axis_of[int(np.argmax(np.abs(size)))]
    return _passes(reduced, there, size, ALL_AXES) or _passes(reduced, there, size * largest, ONE_AXIS)


def _passes(reduced: Sequence[Reduced], hypothesis: Hypothesis, size: Array, cost: int) -> bool:
    """Whether sizes (k,), in units of their prior, pass the search's threshold nine times in ten.

    cost: what their axes pay for in trials.
    """
    fit, effect = fit_hypothesis(reduced, 0), hypothesis.effect
    used = np.flatnonzero(size)
    if not used.size:
        return False
    # The prior is taken off again: what is wanted is the error of the data alone.
    information = np.linalg.inv(fit.covariance) - np.eye(size.size)
    sigmas = float(np.sqrt(np.maximum(size @ information @ size, 0.0)))
    if sigmas <= NINE_IN_TEN:
        return False
    trials = max(hypothesis.multiplicity, 1.0) * cost
    needed = gain_of(thresholds.SCORE + effect.prior_penalty, used.size, degrees(reduced, 0), trials)
    every = np.zeros(fit.every.size)
    # What is larger than physics makes it shows no worse, though its prior is against it.
    possible = min(1.0, ONE_IN_TEN / float(np.abs(size).max()))
    every[: size.size] = min(1.0 - NINE_IN_TEN / sigmas, possible) * size
    return _gain(reduced, 0, fit.every, every, _likelihood(reduced, 0, fit.every)) >= needed


def _moved(own: Hypothesis, of: SensorResiduals, to: SensorResiduals) -> dict[str, float]:
    """Return the grid point of an effect of one recording in another, whose times are others."""
    grid = dict(own.grid)
    if "t_start" in grid and "t_end" not in grid:
        return grid | {"t_start": float(np.median(to.bins.t))}
    (begin, end), (first, last) = of.bins.span, to.bins.span
    for name in ("t_start", "t_end"):
        if name in grid:
            grid[name] = first + (grid[name] - begin) / (end - begin) * (last - first)
    return grid


def _likelihood(reduced: Sequence[Reduced], index: int, beta: Array) -> float:
    """Return the log likelihood of the residuals with sizes (k,) taken off, in units of the prior."""
    return joint_log_likelihood(reduced, [log_terms(v, squares_left(v, index, beta)) for v in reduced])


def _gain(reduced: Sequence[Reduced], index: int, beta: Array, added: Array, without: float) -> float:
    """Return the gain in log likelihood by an effect of sizes `added` (k,), in units of the prior.

    The recording's own residuals without any effect (at the fit, `beta`, of likelihood `without`) get it, of
    either sign. The noise is refitted with it, as the search does: a part of every slow effect can pass for
    noise.
    """
    with_it = [_likelihood(reduced, index, beta - s * added) for s in (1.0, -1.0)]
    return without - 0.5 * float(added @ added) - float(np.mean(with_it))


def _smallest(hypothesis: Hypothesis, parameter: Linear, size: float, hidden: tuple[str, ...]) -> Smallest:
    effect = hypothesis.effect
    at = {k: v for k, v in hypothesis.grid.items() if k in effect.grid_units}
    return Smallest(effect.name, effect.sensor, parameter.name, size, parameter.unit, at, hidden=hidden)


def hidden_axes(axis_of: NDArray[Any], shown: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return the names of the axes on which none of a parameter's numbers is shown.

    axis_of: (k,) each number's axis, below 0 for none. shown: (k,) whether it is.
    """
    hidden = np.setdiff1d(axis_of[axis_of >= 0], axis_of[shown])
    return tuple(AXES[int(a)] for a in hidden)


def each_once(rows: Sequence[Smallest]) -> tuple[Smallest, ...]:
    """Return one row for each parameter: the least, where an effect has several forms."""
    least: dict[tuple[str, str, str], Smallest] = {}
    for row in rows:
        key = (row.effect, row.sensor, row.parameter)
        least[key] = min(least.get(key, row), row, key=lambda one: one.value)
    return tuple(least.values())


def of_difference(difference: Difference, comparisons: int) -> list[Smallest]:
    """Return, part by part, the smallest difference on one axis that is stated nine times in ten."""
    recorded = difference.recorded
    shown = recorded.informed & difference.simulated.informed
    least = difference.visible_from(comparisons)
    if recorded.logarithmic:
        shown = least < FOLDS
        smaller = np.exp(np.minimum(recorded.value, difference.simulated.value))
        least = smaller * np.expm1(np.minimum(least, FOLDS))
    out, first = [], 0
    for part in recorded.parts:
        rows = np.arange(first, first + part.count)
        first += part.count
        if shown[rows].any():
            size = float(least[rows][shown[rows]].max())
            hidden = () if recorded.logarithmic else hidden_axes(recorded.axis_of[rows], shown[rows])
            out.append(Smallest(recorded.effect, recorded.sensor, part.name, size, part.unit, hidden=hidden))
    return out
