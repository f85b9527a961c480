"""Whether a recording keeps to the form that a name gives: an effect against itself with its form left open.

A name says how a bias follows its driver: in proportion, at once, always alike. Something else that follows
the same driver is explained in large part by that name, and what it leaves is too small for a search among
everything. Here only the one question is asked, of what was found.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.bias import BiasEffect
from stillcal.calib_core.diagnosis.effects.unknown import LENGTHS, Unknown, waves_on_axes
from stillcal.calib_core.diagnosis.inference.bayes_factor import SIZES, log_evidence
from stillcal.calib_core.diagnosis.inference.likelihood import fit_hypothesis, log_sum, reduce_residuals
from stillcal.calib_core.diagnosis.inference.reduction import NOTHING
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Linear, on_axes
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, Parameters, SensorResiduals, difference
from stillcal.calib_core.diagnosis.model.moments import Moments, first_order
from stillcal.calib_core.diagnosis.model.records import Departure
from stillcal.calib_core.diagnosis.slow.estimate import Estimate, estimate, evidence_of
from stillcal.calib_core.diagnosis.slow.search import Scored, Step, refined
from stillcal.calib_core.streams.time_series import TimeSeries

LAGS = (20.0, 60.0, 200.0, 600.0, 2000.0)
"""s: time constants with which an effect may come late; the shortest is two bins."""

RIVALS = 3
"""Other names, the likeliest, that are compared with their forms left open."""

LEVEL = 0.05
"""Part of a curve's range within which it is at either end of it."""

LATE, BENT, CHANGING = "not all at once", "along another curve", "not alike at all times"
"""In what an effect may depart from the form that its name gives."""


def departure(residuals: SensorResiduals, found: Estimate, others: Sequence[Hypothesis]) -> Departure:
    """Return how what was found departs from its form, with `others` beside it, in rests.

    The noise is fitted anew for each way of departing. The effect's sizes are free beside it, and so is a
    time constant, or moment, that is slightly off.
    """
    own = found.hypothesis
    ways = [
        (way, Hypothesis(_part(residuals.sensor, made), {}, residuals.columns_of(made, own.effect.blind)))
        for way, made in _departures(residuals.moments, found)
    ]
    reduced = reduce_residuals(residuals, [h for _, h in ways], [own, *_slope(residuals, own), *others])
    # The least size of a departure is next to nothing: it is no less likely than that, but for its share.
    least = -float(np.log(SIZES.size))
    none = log_evidence(reduced, NOTHING)
    factors = np.array([max(log_evidence(reduced, i) - none, least) for i in range(len(ways))])
    best = int(factors.argmax())
    way, likeliest = ways[best]
    part = _part_of(likeliest, fit_hypothesis(reduced, best).beta, found)
    return Departure(log_sum(factors) - float(np.log(len(ways))), part, way)


def doubted(
    residuals: SensorResiduals,
    steps: Sequence[Step],
    estimates: Sequence[Estimate],
    departures: Sequence[Departure | None],
) -> Step | None:
    """Return the last of findings that stand together whose name does not; None where every name does."""
    found = [e.hypothesis for e in estimates]
    for i in reversed(range(len(steps))):
        form, others = departures[i], [*found[:i], *found[i + 1 :]]
        if form is None:
            continue
        if _of_another(residuals, i, steps, estimates) or not _keeps(
            residuals, steps[i], estimates[i], others, form
        ):
            return steps[i]
    return None


def departures_of(residuals: SensorResiduals, estimates: Sequence[Estimate]) -> list[Departure | None]:
    """Return how each finding departs from its form, with the others beside it; None without a name.

    In turns nothing is judged: what comes late there is not known from one to the next.
    """
    found = [e.hypothesis for e in estimates]
    return [
        None if residuals.turns or _nameless(e) else departure(residuals, e, [*found[:i], *found[i + 1 :]])
        for i, e in enumerate(estimates)
    ]


def stated(form: Departure | None, found: Estimate) -> Departure | None:
    """Return a departure that is sure, and more than a model of the effect is off by in any case."""
    return form if form is not None and _is_sure(form, found) else None


def _is_sure(form: Departure, found: Estimate) -> bool:
    least = max(thresholds.MODELLED, found.hypothesis.effect.rough)
    return form.log_bayes_factor > thresholds.CERTAIN_NATS and form.part > least


def _nameless(found: Estimate) -> bool:
    return found.hypothesis.effect.name == "unknown"


def _of_another(
    residuals: SensorResiduals, i: int, steps: Sequence[Step], estimates: Sequence[Estimate]
) -> bool:
    """Whether a finding may be no effect of its own, but how another one departs from its form.

    That one has a form that may be left open: it has a name, or had one until it was doubted. A second effect
    is one of as many as were looked for, of which one is expected.
    """
    found = [e.hypothesis for e in estimates]
    looked_for = float(np.log(1 + len(steps[i].others)))
    for j, other in enumerate(estimates):
        if j == i or isinstance(other.hypothesis.effect, Unknown):
            continue
        rest = [h for k, h in enumerate(found) if k not in (i, j)]
        alone = estimate(residuals, other.hypothesis, rest)
        own = evidence_of(residuals, found[i], [alone.hypothesis, *rest]) - looked_for
        if departure(residuals, alone, rest).log_bayes_factor > own - thresholds.CERTAIN_NATS:
            return True
    return False


