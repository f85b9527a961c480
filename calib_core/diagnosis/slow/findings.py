"""The slow diagnosis of one sensor: forward search, joint parameters, held-out evidence, findings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.catalogue import ADOPT, ADOPTABLE
from stillcal.calib_core.diagnosis.effects.catalogue import effects_in
from stillcal.calib_core.diagnosis.effects.covariate import copies
from stillcal.calib_core.diagnosis.inference.cross_validation import FOLDS, HeldOut, held_out, likely_shapes
from stillcal.calib_core.diagnosis.inference.likelihood import Reduced, fit_hypothesis, squares_left
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals, nothing
from stillcal.calib_core.diagnosis.model.measurement import NORMAL_95
from stillcal.calib_core.diagnosis.model.records import AXES, SLOW_BAND, Alternative, Evidence, Finding, Where
from stillcal.calib_core.diagnosis.model.rotation_alignment import Aligned
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.segments.value_grid import ROUNDED
from stillcal.calib_core.diagnosis.slow import between_rest_variance as jumps
from stillcal.calib_core.diagnosis.slow.estimate import Estimate, estimate, evidence_of, parameters, tried
from stillcal.calib_core.diagnosis.slow.form import departures_of, doubted
from stillcal.calib_core.diagnosis.slow.form import stated as form_stated
from stillcal.calib_core.diagnosis.slow.search import (
    LN10,
    Scored,
    Step,
    adequate,
    beside_each_other,
    forward,
    reduce_residuals,
    without_name,
)
from stillcal.calib_core.diagnosis.slow.turn_residuals import turn_residuals
from stillcal.calib_core.diagnosis.slow.wander import wander

CHANCE = 1e-3
"""Probability of parameters as large by chance, above which a finding beside others is none."""

NOTHING = 0.05
"""The same of a named finding that is alone: its values are within their errors of nothing."""

GRID_STRIDE = 3
"""Each third point of the fine grid is a candidate in every fold: neighbours are alike."""

ACROSS = float(np.log(100.0))
"""Gain, nats, that two sizes across gravity have by chance one time in a hundred (chi-squared of two)."""

TURNING = 0.1
"""Variance across gravity, by direction, over that along it, below which what is left of a gyroscope's rates
may be turns of the support. A bias that wanders or jumps does so on each axis."""

ALTERNATIVES = 3
"""How many other effects are reported beside a finding."""


@dataclass(frozen=True, slots=True, eq=False)
class Stated:
    """A finding with the hypothesis it states and the residuals it was found in; None where it has none."""

    finding: Finding
    hypothesis: Hypothesis | None = None
    residuals: SensorResiduals | None = None

    @property
    def sizes(self) -> Array:
        """The linear parameters (k,) as they were found, SI."""
        assert self.hypothesis is not None, "asked for with one only"
        own = self.hypothesis.effect.parameters
        return np.concatenate([np.ravel(self.finding.parameters[p.name].value) for p in own])


def slow_findings(residuals: SensorResiduals, without: Collection[str] = ()) -> list[Finding]:
    """Return what the still bins of one sensor show, as `slow_statements` does, as findings only."""
    return [s.finding for s in slow_statements(residuals, without)]


def slow_statements(
    residuals: SensorResiduals, without: Collection[str] = (), sought: Sequence[Hypothesis] | None = None
) -> list[Stated]:
    """Return what the still bins of one sensor show, in the order it was found.

    without: effects that are left out of the catalogue. sought: the only ones that may be there, of any
    sensor, each at its point; None: all of the catalogue are searched for. What jumps from rest to rest
    leaves is not called wander besides. Where nothing stands, nothing is explained, and wander is all that
    there is.
    """
    if len(residuals.bins) < thresholds.LEAST_BINS:
        return []
    if sought is None:
        steps = forward(residuals, effects_in(residuals, without))
    elif known := [h for h in sought if _may_show(residuals, h)]:
        steps = beside_each_other(residuals, [residuals.hypothesis(h.effect, h.grid) for h in known])
    else:
        return []
    found, left = _jumps(residuals, steps)
    if found:
        steps = [step for step in adequate(steps) if jumps.stands(residuals, step.winner, found)]
        found, left = _jumps(residuals, steps)
    stated = statements_of(residuals, steps)
    if _along_gravity(residuals, _explained(steps)):
        beside = []
    elif found:
        beside = [jumps.finding(residuals, found)]
    else:
        withdrawn = steps and not stated
        wandering = wander(
            residuals, reduce_residuals(residuals, [nothing(residuals)]) if withdrawn else left
        )
        beside = not_unknown_twice(stated, wandering)
    return [
        *stated,
        *(Stated(replace(f, effect="unknown") if f.effect in without else f) for f in beside),
    ]


def _may_show(residuals: SensorResiduals, other: Hypothesis) -> bool:
    """Whether an effect of other residuals shows in these, if it is there."""
    effect, moments = other.effect, residuals.moments
    return effect.sensor == residuals.sensor and not effect.in_turns and effect.can_play(moments, other.grid)


def _explained(steps: Sequence[Step]) -> list[Hypothesis]:
    """Return the hypotheses of the steps that are adequate."""
    return [h for step in adequate(steps) for h in step.explained]


def _along_gravity(residuals: SensorResiduals, explained: Sequence[Hypothesis]) -> bool:
    """Whether what is left of a gyroscope's rates is along gravity alone, as where the support turns."""
    if residuals.sensor != "gyro" or residuals.turns or residuals.up is None:
        return False
    left = [v.left(*(h.columns[i][0] for h in explained)) for i, v in enumerate(residuals.views)]
    rates = np.stack(left, axis=1)
    along = float(((rates * residuals.up).sum(axis=1) ** 2).sum())
    return float((rates**2).sum()) - along < 2.0 * TURNING * along


