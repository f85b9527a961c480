"""What the paper says of whole modes of evaluation, averaged over features and learners (4.2 and 5.1)."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.claim import Cause, Claim, Evidence, Verdict, agreement, holds
from stillcal.replay.studies.har.features import FAMILIES
from stillcal.replay.studies.har.scoring import (
    INDEPENDENT,
    LEARNERS,
    Labels,
    by_person,
    by_recogniser,
    interval,
    with_interval,
)
from stillcal.replay.studies.stisen2015.both_ways import OTHER, both_ways
from stillcal.replay.studies.stisen2015.modes.rows import DENSE, NINE, Judged, Mask, other_windows
from stillcal.replay.studies.stisen2015.modes.scores import (
    CLUSTER_DEVICE,
    FEW,
    FIGURE_5,
    INTRA,
    MODEL_DEVICE,
    OFTEN,
    ONE,
    Found,
    among_nine,
    by_fold,
    paired,
    ways,
)

WORK = "Stisen 2015"
OTHERS = "other clusters, user out"
CHANCE = 0.05
"""Share of draws of nine people above which a statement of the paper may be theirs alone."""

NEAR = 5.0
"""Points of F1, half of what the paper's modes differ by."""

AVERAGES = {
    "ten": ("4.2, Figure 5", "average F1, random ten-fold", "91.0 %"),
    "user": ("4.2, Figure 5", "average F1, leave one user out", "66.7 %"),
    "one": ("4.2, Figure 5", "average F1, one model, one user out", "56.4 %"),
    "intra": ("4.2, Figure 5", "average F1, one device of a known model out", "77.7 %"),
    "higher": (
        "4.2, Figure 5",
        "trained on its own model instead of another one: F1 is significantly higher",
        "significantly",
    ),
    "most": (
        "4.2",
        "what its own model gains over another one, the most of all recognisers",
        "up to 30 points",
    ),
    "order": (
        "4.2",
        "average F1 falls from ten-fold to a user out to one model with a user out",
        "91.0, 66.7, 56.4 %",
    ),
    "best": ("4.2", "ten-fold is best for each family of features and learner", "all"),
    "model": ("4.2", "a model never trained on costs less than a user never trained on", "lower impairment"),
    "cluster": (
        "5.1, Figure 12",
        "training within the cluster against on all devices",
        "69.1 against 66.7 %",
    ),
    "one model": (
        "5.1, Figures 5 and 12",
        "training within the cluster scores significantly higher than training on one model",
        "69.1 against 56.4 %",
    ),
    "device": (
        "5.1, Figure 12",
        "user and device out: training within the cluster against within the model",
        "64.2 against 61.7 %",
    ),
    "excluded": (
        "5.1, footnote 4",
        "without the device's cluster in training, frequency features drop the most",
        "especially steep",
    ),
    "excluded tree": (
        "5.1, footnote 4",
        "without the device's cluster in training, C4.5 drops the most of the learners",
        "especially steep",
    ),
    "load": ("4.2, Figure 9", "trained without load, tested under load", "stated"),
}


def claim(
    row: tuple[str, str, str],
    ours: str,
    verdict: Verdict,
    because: str,
    cause: Cause | None = None,
    *,
    brief: str = "",
) -> Claim:
    """Return a claim on semi-synthetic data; the study fills in which."""
    evidence = Evidence.NONE if verdict is Verdict.UNTESTED else Evidence.SEMI_SYNTHETIC
    return Claim(WORK, *row, ours, "none", verdict, because, evidence=evidence, cause=cause, brief=brief)


def averages(found: Found) -> list[Claim]:
    """Judge everything that is said of averages, in the order of AVERAGES."""
    return [
        *_levels(found),
        *_own_model(found),
        _order(found),
        _best(found),
        _model(found),
        _cluster(found),
        _one_model(found),
        _device(found),
        *_excluded(found),
        claim(AVERAGES["load"], "", Verdict.UNTESTED, "no recording was made under load"),
    ]


AS_FEW = f"with {NINE} people, as in the paper, {DENSE} windows of each and nobody lying"
"""What `of_nine` is, in words."""


