"""The scores of all modes of evaluation, and of each supposed cause of a difference, tried by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.claim import Progress
from stillcal.replay.studies.har.features import FAMILIES, without_counts
from stillcal.replay.studies.har.scoring import LEARNERS, Labels, principal, signed_mcnemar
from stillcal.replay.studies.stisen2015.modes.rows import (
    FOLDS,
    NINE,
    PEOPLE_KEPT,
    Judged,
    Rows,
    judge,
    other_windows,
    splits,
    together,
)
from stillcal.replay.studies.stisen2015.recorded import by_rate

INTRA, ONE = "intra-model, device out", "one model, user out"
CLUSTER_DEVICE, MODEL_DEVICE = "cluster, user and device out", "model, user and device out"
FIGURE_5 = (
    "ten-fold",
    "user out",
    "model out",
    "one model",
    INTRA,
    "user and model out",
    ONE,
)
FIGURE_12 = (
    "cluster, user out",
    "other clusters, user out",
    CLUSTER_DEVICE,
    MODEL_DEVICE,
)
MODES = (*FIGURE_5, *FIGURE_12)

PRINCIPAL = {name: principal(learner) for name, learner in LEARNERS.items()}
"""The learners on the principal components that keep 95 % of the features' variance (Figure 10)."""

TURNED = {
    "every": principal(LEARNERS["tree"], None),
    "unscaled": principal(LEARNERS["tree"], scaled=False),
}
"""The tree on all components, axes turned and nothing dropped; and on those of features as they are."""

AMONG = 1000
"""Draws of nine of the people that were tested."""

DRAWS, OFTEN = 5, 2
"""How often nine people are drawn, and recognisers trained on them; in how many draws a statement must hold
to be one that nine people may make. One that they make once in twenty draws does so in 2 % of runs."""

NINE_MODES = ("user out", "one model", INTRA, ONE, CLUSTER_DEVICE, MODEL_DEVICE)
"""Modes that are scored again with nine people."""

TREES = {name: LEARNERS[name] for name in ("tree", "forest")}
FEW = 250
"""Rows: fewer than one device has with a fifth of the windows or of the people left out."""


@dataclass(frozen=True, slots=True, eq=False)
class Causes:
    """What was tried, F1 in percent.

    nine: by mode of NINE_MODES, of nine people alone, as `of_nine` draws them, (DRAWS, 3, 4). axes: by mode,
    frequency features of each axis and the norm, by learner, (4,).
    uncounted: by way, TREES on time features `without_counts`, (2,). few: the same on FEW rows and all time
    features.
    lean: a user out, time and ECDF features together, by learner, (4,). capped: points by training within
    the cluster instead of on all, by fold of people, both on FEW rows. rated: points by training on the
    devices of one rate, about, instead of one model, a user and a device out, by fold of people. turned:
    the tree on every principal component of ECDF features, one model, a user out; unscaled: the tree on those
    that keep 95 % of the variance of the features as they are.
    """

    nine: dict[str, Array]
    axes: dict[str, Array]
    uncounted: dict[str, Array]
    few: dict[str, Array]
    lean: Array
    capped: Array
    rated: Array
    turned: float
    unscaled: float


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """rows: without their features.

    judged: by way, the modes of MODES and `other_windows` of those that keep people.
    together: F1 of all three families side by side by way of FIGURE_5 and learner, percent, (4,). reduced: F1
    by family and learner on principal components, one model, a user out, percent, (3, 4).
    """

    rows: Rows
    judged: dict[str, Judged]
    together: dict[str, Array]
    reduced: Array
    causes: Causes

    def f1(self, way: str) -> Array:
        """Return F1 by family and learner, percent, (3, 4)."""
        return self.judged[way].mean

    def mean(self, way: str) -> float:
        """Return F1, percent, mean of families and learners."""
        return float(self.f1(way).mean())

    def by_person(self, way: str) -> Array:
        """Return the share judged rightly by family, learner and person, percent, (3, 4, people)."""
        return self.judged[way].by(self.rows.person)

    def by_learner(self, way: str, family: str) -> Array:
        """Return F1 of one family of features, percent, (4,)."""
        return np.asarray(self.f1(way)[list(FAMILIES).index(family)])


def ways(*modes: str) -> tuple[str, ...]:
    """Return the modes, each followed by its way of other windows where it has one."""
    return tuple(
        way for mode in modes for way in ((mode, other_windows(mode)) if mode in PEOPLE_KEPT else (mode,))
    )