def _keeps(
    residuals: SensorResiduals, step: Step, found: Estimate, others: Sequence[Hypothesis], form: Departure
) -> bool:
    """Whether a name stands: its form holds, or it is the larger part and no other name comes as near.

    Where its form does not hold, other names are as likely, with their forms left open, but for odds that are
    no decision.
    """
    if form.log_bayes_factor <= thresholds.CERTAIN_NATS or form.part <= thresholds.MODELLED:
        return True
    pure = evidence_of(residuals, found.hypothesis, others)
    if form.log_bayes_factor > pure:
        return False
    own = _left_open(pure, form)
    for rival in _rivals(step):
        near = estimate(residuals, refined(residuals, Step(rival, ()), others).winner.hypothesis, others)
        other = evidence_of(residuals, near.hypothesis, others)
        if _left_open(other, departure(residuals, near, others)) > own - thresholds.CERTAIN_NATS:
            return False
    return True


def _rivals(step: Step) -> list[Scored]:
    """Return the likeliest of each other name, `RIVALS` of them."""
    best: dict[str, Scored] = {}
    for other in step.others:
        best.setdefault(other.hypothesis.effect.name, other)
    own = ("unknown", step.winner.hypothesis.effect.name)
    return [s for name, s in best.items() if name not in own][:RIVALS]


def _left_open(pure: float, form: Departure) -> float:
    """Return the log Bayes factor of a name whose form is its own (`pure`) or open, as likely beforehand."""
    return pure + float(np.logaddexp(0.0, form.log_bayes_factor) - np.log(2.0))


def _part(sensor: str, made: Array) -> Parameters:
    return Parameters("departure", sensor, (Linear("part", "1", made.shape[2], 1.0),))


def _departures(moments: Moments, found: Estimate) -> list[tuple[str, Array]]:
    """Return the ways of departing from a form, each as responses (n, 3, k) as large as the effect is.

    Gaussian processes, as those of structure without a name are (`effects/unknown.py`), on each axis by
    itself: over time, by which the effect is multiplied; and over the curve that it follows. What comes late
    is a sum of first-order responses to it, with as many time constants as the recording shows.
    """
    effect, grid = found.hypothesis.effect, found.hypothesis.grid
    error = effect.response(moments, grid) @ found.value
    error = error - error.mean(axis=0)
    start, end = moments.history.span
    age = np.repeat((moments.age / (end - start))[:, None], 3, axis=1)
    made = [(CHANGING, error[:, :, None] * waves_on_axes(age, length)) for length in LENGTHS[:-1]]
    place = _place(effect.curve(moments, grid) if isinstance(effect, BiasEffect) else None, error)
    if place is not None:
        made += [
            (BENT, np.ptp(error, axis=0)[:, None] * waves_on_axes(place, length)) for length in LENGTHS[:-1]
        ]
    late = [_late(moments.t, error, lag) for lag in LAGS if lag <= (end - start) / 2.0]
    if late:
        made.append((LATE, np.concatenate([on_axes(x - error) for x in late], axis=2)))
    return made


def _place(curve: Array | None, error: Array) -> Array | None:
    """Return where on its curve an effect is (n, 3), 0 to 1; None where it has two levels, and no curve.

    What follows no one curve, as it does not that follows attitude, follows its own size on each axis.
    """
    along = error if curve is None else np.repeat(curve[:, None], 3, axis=1)
    span = np.ptp(along, axis=0)
    place = (along - along.min(axis=0)) / np.where(span > 0.0, span, 1.0)
    between = (place > LEVEL) & (place < 1.0 - LEVEL)
    return place if between.any() else None


def _late(t: Array, error: Array, lag: float) -> Array:
    """Return what a first-order system makes of an effect (n, 3) that is in balance at first."""
    return np.stack([first_order(TimeSeries(t, axis), lag).at(t) for axis in error.T], axis=1)


def _slope(residuals: SensorResiduals, own: Hypothesis) -> list[Hypothesis]:
    """Return what a time constant, or a moment, that is slightly off leaves; nothing without one."""
    fine = residuals.finer(own)
    if fine == [own] or not own.effect.grid_units:
        return []
    name = next(iter(own.effect.grid_units))
    away = [abs(h.grid[name] - own.grid[name]) for h in fine]
    i = int(np.argmin(away))
    return [difference(fine[min(i + 1, len(fine) - 1)], fine[max(i - 1, 0)])]


def _part_of(likeliest: Hypothesis, beta: Array, found: Estimate) -> float:
    """Return the amplitude of a departure over that of the effect: rms in the residuals' own units.

    What of the departure goes with the effect is the effect's own size.
    """
    apart = whole = 0.0
    for columns, own in zip(likeliest.columns, found.hypothesis.columns, strict=True):
        x, y = (columns @ beta).ravel(), (own @ found.value).ravel()
        x, y = x - x.mean(), y - y.mean()
        power = float(y @ y)
        x = x - y * float(x @ y) / max(power, 1e-300)
        apart, whole = apart + float(x @ x) / x.size, whole + power / x.size
    return float(np.sqrt(apart / max(whole, 1e-300)))