def not_unknown_twice(stated: Sequence[Stated], wandering: Sequence[Finding]) -> list[Finding]:
    """Return the wander without what has no name beside other structure without one, which leaves some."""
    nameless = any(s.finding.effect == "unknown" for s in stated)
    return [f for f in wandering if not (nameless and f.effect == "unknown")]


def _jumps(residuals: SensorResiduals, steps: Sequence[Step]) -> tuple[jumps.Jumps | None, list[Reduced]]:
    """Return a bias' jumps beside the steps, and the residuals with these taken out."""
    explained = _explained(steps)
    left = reduce_residuals(residuals, [nothing(residuals)], explained)
    return jumps.jumps(residuals, explained, left), left


def turn_findings(made: Aligned, bins: Bins, gravity: float, without: Collection[str] = ()) -> list[Finding]:
    """Return what the turns between rests show, as `turn_statements` does, as findings only."""
    return [s.finding for s in turn_statements(turn_residuals(made, bins, gravity), without)]


def turn_statements(residuals: SensorResiduals | None, without: Collection[str] = ()) -> list[Stated]:
    """Return what gravity carried by the gyroscope from rest to rest shows; `without`: effects left out.

    residuals: the turns (`turn_residuals`). Where rests are too few to judge the accelerometer, its errors
    would be taken for the gyroscope's.
    """
    if residuals is None or len(residuals.bins) < thresholds.LEAST_BINS:
        return []
    return statements_of(residuals, forward(residuals, effects_in(residuals, without)))