def often(holding: Mask) -> bool:
    """Return whether a statement holds in so many draws that nine people may make it. holding: (DRAWS,)."""
    return int(np.sum(holding)) >= OFTEN


def in_draws(holding: Mask) -> str:
    """Say in how many draws of people a statement holds. holding: (DRAWS,)."""
    return f"in {int(np.sum(holding))} of {len(holding)} draws"


def _levels(found: Found) -> list[Claim]:
    why = "within 5 points, half of what the paper's modes differ by; other people, one phone's walk"
    rows = (("ten", "ten-fold", 91.0), ("user", "user out", 66.7), ("one", ONE, 56.4))
    made = []
    for key, mode, paper in rows:
        ours, cause = found.mean(mode), None
        if mode in found.causes.nine:
            few = found.causes.nine[mode].mean(axis=(1, 2))
            near = np.abs(few - paper) <= NEAR
            cause = Cause(
                f"{AS_FEW}, {few.mean():.1f} ({few.min():.1f} to {few.max():.1f}) %, mean and range of draws"
                f" of people; {in_draws(near)} it is within {NEAR:.0f} points of the paper's",
                shown=often(near),
            )
        made.append(claim(AVERAGES[key], f"{ours:.1f} %", agreement(paper, ours, NEAR), why, cause))
    ours, other = found.mean(INTRA), found.mean(other_windows(INTRA))
    twins = Cause(
        "the tested windows are in training as the other device of the model recorded them, and here to the"
        f" sample. By the same recognisers on windows whose motion they never saw it is {other:.1f} %",
        shown=_closes(77.7, ours, other),
    )
    cell = f"{ours:.1f} %; {OTHER} {other:.1f} %"
    return [*made, claim(AVERAGES["intra"], cell, agreement(77.7, ours, NEAR), why, twins)]


def _closes(paper: float, ours: float, tried: float) -> bool:
    """Return whether what was tried comes within NEAR and takes away half of the difference or more."""
    return abs(tried - paper) <= min(NEAR, abs(ours - paper) / 2.0)


def _own_model(found: Found) -> list[Claim]:
    """Compare one device of a known model out with training on another model."""
    both = [(INTRA, "one model"), (other_windows(INTRA), other_windows("one model"))]
    p = [paired(found.judged[a], found.judged[b], found.rows.window) for a, b in both]
    gain = [_on_siblings(found, a) - _on_siblings(found, b) for a, b in both]
    same, other = (found.f1(a) - found.f1(b) for a, b in both)
    cells = [f"{found.mean(a):.1f} against {found.mean(b):.1f}" for a, b in both]
    why = (
        "holds where the interval by people of the difference, in windows judged rightly on the same"
        f" devices, mean of recognisers, lies above zero: {with_interval(gain[0])};"
        f" {OTHER}:"
        f" {with_interval(gain[1])} points. By McNemar's test with Yates' correction {by_recogniser(p[0])};"
        f" {OTHER}: {by_recogniser(p[1])}. {INDEPENDENT}, nor is one window through several devices"
    )
    above = [interval(own)[0] > 0.0 for own in gain]
    f, k = np.unravel_index(same.argmax(), same.shape)
    g, m = np.unravel_index(other.argmax(), other.shape)
    families, learners = list(FAMILIES), list(LEARNERS)
    most = (
        f"{same.max():+.0f} ({families[f]}, {learners[k]}); {OTHER} {other.max():+.0f}"
        f" ({families[g]}, {learners[m]})"
    )
    few = (found.causes.nine[INTRA] - found.causes.nine["one model"]).max(axis=(1, 2))
    return [
        claim(
            AVERAGES["higher"],
            both_ways(cells, above, " %"),
            holds(above[0]),
            why,
        ),
        claim(
            AVERAGES["most"],
            most,
            holds(bool(same.max() >= 30.0 - NEAR)),
            "holds where the largest gain is 25 points or more, tested as the paper does",
            Cause(
                f"{AS_FEW}, {', '.join(f'{own:+.0f}' for own in few)} points by draw of people",
                shown=often(few >= 30.0 - NEAR),
            ),
        ),
    ]


