"""Which of the steps of a search stand: what does not is taken out, and the others are weighed anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from stillcal.calib_core.diagnosis.inference.cross_validation import FOLDS
from stillcal.calib_core.diagnosis.inference.likelihood import fit_hypothesis, reduce_residuals
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.segments.value_grid import ROUNDED
from stillcal.calib_core.diagnosis.slow import statement
from stillcal.calib_core.diagnosis.slow.estimate import Estimate, estimate
from stillcal.calib_core.diagnosis.slow.form import departures_of, doubted
from stillcal.calib_core.diagnosis.slow.form import stated as form_stated
from stillcal.calib_core.diagnosis.slow.search import Scored, Step, adequate, departs, without_name
from stillcal.calib_core.diagnosis.slow.statement import Stated

CHANCE = 1e-3
"""Probability of parameters as large by chance, above which a finding beside others is none."""

NOTHING = 0.05
"""The same of a named finding that is alone: its values are within their errors of nothing."""

ACROSS = float(np.log(100.0))
"""Gain, nats, that two sizes across gravity have by chance one time in a hundred (chi-squared of two)."""


def statements_of(residuals: SensorResiduals, steps: Sequence[Step]) -> list[Stated]:
    """Turn forward steps into findings, each estimated with the others beside it.

    Where none of the steps stands, the first one is tried by itself: beside a later one without a name, which
    follows anything where rests are few, its size was not known. Then what was a rival of it is tried, the
    likeliest first: the search was sure that there is structure, and only its shape was wrong.
    """
    stated = _standing(residuals, steps)
    tried = iter([*steps[:1], *_rivals(steps[0])]) if steps else iter(())
    while not stated and (rival := next(tried, None)):
        stated = _standing(residuals, [rival])
    return stated


def _standing(residuals: SensorResiduals, steps: Sequence[Step]) -> list[Stated]:
    """Return the steps that stand, as findings; without one that does not, the others are weighed anew."""
    while kept := adequate(steps):
        found = [step.winner.hypothesis for step in kept]
        others = [[f for f in found if f is not own] for own in found]
        if (changed := _not_by_themselves(residuals, steps, kept, others)) is not None:
            steps = changed
            continue
        estimates = [estimate(residuals, own, rest) for own, rest in zip(found, others, strict=True)]
        if (changed := _not_sized(residuals, steps, kept, estimates)) is not None:
            steps = changed
            continue
        made = [statement.finding(residuals, *each) for each in zip(kept, estimates, others, strict=True)]
        if (changed := _not_predicting(steps, kept, made)) is not None:
            steps = changed
            continue
        forms = departures_of(residuals, estimates)
        doubtful = doubted(residuals, kept, estimates, forms)
        if doubtful is None:
            told = [form_stated(form, e) for form, e in zip(forms, estimates, strict=True)]
            made = [replace(f, departure=d) for f, d in zip(made, told, strict=True)]
            found = [e.hypothesis for e in estimates]
            return each_driver_once(_with_departures(residuals, kept, made, found))
        steps = _unnamed(steps, doubtful)
    return []


def _with_departures(
    residuals: SensorResiduals,
    kept: Sequence[Step],
    made: Sequence[Finding],
    found: Sequence[Hypothesis],
) -> list[Stated]:
    """Return the statements; the error of a name's model is beside the first such name, and not told."""
    whose = [next((k for k, other in enumerate(kept) if departs(step, other)), None) for step in kept]
    beside = [tuple(h for h, of in zip(found, whose, strict=True) if of == k) for k in range(len(kept))]
    every = zip(made, found, whose, beside, strict=True)
    return [Stated(f, h, residuals, with_it) for f, h, of, with_it in every if of is None]


def _not_by_themselves(
    residuals: SensorResiduals,
    steps: Sequence[Step],
    kept: Sequence[Step],
    others: Sequence[Sequence[Hypothesis]],
) -> list[Step] | None:
    """Return the steps without the last that scores too little or may be a turn of the support; None if none.

    others: of each of `kept`, the other effects.
    """
    if not _stands_alone(kept[-1].winner):
        return _without(steps, kept[-1]) + _passed_over(kept[-1])
    pairs = zip(kept, others, strict=True)
    turned = [s for s, rest in pairs if _turns(residuals, s.winner.hypothesis, rest)]
    return _without(steps, turned[-1]) if turned else None