def among_nine(found: Found, ways: tuple[str, ...], rule: Callable[[dict[str, Array]], bool]) -> float:
    """Return in what share of draws of nine of the people tested a rule holds.

    rule: is given the share judged rightly by way, (3, 4). The recognisers are those trained on everybody.
    """
    own = {way: found.by_person(way) for way in ways}
    rng, people = np.random.default_rng(0), next(iter(own.values())).shape[2]
    draws = [rng.permutation(people)[:NINE] for _ in range(AMONG)]
    return float(np.mean([rule({way: v[:, :, few].mean(axis=2) for way, v in own.items()}) for few in draws]))


@dataclass(frozen=True, slots=True, eq=False)
class Altered:
    """What causes are tried on. nine: draws `of_nine`. axes: rows with frequency features by axis.

    rates: Hz, by device.
    """

    nine: list[Rows]
    axes: Rows
    rates: list[float]


def measure(rows: Rows, altered: Altered, seed: int, progress: Progress) -> Found:
    """Score every mode, the families together, principal components, and the causes."""
    judged: dict[str, Judged] = {}
    side_by_side: dict[str, Array] = {}
    whole = together(rows, tuple(FAMILIES))
    for k, mode in enumerate(MODES):
        parts = list(splits(rows, mode, seed))
        judged |= judge(rows, parts, seed)
        if mode in FIGURE_5:
            side_by_side |= {way: found.mean[0] for way, found in judge(whole, parts, seed).items()}
        progress((k + 1) / (len(MODES) + 2))
    reduced = judge(rows, list(splits(rows, ONE, seed)), seed, PRINCIPAL)[ONE].mean
    causes = tried(rows, altered, seed)
    return Found(replace(rows, features={}), judged, side_by_side, reduced, causes)


def tried(rows: Rows, altered: Altered, seed: int) -> Causes:
    """Try every cause."""

    def scored(own: Rows, mode: str, most: int | None = None) -> Judged:
        return judge(own, list(splits(own, mode, seed)), seed, most=most)[mode]

    time = replace(rows, features={"time": rows.features["time"]})
    plain = replace(rows, features={"time": without_counts(rows.features["time"])})
    out, intra = (list(splits(rows, mode, seed)) for mode in ("model out", INTRA))
    uncounted = judge(plain, out, seed, TREES) | judge(plain, intra, seed, TREES)
    short = judge(time, out, seed, TREES, most=FEW) | judge(time, intra, seed, TREES, most=FEW)
    ecdf = replace(rows, features={"ECDF": rows.features["ECDF"]})
    alike = replace(rows, cluster=by_rate(rows.device, altered.rates))
    unreduced = judge(ecdf, list(splits(ecdf, ONE, seed)), seed, TURNED)[ONE].mean[0]
    return Causes(
        nine={mode: np.array([scored(own, mode).mean for own in altered.nine]) for mode in NINE_MODES},
        axes={mode: scored(altered.axes, mode).mean[0] for mode in ("ten-fold", "user out")},
        uncounted={way: found.mean[0] for way, found in uncounted.items()},
        few={way: found.mean[0] for way, found in short.items()},
        lean=scored(together(rows, ("time", "ECDF")), "user out").mean[0],
        capped=by_fold(scored(rows, "cluster, user out", FEW)) - by_fold(scored(rows, "user out", FEW)),
        rated=by_fold(scored(alike, CLUSTER_DEVICE)) - by_fold(scored(alike, MODEL_DEVICE)),
        turned=float(unreduced[0]),
        unscaled=float(unreduced[1]),
    )


def by_fold(found: Judged) -> Array:
    """Return F1 by fold of people, percent, (folds,); the parts of a fold lie side by side."""
    return np.asarray(100.0 * found.f1.reshape(*found.f1.shape[:2], FOLDS, -1).mean(axis=(0, 1, 3)))


def paired(one: Judged, other: Judged, window: Labels) -> Array:
    """Return McNemar's p-value by recogniser, (families, learners); negative where `one` has fewer right.

    one: has tested each of its rows once. other: may have tested them several times, by as many recognisers;
    the windows take them in turn.
    """
    order = np.lexsort((other.part, other.row))
    first = np.searchsorted(other.row[order], one.row)
    times = np.searchsorted(other.row[order], one.row, side="right") - first
    return signed_mcnemar(one.right, other.right[..., order[first + window[one.row] % times]])
