"""What is said of one effect that was found: a finding with held-out evidence, rivals and a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.catalogue import ADOPT, ADOPTABLE
from stillcal.calib_core.diagnosis.effects.covariate import copies
from stillcal.calib_core.diagnosis.inference.cross_validation import FOLDS, HeldOut, held_out, likely_shapes
from stillcal.calib_core.diagnosis.inference.likelihood import fit_hypothesis, reduce_residuals, squares_left
from stillcal.calib_core.diagnosis.inference.score import LN10
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.records import AXES, SLOW_BAND, Alternative, Evidence, Finding, Where
from stillcal.calib_core.diagnosis.slow.estimate import Estimate, evidence_of, parameters, tried
from stillcal.calib_core.diagnosis.slow.search import Scored, Step, as_likely_beforehand

GRID_STRIDE = 3
"""Each third point of the fine grid is a candidate in every fold: neighbours are alike."""

ALTERNATIVES = 3
"""How many other effects are reported beside a finding."""


@dataclass(frozen=True, slots=True, eq=False)
class Stated:
    """A finding with the hypothesis it states and the residuals it was found in; None where it has none.

    beside: what is fitted beside it as the error of its model, and not told.
    """

    finding: Finding
    hypothesis: Hypothesis | None = None
    residuals: SensorResiduals | None = None
    beside: tuple[Hypothesis, ...] = ()

    @property
    def fitted(self) -> tuple[Hypothesis, ...]:
        """The hypothesis that it states, and those beside it."""
        return self.beside if self.hypothesis is None else (self.hypothesis, *self.beside)

    @property
    def sizes(self) -> Array:
        """The linear parameters (k,) as they were found, SI."""
        assert self.hypothesis is not None, "asked for with one only"
        own = self.hypothesis.effect.parameters
        return np.concatenate([np.ravel(self.finding.parameters[p.name].value) for p in own])


def finding(residuals: SensorResiduals, step: Step, found: Estimate, others: Sequence[Hypothesis]) -> Finding:
    """State the effect of one step as it was estimated; others: the effects found beside it."""
    own = found.hypothesis
    before, after = _predicted(residuals, None, others), _predicted(residuals, own, others)
    in_its_noise = held_out(residuals, [], [others], after.noise)
    shown = _shown(step)
    rivals = [(s, _predicted(residuals, s.hypothesis, others)) for s in (*shown, *_best_nameless(step))]
    alternatives = [
        _alternative(s, step.winner, before, each)
        for s, each in rivals
        if s.hypothesis.effect.name != "unknown"
    ]
    axes = named_axes(found)
    # That there is something without a name is at least as likely as any of the names that it may have.
    likely = [s.hypothesis for s in shown] if own.effect.name == "unknown" else []
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
            heldout_gain_in_one_noise=after.log_score - in_its_noise.log_score,
            folds=FOLDS,
            named_in_folds=_first_in(residuals, (step.winner, after), rivals),
            log_bayes_factor=max(evidence_of(residuals, h, others) for h in (own, *likely)),
        ),
        alternatives=alternatives,
        statement=sentence(found, axes, alternatives),
    )


def _first_in(
    residuals: SensorResiduals, own: tuple[Scored, HeldOut], rivals: Sequence[tuple[Scored, HeldOut]]
) -> int:
    """Return in how many folds an effect would be chosen before its rivals, without what is left out.

    An effect that was picked from many curves or grid points gives away the logarithm of their number, one
    without a name what names are preferred by, and a rival what it needs to be told from wander: the effect
    itself has paid that in the search. A copy is no rival: it says the same of the recording.
    """
    different = [r for r in rivals if not copies(own[0].hypothesis, r[0].hypothesis)]
    mine, *others = (_in_folds(residuals, *each) for each in (own, *different))
    paid = [LN10 * s.hypothesis.effect.prior_penalty for s, _ in different]
    ahead = [mine >= other - toll for other, toll in zip(others, paid, strict=True)]
    return int(np.sum(np.all(ahead, axis=0))) if others else len(mine)


def _in_folds(residuals: SensorResiduals, one: Scored, held: HeldOut) -> Array:
    """Return the log evidence (k,) of the folds, less what many kin and a lacking name give away."""
    margin = thresholds.UNKNOWN_MARGIN if one.hypothesis.effect.name == "unknown" else 0.0
    given = np.log(tried(residuals, one.hypothesis)) + LN10 * margin
    return np.asarray(held.training) - float(given)


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
        reduced = reduce_residuals(residuals)
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
    beforehand = as_likely_beforehand(winner) - as_likely_beforehand(other)
    apart = min(winner.score - other.score, beforehand)  # what looks like wander pays, or does not
    gain = after.log_score - before.log_score
    return Alternative(other.hypothesis.effect.name, gain, bool(apart < thresholds.MARGIN))


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