def _not_sized(
    residuals: SensorResiduals, steps: Sequence[Step], kept: Sequence[Step], estimates: Sequence[Estimate]
) -> list[Step] | None:
    """Return the steps without the last whose sizes are none, or without names that these do not bear.

    What is nothing once the others are free to move with it was their model's fault; so is what is within the
    rounding of rates. None where all have sizes.
    """
    pairs = list(zip(kept, estimates, strict=True))
    nothing_left = [s for s, e in pairs if _within_a_code(residuals, e)] or [
        s for s, e in pairs if _by_chance(e, len(kept))
    ]
    if nothing_left:
        return _without(steps, nothing_left[-1])
    unsized = [s for s, e in pairs if _unsized(e)]
    if unsized:
        return _perhaps_named(steps, unsized[-1])
    to_and_fro = _to_and_fro(estimates)
    return _as_one(steps, to_and_fro) if to_and_fro else None


def _not_predicting(
    steps: Sequence[Step], kept: Sequence[Step], made: Sequence[Finding]
) -> list[Step] | None:
    """Return the steps without the last that the parts that took no part in the fit do not speak for.

    It is the last, for it was found beside the others. Where they speak for it and not for its name, the
    others' sizes need it: only its name is taken off. None where all are borne out.
    """
    unsupported = [k for k, finding in enumerate(made) if _supported(finding) <= 0.0]
    if not unsupported:
        return None
    last = unsupported[-1]
    return _unsupported(steps, kept[last], made[last] if len(kept) > 1 else None)


def _turns(residuals: SensorResiduals, own: Hypothesis, others: Sequence[Hypothesis]) -> bool:
    """Whether a nameless course of the gyroscope's bias may as well be a turn of the support about gravity.

    A bias belongs to the body's axes and has a size on each; such a turn has one about gravity, whatever the
    attitude. In one attitude it is a bias of certain sizes: it is the turn unless the sizes across gravity
    gain more than `ACROSS`.
    """
    effect, up = own.effect, residuals.up
    if residuals.sensor != "gyro" or residuals.turns or up is None:
        return False
    if effect.name != "unknown" or effect.by_row or effect.parameters[0].name != "amplitude":
        return False
    course = np.sum([columns[0] for columns in own.columns], axis=0)
    turn = replace(own, columns=residuals.columns_of(up[:, :, None] * course[:, None, :]))
    reduced = reduce_residuals(residuals, [own, turn], others)
    bias, motion = (fit_hypothesis(reduced, h).log_likelihood for h in (0, 1))
    return motion > bias - ACROSS


def _within_a_code(residuals: SensorResiduals, found: Estimate) -> bool:
    """Whether a course over time of the gyroscope's bias may be no larger than a step of coarse rates.

    A mean that no noise dithers keeps to one code, and goes to the next where a bias that wanders, as every
    bias does, comes across the border: its course is of the rounding, and may have any shape over time. Where
    noise dithers, `rate_rounding` is nothing. An accelerometer's codes change with each attitude.
    """
    rounding = residuals.bins.rate_rounding
    if residuals.sensor != "gyro" or residuals.turns or rounding is None:
        return False
    if "time" not in found.hypothesis.effect.follows:
        return False
    least = np.sign(found.value) * np.maximum(np.abs(found.value) - NORMAL_95 * found.sigma, 0.0)
    swings = [float(np.ptp(columns[0] @ least)) for columns in found.hypothesis.columns]
    return bool((np.array(swings) <= ROUNDED * rounding).all())


def _unsized(found: Estimate) -> bool:
    """Whether a name with a moment or a time constant has sizes that may be nothing, each of them.

    They differ with the moment then: something changes, and it is not what the name says.
    """
    named = found.hypothesis.effect.name != "unknown" and bool(found.hypothesis.grid)
    return named and bool((np.abs(found.value) < NORMAL_95 * found.sigma).all())


def _to_and_fro(estimates: Sequence[Estimate]) -> str:
    """Return the name of an effect found twice whose second size may undo the first; "" where there is none.

    A bias that is afterwards what it was before went to and fro, which is no step. The errors of two sizes
    are taken to be independent: together they are no larger, for both share the level between them.
    """
    from scipy.special import chdtrc  # noqa: PLC0415 - the daemon stays light

    named = [e for e in estimates if e.hypothesis.effect.name != "unknown"]
    for one, other in combinations(named, 2):
        if one.hypothesis.effect.name == other.hypothesis.effect.name:
            apart = (one.value + other.value) ** 2 / (one.sigma**2 + other.sigma**2)
            if chdtrc(float(apart.size), float(apart.sum())) >= CHANCE:
                return one.hypothesis.effect.name
    return ""


