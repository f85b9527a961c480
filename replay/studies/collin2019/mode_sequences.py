"""Motion modes in their sequence, and windows that are better not judged.

Collin et al. 2019, 4.1 (a Markov model for state transitions) and 4.3 (partial classification). Judged by
Bayes' rule with people left out, as in `motion-modes`, on a question that is hard enough to err: the six
activities of UCI HAR.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies import drawing
from stillcal.replay.studies.claim import Cause, Claim, Evidence, Progress, Study, holds, picture, table
from stillcal.replay.studies.collin2019.motion_features import Motion
from stillcal.replay.studies.har.data import ACTIVITIES, DATA, RATE_HZ, read_rates, without_recordings
from stillcal.replay.studies.har.scoring import interval
from stillcal.replay.studies.methods.motion_modes import NAMES, TWO, Bayes, features

NAME, TITLE, WORK = "mode-sequences", "Motion modes in sequence, and windows not judged", "Collin 2019"
CONFIDENCE = (0.0, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""Least posterior with which a window is judged."""
CHOSEN = 0.95
BELOW = "almost always below 10 %"
AT_REST = ("sit", "stand", "lie")
PAPER = (
    (WORK, "4.1", "a Markov model of the modes' sequence adds inference", "can be added"),
    (WORK, "4.3", "six activities, our features, real people: misclassified almost always below 10 %", BELOW),
    (WORK, "4.3", "not judging a situation at all is one way to tolerate errors", "one approach"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Shares of windows judged wrongly, by person (people,): each alone, in sequence, and alone where sure.

    refused: share that is not judged, not being sure. resting: of those judged wrongly alone, what share
    confuses two activities at rest.
    """

    alone: Array
    together: Array
    sure: Array
    refused: float
    resting: float


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Windows of people, in order.

    posterior: (n, r) by each window alone; filtered: (n, r) by the windows before it, too. labels: (r,) modes
    of the columns.
    """

    motion: Motion
    labels: NDArray[np.intp]
    posterior: Array
    filtered: Array

    def errors(self, posterior: Array, least: float = 0.0) -> Array:
        """Return the share of wrong among the windows judged, by person; NaN for who has none."""
        wrong = self.labels[posterior.argmax(axis=1)] != self.motion.mode
        judged = posterior.max(axis=1) >= least
        people = np.unique(self.motion.person)
        own = [wrong[judged & (self.motion.person == p)] for p in people]
        return np.array([w.mean() if w.size else np.nan for w in own])

    def refused(self, least: float) -> float:
        """Return the share of windows that are not judged."""
        return float(np.mean(self.posterior.max(axis=1) < least))


def errors(found: Judged) -> Errors:
    """Return what the claims are judged on."""
    return Errors(
        alone=found.errors(found.posterior),
        together=found.errors(found.filtered),
        sure=found.errors(found.posterior, CHOSEN),
        refused=found.refused(CHOSEN),
        resting=among_resting(found),
    )


def transitions(label: NDArray[np.intp], person: NDArray[np.intp], classes: int) -> Array:
    """Return P(C_t = k | C_t-1 = h), (h, k), from windows in order; each pair counts once more than seen."""
    counts = np.ones((classes, classes))
    follows = person[1:] == person[:-1]
    np.add.at(counts, (label[:-1][follows], label[1:][follows]), 1.0)
    return np.asarray(counts / counts.sum(axis=1, keepdims=True))


def forward(likelihood: Array, prior: Array, chain: Array) -> Array:
    """Return P(C_t | z_1 ... z_t), (n, r): Eq. 24 with the state before instead of the prior."""
    out, before = np.empty_like(likelihood), prior
    for row, own in enumerate(likelihood):
        weight = own * before
        out[row] = weight / weight.sum()
        before = out[row] @ chain
    return out


def activities(data: Path) -> Motion:
    """Return UCI HAR's windows in each person's order, their modes being the six activities."""
    windows, rates = read_rates(data)
    norms = np.linalg.norm(windows.accel, axis=2)
    return Motion(features(norms, rates, RATE_HZ), windows.label, windows.person, norms.std(axis=1))


def with_attitude(motion: Motion, data: Path) -> Motion:
    """Return the motion with each window's mean force, m/s^2, as three more features."""
    forces = read_rates(data)[0].accel.mean(axis=1)
    return replace(motion, features=np.column_stack((motion.features, forces)))


def judge(motion: Motion, columns: tuple[int, ...]) -> Judged:
    """Judge everybody's windows by what the others' say."""
    labels, label = np.unique(motion.mode, return_inverse=True)
    z = motion.features[:, columns]
    posterior = np.empty((len(z), labels.size))
    filtered = np.empty_like(posterior)
    for person in np.unique(motion.person):
        test = motion.person == person
        model = Bayes.learnt(z[~test], label[~test], labels.size)
        posterior[test] = model.posterior(z[test])
        chain = transitions(label[~test], motion.person[~test], labels.size)
        filtered[test] = forward(posterior[test] / model.prior, model.prior, chain)
    return Judged(motion, labels, posterior, filtered)


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Judge simulated people in sequence, and simulated and real ones with the option not to judge."""
    if data is None:
        return without_recordings(NAME, TITLE, PAPER, seed)
    people = activities(data)
    progress(0.6)
    every = tuple(range(len(NAMES)))
    groups = {name: judge(people, columns) for name, columns in (("two", TWO), ("all", every))}
    tilted = judge(with_attitude(people, data), (*every, *range(len(NAMES), len(NAMES) + 3)))
    found = errors(groups["all"])
    claims = (_sequence(found), _six(found, errors(tilted)), _partial(found))
    file = _draw(groups, figures)
    progress(1.0)
    return Study(NAME, TITLE, claims, _text(groups, file), (file,), seed)


def _sequence(found: Errors) -> Claim:
    alone, together = 100.0 * found.alone, 100.0 * found.together
    low, high = interval(together - alone)
    return Claim(
        *PAPER[0],
        f"Bayes, all features: {alone.mean():.1f} → {together.mean():.1f} % wrong",
        DATA,
        holds(high < 0.0),
        f"holds where the interval by people of the change lies below zero: {low:+.1f} to {high:+.1f} points."
        " Transitions learnt from the other people, who all went through the same protocol: in free life less"
        " is to be expected",
        evidence=Evidence.REAL,
    )


def _six(found: Errors, tilted: Errors) -> Claim:
    """Judge the error on six activities. tilted: with each window's mean force among the features."""
    alone, together, once, known = (
        100.0 * own.mean() for own in (found.alone, found.together, tilted.alone, tilted.together)
    )
    return Claim(
        *PAPER[1],
        f"{alone:.1f} %, in sequence {together:.1f}; with mean forces {once:.1f}, {known:.1f} %",
        DATA,
        holds(bool(min(alone, together) < 10.0)),
        "Bayes, all features of 4.2 that are here, mean over people left out one by one; the number of"
        " classes varies, says the paper. That it differs is of these features, which do not tell attitude:"
        " the paper does not list its own. With mean forces: each window's mean force among the features",
        evidence=Evidence.REAL,
        brief=f"{alone:.1f} %; with mean forces {once:.1f} %",
        cause=Cause(
            f"{100 * found.resting:.0f} % of the windows judged wrongly are of sitting, standing or"
            " lying taken for one another, as the features do not tell how the phone is tilted. With each"
            f" window's mean force among them {once:.1f} %, in sequence {known:.1f} %",
            shown=bool(known < 10.0),
        ),
    )


def among_resting(found: Judged) -> float:
    """Return the share of the windows judged wrongly, each alone, that confuse two activities at rest."""
    judged = found.labels[found.posterior.argmax(axis=1)]
    wrong = judged != found.motion.mode
    resting = [ACTIVITIES.index(name) for name in AT_REST]
    return float(np.mean(np.isin(judged[wrong], resting) & np.isin(found.motion.mode[wrong], resting)))


def _partial(found: Errors) -> Claim:
    alone, sure = 100.0 * found.alone, 100.0 * found.sure
    low, high = interval(sure - alone)
    return Claim(
        *PAPER[2],
        f"{alone.mean():.1f} → {sure.mean():.1f} % wrong, {100 * found.refused:.0f} % not judged",
        DATA,
        holds(high < 0.0),
        f"judged where the posterior is {CHOSEN:g} or more; holds where the interval by people of the change"
        f" lies below zero: {low:+.1f} to {high:+.1f} points",
        evidence=Evidence.REAL,
    )


def _text(groups: dict[str, Judged], file: str) -> str:
    rows = [
        (
            name,
            f"{least:g}",
            f"{100 * np.nanmean(found.errors(found.posterior, least)):.1f}",
            f"{100 * found.refused(least):.1f}",
        )
        for name, found in groups.items()
        for least in CONFIDENCE
    ]
    sequence = [
        (name, *(f"{100 * found.errors(p).mean():.1f}" for p in (found.posterior, found.filtered)))
        for name, found in groups.items()
    ]
    return "\n\n".join(
        [
            f"Six activities ({', '.join(ACTIVITIES)}), Bayes' rule with normal classes (Eq. 23-25), a person"
            " left out; means over people. The features are those of `motion-modes`: of the norm and of the"
            " rates, so nothing tells how the phone is tilted, and sitting, standing and lying are hard to"
            " tell apart. In sequence, the prior of a window is what the windows before it say, carried on by"
            " the transitions. The recordings keep about a third of each person's windows, in order.",
            table(("features", "alone: wrong, %", "in sequence: wrong, %"), sequence),
            table(("features", "least posterior", "wrong of those judged, %", "not judged, %"), rows),
            picture(file, "Windows judged wrongly against windows not judged"),
        ]
    )


def _draw(groups: dict[str, Judged], figures: Path) -> str:
    figure, (axis,) = drawing.panels(1)
    for colour, (name, found) in zip(drawing.COLOURS, groups.items(), strict=False):
        refused = [100.0 * found.refused(least) for least in CONFIDENCE]
        errors = [100.0 * np.nanmean(found.errors(found.posterior, least)) for least in CONFIDENCE]
        axis.plot(refused, errors, "o-", color=colour, label=f"{name} features")
    axis.set(xlabel="not judged, %", ylabel="wrong of those judged, %", ylim=(0.0, None))
    axis.legend()
    return drawing.save(figure, figures, NAME)