def findings_of(residuals: SensorResiduals, steps: Sequence[Step]) -> list[Finding]:
    """Turn forward steps into findings, as `statements_of` does, as findings only."""
    return [s.finding for s in statements_of(residuals, steps)]


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
        made = [_finding(residuals, *each) for each in zip(kept, estimates, others, strict=True)]
        if (changed := _not_predicting(steps, kept, made)) is not None:
            steps = changed
            continue
        forms = departures_of(residuals, estimates)
        doubtful = doubted(residuals, kept, estimates, forms)
        if doubtful is None:
            told = [form_stated(form, e) for form, e in zip(forms, estimates, strict=True)]
            made = [replace(f, departure=d) for f, d in zip(made, told, strict=True)]
            return each_driver_once(
                [Stated(f, e.hypothesis, residuals) for f, e in zip(made, estimates, strict=True)]
            )
        steps = _unnamed(steps, doubtful)
    return []


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
        return _unnamed(steps, unsized[-1])
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


def _without(steps: Sequence[Step], weak: Step) -> list[Step]:
    """Return the steps but one. Those after it were found beside it, and score no less without it."""
    return [s for s in steps if s.winner.fit is not weak.winner.fit]


def _finding(residuals: SensorResiduals, step: Step, found: Estimate, others: list[Hypothesis]) -> Finding:
    own = found.hypothesis
    before, after = _predicted(residuals, None, others), _predicted(residuals, own, others)
    rivals = [
        (s, _predicted(residuals, s.hypothesis, others)) for s in (*_shown(step), *_best_nameless(step))
    ]
    alternatives = [
        _alternative(s, step.winner, before, each)
        for s, each in rivals
        if s.hypothesis.effect.name != "unknown"
    ]
    axes = named_axes(found)
    return Finding(
        effect=own.effect.name,
        sensor=residuals.sensor,
        axes=axes,
        where=_where(residuals, own),
        parameters=parameters(found),
        evidence=Evidence(
            heldout_rmse_before=before.rmse(under=after),
            heldout_rmse_after=after.rmse(under=after),
            heldout_log_score_gain=after.log_score - before.log_score,
            folds=FOLDS,
            named_in_folds=_first_in(residuals, (step.winner, after), rivals),
            log_bayes_factor=evidence_of(residuals, own, others),
        ),
        alternatives=alternatives,
        statement=sentence(found, axes, alternatives),
    )


def _first_in(
    residuals: SensorResiduals, own: tuple[Scored, HeldOut], rivals: Sequence[tuple[Scored, HeldOut]]
) -> int:
    """Return in how many folds an effect would be chosen before its rivals, without what is left out.

    An effect that was picked from many curves or grid points gives away the logarithm of their number, and
    one without a name what names are preferred by. A copy is no rival: it says the same of the recording.
    """
    different = [r for r in rivals if not copies(own[0].hypothesis, r[0].hypothesis)]
    mine, *others = (
        np.array(h.training) - np.log(tried(residuals, s.hypothesis)) - _given_away(s)
        for s, h in (own, *different)
    )
    return int(np.sum(np.all([mine >= other for other in others], axis=0))) if others else len(mine)


def _given_away(one: Scored) -> float:
    """Return the log evidence that a hypothesis gives away, nats: none with a name."""
    return LN10 * thresholds.UNKNOWN_MARGIN if one.hypothesis.effect.name == "unknown" else 0.0


def _best_nameless(step: Step) -> list[Scored]:
    """Return the best rival without a name, which a name must beat."""
    nameless = [s for s in step.others if s.hypothesis.effect.name == "unknown"]
    return nameless[:1] if step.winner.hypothesis.effect.name != "unknown" else []


def _shown(step: Step) -> list[Scored]:
    """Return the best other effects that have a name, each once."""
    shown: dict[str, Scored] = {}
    for s in step.others:
        effect = s.hypothesis.effect.name
        if effect not in ("unknown", step.winner.hypothesis.effect.name):
            shown.setdefault(effect, s)
    return list(shown.values())[:ALTERNATIVES]


