"""Competition of the catalogue on one sensor's slow views, with forward steps.

Every hypothesis is scored on one scale (docs/diagnosis.md, 5); the best one above the threshold joins the
baseline and the search is repeated.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.effects.catalogue import nameless
from stillcal.calib_core.diagnosis.effects.covariate import copies, of_column
from stillcal.calib_core.diagnosis.effects.unknown import SmoothCurve
from stillcal.calib_core.diagnosis.inference.likelihood import (
    Fit,
    Maximum,
    fit_hypothesis,
    gain_bound,
    highest,
    maximum,
    null_log_likelihood,
    reduce_residuals,
)
from stillcal.calib_core.diagnosis.inference.reduction import Reduced
from stillcal.calib_core.diagnosis.inference.score import degrees, score, visible
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.effect import Effect
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals, difference
from stillcal.calib_core.diagnosis.slow.estimate import finest
from stillcal.calib_core.diagnosis.slow.screen import screened

COLUMNS = 128
"""Of hypotheses reduced together, the baseline taken off once: 30 MB of sums. More take no less time."""

CHANCE = 1e-3
"""Probability by chance above which an axis may as well not be moved."""

ACROSS = 13.8
"""Chi-squared of two components that chance exceeds once in 1000."""


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """A hypothesis with its fit, score S and gain."""

    hypothesis: Hypothesis
    fit: Fit
    score: float
    gain: float


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One forward step: the winner and the best of every other effect, best first.

    neighbours: the winner's slope along its fine grid, and its companions. They are projected out with it
    later, so that what a time constant slightly off leaves is not taken for another effect.
    """

    winner: Scored
    others: tuple[Scored, ...]
    neighbours: tuple[Hypothesis, ...] = ()

    @property
    def explained(self) -> tuple[Hypothesis, ...]:
        """What later steps project out."""
        return (self.winner.hypothesis, *self.neighbours)


def proposals(residuals: SensorResiduals, effects: Sequence[Effect]) -> list[Hypothesis]:
    """Return the hypotheses that the effects propose in a sensor's residuals, as far as these can judge them.

    A curve without a name that has more numbers than half of what the bins leave, beside all that is fitted
    anyway, goes through whatever they are: 18 of them through 24 rests in as many attitudes.
    """
    free = sum(v.free() for v in residuals.views)
    every = [h for effect in effects for h in residuals.hypotheses(effect)]
    return [h for h in every if h.effect.name != "unknown" or 2 * h.sizes.size <= free]


def compete(
    residuals: SensorResiduals, hypotheses: Sequence[Hypothesis], found: Sequence[Hypothesis] = ()
) -> list[Scored]:
    """Score every hypothesis with baseline and `found` projected out; best of each effect, best first."""
    grids = Counter(id(h.effect) for h in hypotheses)
    best: dict[int, Scored] = {}
    for some in _batches(hypotheses):
        reduced = reduce_residuals(residuals, some, found, parts=True)
        null = null_log_likelihood(reduced)
        leading: dict[int, tuple[int, float, Maximum | None]] = {}
        most = np.array([gain_bound(reduced, 4 * index) - null for index in range(len(some))])
        for index in np.argsort(-most, kind="stable").tolist():  # the likeliest first, to spare others
            h = some[index]
            known = best.get(id(h.effect))
            _, least, _ = leading.get(id(h.effect), (0, known.score if known else -np.inf, None))
            beat = max(thresholds.WORTH_FITTING, least + h.effect.prior_penalty)
            trials = h.multiplicity or grids[id(h.effect)]
            own, top = _judged(reduced, index, null, float(most[index]), trials=trials, beat=beat)
            if own - h.effect.prior_penalty > least:
                leading[id(h.effect)] = index, own - h.effect.prior_penalty, top
        for effect, (index, value, top) in leading.items():
            fit = fit_hypothesis(reduced, 4 * index, top)
            best[effect] = Scored(some[index], fit, value, fit.log_likelihood - null)
    return sorted(best.values(), key=lambda s: -s.score)