def _siblings(found: Found) -> Labels:
    """Return the devices that have another one of their model."""
    return np.unique(found.rows.device[found.judged[INTRA].row])


def _on_siblings(found: Found, way: str) -> Array:
    """Return the share judged rightly on those devices by person, mean of recognisers, percent."""
    judged, rows = found.judged[way], found.rows
    own = np.isin(rows.device[judged.row], _siblings(found))
    return 100.0 * by_person(judged.right.mean(axis=(0, 1))[own], rows.person[judged.row[own]])


def _order(found: Found) -> Claim:
    row = [found.mean(mode) for mode in ("ten-fold", "user out", ONE)]
    loss = by_fold(found.judged["user out"]) - by_fold(found.judged[ONE])
    return claim(
        AVERAGES["order"],
        ", ".join(f"{v:.1f}" for v in row) + " %",
        holds(row[0] > row[1] and interval(loss)[0] > 0.0),
        "means of families and learners; holds where ten-fold is above a user out, and the interval of what"
        f" one model loses, by folds of people, above zero: {with_interval(loss)} points",
    )


def _best(found: Found) -> Claim:
    ten, rest = found.f1("ten-fold"), [mode for mode in FIGURE_5 if mode != "ten-fold"]
    same = int(np.sum(ten > np.max([found.f1(mode) for mode in rest], axis=0)))
    apart = [ways(mode)[-1] for mode in rest]
    other = int(np.sum(ten > np.max([found.f1(way) for way in apart], axis=0)))
    behind = [
        f"{family}, {learner} by {mode} ({found.f1(mode)[f, k]:.1f} against {ten[f, k]:.1f} %)"
        for f, family in enumerate(FAMILIES)
        for k, learner in enumerate(LEARNERS)
        for mode in rest
        if found.f1(mode)[f, k] >= ten[f, k]
    ]
    listed = f". Not so: {'; '.join(behind)}" if behind else ""
    return claim(
        AVERAGES["best"],
        f"{same} of {ten.size}; {OTHER} {other} of {ten.size}",
        holds(same == ten.size),
        f"against all modes of Figure 5, tested as the paper does{listed}",
        Cause(
            "the modes that keep people are trained on the tested motion as other devices recorded it, here"
            f" to the sample. Where they are tested on other motion, ten-fold is best in {other} of"
            f" {ten.size}",
            shown=other == ten.size,
        ),
    )


def _model(found: Found) -> Claim:
    """Compare a model out with a user out: the same windows on the same devices, each judged once."""
    user, asked = found.judged["user out"], ways("model out")
    person = found.rows.person
    base = _by_person(user, person)
    gain = [_by_person(found.judged[way], person) - base for way in asked]
    above = [interval(g)[0] > 0.0 for g in gain]
    same, other = (found.mean(way) for way in asked)
    return claim(
        AVERAGES["model"],
        both_ways(
            [f"model out {same:.1f}, user out {found.mean('user out'):.1f}", f"{other:.1f}"], above, " %"
        ),
        holds(above[0]),
        "holds where the interval by people of the difference, in windows judged rightly, lies above zero:"
        f" {with_interval(gain[0])} points. With a model out people are in both parts, and the tested"
        f" windows in training as other devices recorded them. On {OTHER} the same recognisers lose"
        f" {same - other:.1f} points: {with_interval(gain[1])} against a user out",
        brief=f"{same:.1f} against {found.mean('user out'):.1f} %; {OTHER} {other:.1f}",
    )


def _by_person(judged: Judged, person: Labels) -> Array:
    """Return the share judged rightly by person, mean of recognisers, percent."""
    return 100.0 * by_person(judged.right.mean(axis=(0, 1)), person[judged.row])


def _fold_by_fold(found: Found, one: str, other: str) -> tuple[str, Array]:
    """Return two modes' F1 in words, and what the first gains over the other by fold of people (folds,)."""
    first, second = (by_fold(found.judged[mode]) for mode in (one, other))
    return f"{first.mean():.1f} against {second.mean():.1f} %", first - second


