"""Competition of the catalogue on one sensor's slow views, with forward steps.

Every hypothesis is scored on one scale (docs/misfit.md, 5); the best one above the threshold joins the
baseline and the search is repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from stillcal.calib_core.misfit import thresholds
from stillcal.calib_core.misfit.catalogue.entry import Entry, Hypothesis, Scene
from stillcal.calib_core.misfit.evidence import (
    Fit,
    Reduced,
    fit_hypothesis,
    gain_bound,
    null_log_likelihood,
    reduce_view,
)
from stillcal.calib_core.samples import Array


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """A hypothesis with its fit, score S and gain; profile: (grid point, gain) over its entry's grid."""

    hypothesis: Hypothesis
    fit: Fit
    score: float
    gain: float
    profile: tuple[tuple[dict[str, float], float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One forward step: the winner and the best of every other entry, best first.

    shadows: the winner's neighbours on its fine grid, and its kin. They are projected out
    with it later, so that what a time constant slightly off leaves is not taken for another effect.
    """

    winner: Scored
    others: tuple[Scored, ...]
    shadows: tuple[Hypothesis, ...] = ()

    @property
    def explained(self) -> tuple[Hypothesis, ...]:
        """What later steps project out."""
        return (self.winner.hypothesis, *self.shadows)


def score(gain: float, parameters: int, dof: float, trials: int) -> float:
    """Return S: minus log10 of the F tail of a gain in log likelihood, less log10 of the grid's size."""
    from scipy.stats import f as f_distribution  # noqa: PLC0415 - the daemon stays light

    explained = -np.expm1(-2.0 * max(gain, 0.0) / dof)
    ratio = (explained / parameters) / (max(1.0 - explained, 1e-15) / max(dof - parameters, 1.0))
    log_tail = float(f_distribution.logsf(ratio, parameters, max(dof - parameters, 1.0)))
    return float(-log_tail / np.log(10.0) - np.log10(trials))


def proposals(scene: Scene, entries: Sequence[Entry]) -> list[Hypothesis]:
    """Return all hypotheses that the entries propose in a scene."""
    return [h for entry in entries for h in entry.propose(entry, scene)]


def compete(
    scene: Scene, hypotheses: Sequence[Hypothesis], found: Sequence[Hypothesis] = ()
) -> tuple[list[Scored], list[Reduced]]:
    """Score every hypothesis with baseline and `found` projected out; best of each entry, best first."""
    reduced = reduce_scene(scene, hypotheses, found)
    null = null_log_likelihood(reduced)
    dof = sum(v.dof for v in reduced)
    trials: dict[int, int] = {}
    for h in hypotheses:
        trials[id(h.entry)] = trials.get(id(h.entry), 0) + 1
    scored: dict[int, list[Scored]] = {}
    for index, h in enumerate(hypotheses):
        rank = visible(reduced, index)
        if rank == 0:
            continue
        bound = score(gain_bound(reduced, index) - null, rank, dof, trials[id(h.entry)])
        if bound < thresholds.WORTH_FITTING:
            continue
        fit = fit_hypothesis(reduced, index)
        gain = fit.log_likelihood - null
        scored.setdefault(id(h.entry), []).append(
            Scored(h, fit, score(gain, rank, dof, trials[id(h.entry)]) - h.entry.handicap, gain)
        )
    return sorted((_best(group) for group in scored.values()), key=lambda s: -s.score), reduced


def _best(group: list[Scored]) -> Scored:
    top = max(group, key=lambda s: s.gain)
    profile = tuple((s.hypothesis.grid, s.gain) for s in group)
    return Scored(top.hypothesis, top.fit, top.score, top.gain, profile)


def reduce_scene(
    scene: Scene, hypotheses: Sequence[Hypothesis], found: Sequence[Hypothesis] = ()
) -> list[Reduced]:
    """Reduce every view of a scene for a list of hypotheses."""
    widths = [h.columns[0].shape[2] for h in hypotheses]
    ends = np.cumsum([0, *widths])
    index = [np.arange(a, b) for a, b in pairwise(ends)]
    reduced = []
    for i, view in enumerate(scene.views):
        design = np.concatenate([h.columns[i] * h.sizes for h in hypotheses], axis=2)
        extra = np.concatenate([f.columns[i] * f.sizes for f in found], axis=2) if found else None
        reduced.append(reduce_view(view, design, index, _nonzero(extra)))
    return reduced


def _nonzero(extra: Array | None) -> Array | None:
    """Drop columns that a view does not see."""
    if extra is None:
        return None
    seen = np.abs(extra).max(axis=(0, 1)) > 0.0
    return extra[:, :, seen] if seen.any() else None


def visible(reduced: Sequence[Reduced], h: int) -> int:
    """Return how many directions of hypothesis `h` would show above white noise at their physical size."""
    information = sum(v.blocks[h][0] for v in reduced)
    return int((np.linalg.eigvalsh(np.asarray(information)) > 1.0).sum())


def forward(scene: Scene, hypotheses: list[Hypothesis], threshold: float = thresholds.SCORE) -> list[Step]:
    """Return the forward steps whose winner passes the threshold, at most `thresholds.MAX_FINDINGS`."""
    steps: list[Step] = []
    while hypotheses and len(steps) < thresholds.MAX_FINDINGS:
        before = [h for s in steps for h in s.explained]
        ranked, _ = compete(scene, hypotheses, before)
        if not ranked or ranked[0].score < threshold:
            break
        step = refined(scene, prefer_named(Step(ranked[0], tuple(ranked[1:]))), before)
        steps.append(step)
        hypotheses = [h for h in hypotheses if not _spent(h.entry, step.winner.hypothesis.entry)]
    return steps


def _spent(entry: Entry, winner: Entry) -> bool:
    """Whether a winner rules an entry out of later steps: all that name one effect, unless it can recur."""
    return not winner.recurs and (entry is winner or (entry.effect == winner.effect != "unknown"))


def prefer_named(step: Step) -> Step:
    """Let a catalogue effect win over a generic one that is better by less than the margin."""
    if step.winner.hypothesis.entry.effect != "unknown":
        return step
    near = [
        s
        for s in step.others
        if s.hypothesis.entry.effect != "unknown" and step.winner.score - s.score < thresholds.MARGIN
    ]
    if not near:
        return step
    return Step(near[0], (step.winner, *(s for s in step.others if s is not near[0])))


def refined(scene: Scene, step: Step, before: Sequence[Hypothesis]) -> Step:
    """Move the winner to the best point of its entry's fine grid."""
    winner = step.winner.hypothesis
    kin = () if winner.entry.kin is None else tuple(winner.entry.kin(winner.entry, scene))
    if winner.entry.refine is None:
        return replace(step, shadows=kin)
    candidates = winner.entry.refine(winner.entry, scene, winner.grid)
    reduced = reduce_scene(scene, candidates, before)
    gains = [fit_hypothesis(reduced, i).log_likelihood for i in range(len(candidates))]
    best = int(np.argmax(gains))
    near = [candidates[i] for i in (best - 1, best + 1) if 0 <= i < len(candidates)]
    return replace(step, winner=replace(step.winner, hypothesis=candidates[best]), shadows=(*near, *kin))