def _batches(hypotheses: Sequence[Hypothesis]) -> Iterator[Sequence[Hypothesis]]:
    """Yield the hypotheses, so many at a time that they have about `COLUMNS` columns."""
    ends = np.cumsum([h.columns[0].shape[2] for h in hypotheses])
    for _, some in groupby(zip(hypotheses, ends, strict=True), key=lambda pair: int(pair[1] - 1) // COLUMNS):
        yield [h for h, _ in some]


def _judged(
    reduced: Sequence[Reduced], index: int, null: float, most: float, *, trials: float, beat: float
) -> tuple[float, Maximum | None]:
    """Score a hypothesis on all axes and on each alone, and keep the better: minus infinity if below `beat`.

    Set 4 `index` of the reduced residuals is the whole hypothesis, the next three are its axes. All axes cost
    a factor of two in trials, one axis one of six. No axis gains more than all of them, and these at most
    `most`. The second is the maximum of the whole, where it was needed.
    """
    best, whole, of_whole = -np.inf, 4 * index, None
    freedom = degrees(reduced, whole)
    if not freedom:
        return best, None
    if score(most, 1, freedom, trials * 2) < beat:
        return best, None
    for part, cost in ((whole, 2), (whole + 1, 6), (whole + 2, 6), (whole + 3, 6)):
        rank, dof = visible(reduced, part), degrees(reduced, part)
        if rank == 0:
            continue
        least = max(best, beat)
        bound = most if part == whole else gain_bound(reduced, part) - null
        if score(bound, rank, dof, trials * cost) < least:
            continue
        top = maximum(reduced, part)
        of_whole = top if part == whole else of_whole
        best = max(best, score(top[1] - null, rank, dof, trials * cost))
    return best, of_whole


def forward(
    residuals: SensorResiduals, effects: Sequence[Effect], threshold: float = thresholds.SCORE
) -> list[Step]:
    """Return the forward steps above the threshold, at most `thresholds.MAX_FINDINGS`; names unweighed."""
    steps: list[Step] = []
    while len(steps) < thresholds.MAX_FINDINGS:
        before = [h for s in steps for h in s.explained]
        ranked = ranking(residuals, effects, before)
        if ranked and ranked[0].score >= threshold:
            step = prefer_named(residuals, Step(ranked[0], tuple(ranked[1:])), before)
            step = refined(residuals, prefer_original(prefer_pair(residuals, step, before)), before)
        elif (pair := of_hidden_pair(residuals, ranked, effects, before, threshold)) is not None:
            step = refined(residuals, pair, before)
        else:
            break
        steps.append(step)
        effects = [e for e in effects if not _spent(e, step.winner.hypothesis.effect)]
    return forms_anew(residuals, steps)


def of_hidden_pair(
    residuals: SensorResiduals,
    ranked: Sequence[Scored],
    effects: Sequence[Effect],
    before: Sequence[Hypothesis],
    threshold: float,
) -> Step | None:
    """Return the better of two named effects that pass the threshold only beside each other, or None.

    To either of them the other one is noise that differs from rest to rest, large enough to hide it. Each of
    the best few names, in its best form, is tried with the best second, which pays for the number of these.
    """
    likely = [s for s in ranked if s.score >= thresholds.HIDDEN_SCORE]
    by_name = {s.hypothesis.effect.name: s for s in reversed(likely) if s.hypothesis.effect.name != "unknown"}
    named = sorted(by_name.values(), key=lambda s: -s.score)[: thresholds.PAIRS]
    best, chosen = -np.inf, None
    known: set[str] = set()
    for one in named:
        if one.hypothesis.effect.name in known:
            continue
        others = [e for e in effects if not _spent(e, one.hypothesis.effect)]
        beside = [*before, one.hypothesis]
        top, *rest = ranking(residuals, others, beside) or [one]
        if top is one or top.score < threshold + float(np.log10(len(named))):
            continue
        second = prefer_named(residuals, Step(top, tuple(rest)), beside).winner
        if second.hypothesis.effect.name == "unknown":
            continue
        own = proposals(residuals, [one.hypothesis.effect])
        first = compete(residuals, own, [*before, second.hypothesis])[:1]
        if first and first[0].score >= threshold and first[0].score + second.score > best:
            known = {one.hypothesis.effect.name, second.hypothesis.effect.name}
            best = first[0].score + second.score
            chosen = Step(first[0], tuple(s for s in ranked if s is not one))
    return chosen


def forms_anew(residuals: SensorResiduals, steps: Sequence[Step]) -> list[Step]:
    """Choose the form of each name again, such as a straight line or a parabola, beside all other steps.

    What is found first bends for what is found after it, and needs no bend beside that. With it, a curve
    without a name predicted what was left out better than the name.
    """
    chosen = list(steps)
    for k, step in enumerate(steps):
        own = step.winner.hypothesis
        kin = [s for s in step.others if s.hypothesis.effect.name == own.effect.name != "unknown"]
        others = [h for other in chosen if other is not step for h in other.explained]
        if not kin or not others:
            continue
        best = compete(residuals, [own, *(s.hypothesis for s in kin)], others)[:1]
        for one in (s for s in kin for b in best if s.hypothesis is b.hypothesis):
            rest = (step.winner, *(s for s in step.others if s is not one))
            chosen[k] = refined(residuals, Step(one, rest), others)
    return chosen


def beside_each_other(residuals: SensorResiduals, known: Sequence[Hypothesis]) -> list[Step]:
    """Return effects that are known to be there as steps, each with all the others projected out."""
    steps = []
    for own in known:
        others = [h for h in known if h is not own]
        steps += [refined(residuals, Step(s, ()), others) for s in compete(residuals, [own], others)]
    return steps


def adequate(steps: Sequence[Step]) -> list[Step]:
    """Withhold names that leave too much: a name is of the larger part, and what it leaves stands beside it.

    A neighbour's name explains part of what something outside the catalogue does and leaves the rest. What
    the best of names leaves of a large effect, its model being a model, is not reported.
    """
    steps = [_one_of_many(s, steps) for s in _one_heat(steps)]
    strange = max((s.winner.gain for s in steps if _effect(s) == "unknown"), default=0.0)
    of_models = max(map(_of_model, steps), default=0.0)
    return [s for s in steps if s.winner.gain >= (of_models if _effect(s) == "unknown" else strange)]


def _of_model(step: Step) -> float:
    """Return the gain that structure may have which is only the error of a named effect's model."""
    if _effect(step) == "unknown":
        return 0.0
    return max(thresholds.MODELLED, step.winner.hypothesis.effect.rough) ** 2 * step.winner.gain


def departs(step: Step, named: Step) -> bool:
    """Whether structure is how a named effect departs from its driver, by less than its model is sure of.

    The gain of a large effect grows with the logarithm of its size, and so tells little of what is small
    beside it: of a sensor that is warm a second before its thermometer, 1.4 % of its bias gained 7.7 %.
    A model errs on the axes that it moves: what surely moves another one is no error of it.
    """
    effect, other = step.winner.hypothesis.effect, named.winner.hypothesis.effect
    if not isinstance(effect, SmoothCurve) or _effect(named) == "unknown" or effect.of not in other.follows:
        return False
    small = _moved(step.winner) < thresholds.MODELLED * _moved(named.winner)
    return bool((small | (_chances(step.winner) >= CHANCE)).all())


def _moved(one: Scored) -> Array:
    """Return by how much each axis (3,) of a hypothesis as fitted moves the residuals: root of squares."""
    beta, axis = one.hypothesis.sizes * one.fit.beta, one.hypothesis.axis_of
    each = np.where(axis[:, None] == np.arange(3), beta[:, None], 0.0)
    squares = [((columns @ each) ** 2).sum(axis=(0, 1)) for columns in one.hypothesis.columns]
    return np.asarray(np.sqrt(np.sum(squares, axis=0)))


def _chances(one: Scored) -> Array:
    """Return the probability (3,) that an axis' parameters are as large by chance (Wald's chi-squared)."""
    from scipy.special import chdtrc  # noqa: PLC0415 - the daemon stays light

    axis, beta, covariance = one.hypothesis.axis_of, one.fit.beta, one.fit.covariance
    of = [np.flatnonzero(axis == a) for a in range(3)]
    far = [beta[own] @ np.linalg.solve(covariance[np.ix_(own, own)], beta[own]) for own in of]
    return np.array([chdtrc(float(own.size), float(x)) for own, x in zip(of, far, strict=True)])


def _one_heat(steps: Sequence[Step]) -> list[Step]:
    """Leave out what without a name moves the axes as heat does that was found: of its curve little is known.

    Charging and use stand for heat that was not recorded; the room's share of it is on the same axes.
    """
    heat = next((s for s in steps if _effect(s) == "thermal_latent"), None)
    if heat is None:
        return list(steps)
    sensitivity = heat.winner.fit.beta[:3]
    return [s for s in steps if _effect(s) != "unknown" or not _along(s.winner, sensitivity)]


def _along(one: Scored, direction: Array) -> bool:
    """Whether every curve of a bias moves the axes as `direction` (3,) does, within its errors."""
    effect, owner = one.hypothesis.effect, one.hypothesis.axis_of
    if effect.by_row or effect.parameters[0].name != "amplitude":
        return False
    unit = direction / np.linalg.norm(direction)
    across = np.linalg.svd(unit[None])[2][1:]
    for of in np.stack([np.flatnonzero(owner == a) for a in range(3)], axis=1):
        away = across @ one.fit.beta[of]
        spread = across @ one.fit.covariance[np.ix_(of, of)] @ across.T
        if away @ np.linalg.solve(spread, away) > ACROSS:
            return False
    return True


def _effect(step: Step) -> str:
    return step.winner.hypothesis.effect.name


def _one_of_many(step: Step, steps: Sequence[Step]) -> Step:
    """Take the name off an effect that comes once but was found several times, or beside a course of several.

    As many as are looked for may be some of more. A few may be as many single ones: whether they are is told
    by their sizes, estimated together (`findings`).
    """
    name = _effect(step)
    if name == "unknown":
        return step
    times = sum(name == _effect(s) for s in steps)
    beside = any(name == s.winner.hypothesis.effect.several_of for s in steps)
    return without_name(step) if beside or times >= thresholds.MAX_FINDINGS else step


def without_name(step: Step) -> Step:
    """Return a step whose winner has no name any more."""
    own = step.winner.hypothesis
    return replace(step, winner=replace(step.winner, hypothesis=replace(own, effect=nameless(own.effect))))


def ranking(
    residuals: SensorResiduals, effects: Sequence[Effect], found: Sequence[Hypothesis] = ()
) -> list[Scored]:
    """Return the best hypothesis of every effect with `found` projected out, best first."""
    empty = reduce_residuals(residuals, found=found)
    hypotheses = [*proposals(residuals, effects), *screened(residuals, effects, empty, found)]
    return compete(residuals, hypotheses, found)


def _spent(effect: Effect, winner: Effect) -> bool:
    """Whether a winner rules an effect out of later steps: all that name one effect, unless it can recur."""
    return not winner.recurs and effect.name == winner.name != "unknown"


def prefer_pair(residuals: SensorResiduals, step: Step, before: Sequence[Hypothesis]) -> Step:
    """Let a named effect win over a nameless one where, with a second name, it explains as much.

    Two effects together may look like neither; each of the best few names is tried with the best second,
    and pays for the number of these.
    """
    if step.winner.hypothesis.effect.name != "unknown":
        return step
    named = [s for s in step.others if s.hypothesis.effect.name != "unknown"][: thresholds.PAIRS]
    best, chosen = as_likely_beforehand(step.winner) - thresholds.UNKNOWN_MARGIN, step
    for one in named:
        effects = [
            s.hypothesis.effect for s in named if not _spent(s.hypothesis.effect, one.hypothesis.effect)
        ]
        first, together = _with_second(residuals, one, effects, before)
        if together > best:
            best = together
            chosen = Step(first, (step.winner, *(s for s in step.others if s is not one)))
    return chosen


def _with_second(
    residuals: SensorResiduals, one: Scored, effects: Sequence[Effect], before: Sequence[Hypothesis]
) -> tuple[Scored, float]:
    """Return one of two effects that explain the most together, and their score: minus infinity if alone.

    The best point of either effect alone is not its best point beside the other, least of all of two steps:
    either is sought again beside the other, as long as both together gain by it.
    """
    ranked = ranking(residuals, effects, [*before, one.hypothesis])
    first, best = one, one.score + ranked[0].score if ranked else -np.inf
    while ranked:
        second = _alone(residuals, ranked[0], before)
        ranked = ranking(residuals, [first.hypothesis.effect], [*before, second.hypothesis])
        if not ranked or second.score + ranked[0].score <= best:
            break
        first, best = second, second.score + ranked[0].score
    return first, best - float(np.log10(max(len(effects), 1)))


def _alone(residuals: SensorResiduals, one: Scored, before: Sequence[Hypothesis]) -> Scored:
    """Return a hypothesis as it scores without the one beside which it was found."""
    own = one.hypothesis
    reduced = reduce_residuals(residuals, [own], before)
    fit = fit_hypothesis(reduced, 0)
    gain = fit.log_likelihood - null_log_likelihood(reduced)
    trials = 2 * (own.multiplicity or len(residuals.hypotheses(own.effect)))
    return Scored(own, fit, score(gain, visible(reduced, 0), degrees(reduced, 0), trials), gain)


def prefer_named(residuals: SensorResiduals, step: Step, before: Sequence[Hypothesis]) -> Step:
    """Let a catalogue effect win over a generic one that is better by less than the margin.

    The best few names are judged at the best points of their fine grids: a generic curve has no grid to miss.
    """
    if step.winner.hypothesis.effect.name != "unknown":
        return step
    named = [s for s in step.others if s.hypothesis.effect.name != "unknown"][: thresholds.PAIRS]
    fine = sorted((sharpened(residuals, s, before) for s in named), key=lambda s: -as_likely_beforehand(s))
    others = [*fine, *(s for s in step.others if s not in named)]
    for s in fine:
        if as_likely_beforehand(step.winner) - as_likely_beforehand(s) < thresholds.UNKNOWN_MARGIN:
            return Step(s, (step.winner, *(other for other in others if other is not s)))
    return Step(step.winner, tuple(sorted(others, key=lambda s: -s.score)))


def prefer_original(step: Step) -> Step:
    """Let an effect of the catalogue win over that of a logged column which is a copy of what it follows."""
    own = step.winner
    copied = [s for s in step.others if not of_column(s.hypothesis) and copies(own.hypothesis, s.hypothesis)]
    if not of_column(own.hypothesis) or not copied:
        return step
    return Step(copied[0], (own, *(s for s in step.others if s is not copied[0])))


def as_likely_beforehand(one: Scored) -> float:
    """Return a score without its penalty, which is for what wander looks like: here something surely is."""
    effect = one.hypothesis.effect
    penalty = thresholds.UNKNOWN_PENALTY if effect.name == "unknown" else 0.0
    return one.score + effect.prior_penalty - penalty


def sharpened(residuals: SensorResiduals, one: Scored, before: Sequence[Hypothesis]) -> Scored:
    """Return a hypothesis at the best point of its fine grid, as one of so many as its coarse grid has."""
    own = one.hypothesis
    fine = refined(residuals, Step(one, ()), before).winner.hypothesis
    if fine is own:
        return one
    tried = own.multiplicity or len(residuals.hypotheses(own.effect))
    again = compete(residuals, [replace(fine, multiplicity=tried)], before)
    return max([one, *again], key=lambda s: s.score)


def refined(residuals: SensorResiduals, step: Step, before: Sequence[Hypothesis]) -> Step:
    """Move the winner to the best point of its effect's fine grid."""
    winner = step.winner.hypothesis
    companions = tuple(residuals.companions(winner.effect))
    candidates = finest(residuals, winner, before)
    if candidates == [winner]:
        return replace(step, neighbours=companions)
    reduced = reduce_residuals(residuals, candidates, before)
    gains = [highest(reduced, i) for i in range(len(candidates))]
    best = int(np.argmax(gains))
    before_it, after_it = candidates[max(best - 1, 0)], candidates[min(best + 1, len(candidates) - 1)]
    slope = difference(after_it, before_it)
    return replace(
        step, winner=replace(step.winner, hypothesis=candidates[best]), neighbours=(slope, *companions)
    )