def _cluster(found: Found) -> Claim:
    """Compare training within a cluster with training on all, fold by fold of people."""
    figures, gain = _fold_by_fold(found, "cluster, user out", "user out")
    return claim(
        AVERAGES["cluster"],
        figures,
        holds(interval(gain)[0] > 0.0),
        "holds where the interval of the difference by folds of people lies above zero:"
        f" {with_interval(gain)} points; a fifth of the people left out",
        Cause(
            "a cluster's devices are fewer, and so are the rows to train on. On as many rows"
            f" ({FEW}) training within the cluster gains {with_interval(found.causes.capped)} points",
            shown=interval(found.causes.capped)[0] > 0.0,
        ),
    )


def _one_model(found: Found) -> Claim:
    """Compare training within a cluster with training on one other model, fold by fold of people."""
    figures, gain = _fold_by_fold(found, "cluster, user out", ONE)
    return claim(
        AVERAGES["one model"],
        figures,
        holds(interval(gain)[0] > 0.0),
        "holds where the interval of the difference by folds of people lies above zero:"
        f" {with_interval(gain)} points; a fifth of the people left out. The one model is never the"
        " tested device's own; the cluster may hold others of it",
    )


def _device(found: Found) -> Claim:
    """Compare cluster and model on the devices that have another one in both, fold by fold of people."""
    figures, gain = _fold_by_fold(found, CLUSTER_DEVICE, MODEL_DEVICE)
    number = len(np.unique(found.rows.device[found.judged[CLUSTER_DEVICE].row]))
    few = (found.causes.nine[CLUSTER_DEVICE] - found.causes.nine[MODEL_DEVICE]).mean(axis=(1, 2))
    return claim(
        AVERAGES["device"],
        f"{figures} on {number} devices",
        holds(interval(gain)[0] > 0.0),
        "on the devices that have another one both in their cluster and of their model; holds where the"
        f" interval of the difference by folds of people lies above zero: {with_interval(gain)} points",
        Cause(
            f"{AS_FEW}, {', '.join(f'{own:+.1f}' for own in few)} points by draw of people: above zero"
            f" {in_draws(few > 0.0)}. On devices of about one rate instead of one model it is"
            f" {with_interval(found.causes.rated)}",
            shown=often(few > 0.0),
        ),
    )


def _excluded(found: Found) -> list[Claim]:
    """Compare training without the tested device's cluster with training on all, on the same windows."""
    right = [100.0 * found.judged[mode].right.mean(axis=2) for mode in (OTHERS, "user out")]
    change = right[0] - right[1]
    families = dict(zip(FAMILIES, change.mean(axis=1), strict=True))
    learners = dict(zip(LEARNERS, change.mean(axis=0), strict=True))
    tree = dict(zip(FAMILIES, change[:, list(LEARNERS).index("tree")], strict=True))
    frequency = dict(zip(LEARNERS, change[list(FAMILIES).index("frequency")], strict=True))
    share = among_nine(found, (OTHERS, "user out"), _tree_most)
    why = (
        "change in windows judged rightly against training on all, a fifth of the people left out both times"
    )
    return [
        claim(
            AVERAGES["excluded"],
            _listed(families),
            holds(min(families, key=lambda name: families[name]) == "frequency"),
            f"{why}; mean of learners",
        ),
        claim(
            AVERAGES["excluded tree"],
            _listed(learners),
            holds(min(learners, key=lambda name: learners[name]) == "tree"),
            f"{why}; mean of families. The tree by family: {_listed(tree)}",
            Cause(
                f"{among_words(share)} it is the tree. On frequency features, which lose nearly all of it,"
                f" learners change by {_listed(frequency)}",
                shown=share > CHANCE,
            ),
        ),
    ]


def _tree_most(right: dict[str, Array]) -> bool:
    change = (right[OTHERS] - right["user out"]).mean(axis=0)
    return bool(change.argmin() == list(LEARNERS).index("tree"))


def among_words(share: float) -> str:
    """Say in what share of `among_nine` something holds."""
    return f"in {share:.0%} of draws of nine of the people tested"


def _listed(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:+.1f}" for name, value in values.items()) + " points"