def _by_chance(found: Estimate, count: int) -> bool:
    """Whether values as far from nothing come by chance. count: of findings, this one among them.

    One alone that has a name is nothing only if its values do not differ from nothing at all: it was found
    for a shape of the noise that came with it, and not for its size.
    """
    if count >= 2:
        return found.chance() >= CHANCE
    return found.hypothesis.effect.name != "unknown" and found.chance() >= NOTHING


def _rivals(first: Step) -> list[Step]:
    """Return what is tried if a first step does not stand, the likeliest first, each beside the others.

    What scored more than a name that was preferred to it comes first. A rival must score what a finding
    must; what scored less than that only where the first step did, too.
    """
    least = min(thresholds.SCORE, first.winner.score)
    every = [first.winner, *first.others]
    rivals = sorted((s for s in first.others if s.score >= least), key=lambda s: -s.score)
    return [Step(s, tuple(other for other in every if other is not s)) for s in rivals]


def each_driver_once(stated: Sequence[Stated]) -> list[Stated]:
    """Return the statements without a second one of no name that follows the same as a likelier one.

    A curve without a name is a model too; what it leaves of one cause is no second cause.
    """
    nameless = [s.finding for s in stated if s.finding.effect == "unknown"]
    kept: list[Finding] = []
    for one in sorted(nameless, key=lambda f: -f.evidence.log_bayes_factor):
        if not any(_of_one_cause(one, other) for other in kept):
            kept.append(one)
    return [s for s in stated if s.finding.effect != "unknown" or any(s.finding is f for f in kept)]


def _of_one_cause(one: Finding, other: Finding) -> bool:
    """Whether two findings follow the same, or come again with one period, as a tone and its overtones."""
    if one.where.driver == other.where.driver:
        return True
    if not all("period_s" in f.parameters for f in (one, other)):
        return False
    span = one.where.t_end - one.where.t_start
    cycles = [span / float(np.max(f.parameters["period_s"].value)) for f in (one, other)]
    return abs(cycles[0] - cycles[1]) < 0.5  # a cycle apart, they are independent


def _supported(finding: Finding) -> float:
    """Return the gain in held-out log score; none where few folds chose the name, or the whole speaks not."""
    evidence = finding.evidence
    chosen = finding.effect == "unknown" or (evidence.named_in_folds or 0) > FOLDS // 2
    likelier = evidence.log_bayes_factor > 0.0
    stands = chosen and likelier and not evidence.contradicted
    return (evidence.heldout_log_score_gain or 0.0) if stands else 0.0


def _stands_alone(found: Scored) -> bool:
    """Whether a finding scores at least what a name that is preferred to nameless structure may."""
    allowed = thresholds.UNKNOWN_MARGIN + found.hypothesis.effect.prior_penalty
    return found.score >= thresholds.SCORE - allowed


def _passed_over(step: Step) -> list[Step]:
    """Return what a name was preferred to for the sake of a second one that did not last."""
    return [Step(s, ()) for s in step.others[:1] if s.score >= thresholds.SCORE]


def _as_one(steps: Sequence[Step], name: str) -> list[Step]:
    """Return the steps with the two of one name, which went to and fro, as one without a name.

    It is the curve that the first of them was preferred to; where there is none, only their names go.
    """
    both = [s for s in steps if s.winner.hypothesis.effect.name == name]
    curve = [s for s in _passed_over(both[0]) if s.winner.hypothesis.effect.name == "unknown"]
    if not curve:
        return [without_name(s) if s in both else s for s in steps]
    return curve + [s for s in steps if s not in both]


def _unsupported(steps: Sequence[Step], weak: Step, among_others: Finding | None) -> list[Step]:
    """Return the steps without one, or without its name where only that is not borne out.

    among_others: the finding that it makes beside others; None where there are none.
    """
    if among_others is not None and _supported(replace(among_others, effect="unknown")) > 0.0:
        return _unnamed(steps, weak)
    return _without(steps, weak)


def _unnamed(steps: Sequence[Step], one: Step) -> list[Step]:
    """Return the steps with the name of one taken off."""
    return [without_name(s) if s.winner.fit is one.winner.fit else s for s in steps]


def _perhaps_named(steps: Sequence[Step], one: Step) -> list[Step]:
    """Return the steps with the name of one among its rivals: it fits, and its sizes are not known."""
    return [
        replace(without_name(s), others=(s.winner, *s.others)) if s.winner.fit is one.winner.fit else s
        for s in steps
    ]


def _without(steps: Sequence[Step], weak: Step) -> list[Step]:
    """Return the steps but one. Those after it were found beside it, and score no less without it."""
    return [s for s in steps if s.winner.fit is not weak.winner.fit]