def _predicted(
    residuals: SensorResiduals, hypothesis: Hypothesis | None, others: Sequence[Hypothesis]
) -> HeldOut:
    """Return held-out scores with `others` and, if given, one more effect, the noise refitted for it."""
    effects = [*([] if hypothesis is None else [hypothesis]), *others]
    if not effects:
        reduced = reduce_residuals(residuals, [nothing(residuals)])
        shapes = [likely_shapes(v, r, r.left) for v, r in zip(residuals.views, reduced, strict=True)]
        return held_out(residuals, shapes, [[]])
    reduced = reduce_residuals(residuals, effects[:1], effects[1:])
    beta = fit_hypothesis(reduced, 0).every
    left = [squares_left(r, 0, beta) for r in reduced]
    shapes = [likely_shapes(v, r, x) for v, r, x in zip(residuals.views, reduced, left, strict=True)]
    if hypothesis is None:
        return held_out(residuals, shapes, [effects])
    nearby = [h for h in residuals.finer(hypothesis) if h is not hypothesis][::GRID_STRIDE]
    return held_out(residuals, shapes, [effects, *([h, *others] for h in nearby)])


def _alternative(other: Scored, winner: Scored, before: HeldOut, after: HeldOut) -> Alternative:
    return Alternative(
        other.hypothesis.effect.name,
        after.log_score - before.log_score,
        bool(winner.score - other.score < thresholds.MARGIN),
    )


def named_axes(found: Estimate) -> list[str]:
    """Return the axes whose parameters stand out of their own errors, at least the one that does most."""
    owner = found.hypothesis.axis_of
    strength = np.abs(found.value) / np.maximum(found.sigma, 1e-300)
    by_axis = [float(strength[owner == a].max(initial=0.0)) for a in range(3)]
    least = min(thresholds.AXIS_SIGMA, max(by_axis))
    size = np.abs(found.value) / found.hypothesis.sizes
    share = np.array([size[owner == a].max(initial=0.0) for a in range(3)])
    large = share >= thresholds.AXIS_SHARE * share.max()
    named = [AXES[a] for a in range(3) if by_axis[a] >= least and large[a]]
    return named or [AXES[int(np.argmax(by_axis))]]


def _size(found: Estimate, axes: list[str]) -> str:
    """Return the first parameter in words: its value on each named axis, or the largest of a matrix."""
    first = found.hypothesis.effect.parameters[0]
    unit = "" if first.unit == "1" else f" {first.unit}"
    value = found.value[: first.count]
    rows = [AXES.index(a) for a in axes]
    if first.count == 3:
        return ", ".join(f"{axis} {value[row]:+.3g}" for axis, row in zip(axes, rows, strict=True)) + unit
    top = int(np.argmax(np.abs(value) * np.isin(found.hypothesis.axis_of[: first.count], rows)))
    if first.count == 9:
        row, column = AXES[top // 3], AXES[top % 3]
        return f"up to {value[top]:.3g}{unit} ({row} by {column}); all 9 numbers are in --json"
    return f"{first.name} {value[top]:.3g}{unit}"


def _where(residuals: SensorResiduals, hypothesis: Hypothesis) -> Where:
    start, end = residuals.bins.span
    t_start = hypothesis.grid.get("t_start", start)
    return Where(t_start, hypothesis.grid.get("t_end", end), SLOW_BAND, hypothesis.effect.follows)


def sentence(found: Estimate, axes: list[str], alternatives: list[Alternative]) -> str:
    """Return what is said of a finding: its size, what can be done, and what it cannot be told from."""
    effect = found.hypothesis.effect
    alike = [a.effect for a in alternatives if a.indistinguishable]
    correct = f"to correct it: {ADOPT}" if effect.name in ADOPTABLE and not alike else ""
    said = f"{effect.sentence.format(axes=', '.join(axes))[:-1]} ({_size(found, axes)})"
    text = f"{'; '.join(filter(None, (said, effect.remedy, correct)))}."
    if not alike:
        return text
    decides = f" To decide: {effect.decides}." if effect.decides else ""
    return f"{text} This recording cannot distinguish it from {' or '.join(alike)}.{decides}"
