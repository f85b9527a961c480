"""Telling walking, driving and lying still apart, by Bayes' rule and by boosted trees.

Collin et al. 2019, 4 (Fig. 9 and 10, Eq. 23-25). People are left out one by one: nobody is judged by what was
learnt from his own windows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.studies import drawing
from stillcal.replay.studies.claim import (
    Cause,
    Claim,
    Evidence,
    Progress,
    Study,
    Verdict,
    holds,
    picture,
    table,
)
from stillcal.replay.studies.collin2019.motion_features import MODES, Motion, simulated, ucihar
from stillcal.replay.studies.har.recordings import read_still
from stillcal.replay.studies.methods.motion_modes import NAMES, TWO, Bayes

WORK = "Collin 2019"
PEOPLE = 12
FIG9_G = (0.24, 0.071, 0.0084)
"""Standard deviation of the norm in Fig. 9, g: walking, driving, stationary."""
Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]


def judge_by_bayes(motion: Motion, columns: tuple[int, ...]) -> Rows:
    """Return the mode found for each window by Eq. 24, its person left out of the learning."""
    z = motion.features[:, columns]

    def judge(learn: Mask, test: Mask) -> Rows:
        modes, label = np.unique(motion.mode[learn], return_inverse=True)
        learnt = Bayes.learnt(z[learn], label, len(modes))
        return np.asarray(modes[learnt.posterior(z[test]).argmax(axis=1)])

    return _left_out(motion, judge)


def judge_by_trees(motion: Motion, columns: tuple[int, ...], seed: int) -> Rows:
    """Return the mode found for each window by gradient-boosted trees, its person left out."""
    from sklearn.ensemble import HistGradientBoostingClassifier  # noqa: PLC0415 - an extra

    z = motion.features[:, columns]

    def judge(learn: Mask, test: Mask) -> Rows:
        trees = HistGradientBoostingClassifier(max_iter=60, random_state=seed)
        return np.asarray(trees.fit(z[learn], motion.mode[learn]).predict(z[test]))

    return _left_out(motion, judge)


def error_by_person(motion: Motion, found: Rows) -> Array:
    """Return the share of windows judged wrongly, by person."""
    wrong = found != motion.mode
    return np.array([wrong[motion.person == p].mean() for p in np.unique(motion.person)])


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Judge simulated people, and those of UCI HAR where they are given."""
    people = simulated(PEOPLE, seed)
    progress(0.5)
    every = tuple(range(len(NAMES)))
    ways = {
        ("Bayes", "two"): judge_by_bayes(people, TWO),
        ("Bayes", "all"): judge_by_bayes(people, every),
        ("boosted trees", "two"): judge_by_trees(people, TWO, seed),
        ("boosted trees", "all"): judge_by_trees(people, every, seed),
    }
    progress(0.8)
    name = f"{len(people.mode)} windows of 5 s, {PEOPLE} simulated people"
    real = spreads(data) if data is not None else None
    claims = [
        *_fig9_claims(real),
        _error_claim("three modes, simulated people", _errors(people, ways), name),
    ]
    rows: list[tuple[str, ...]] = [(*way, "simulated", _share(people, found)) for way, found in ways.items()]
    claims, rows = _real(data, seed, claims, rows)
    text = _TEXT.format(
        errors=table(("classifier", "features", "people", "windows judged wrongly"), rows),
        confusion=_confusion(people, ways["Bayes", "all"]),
        names=",\n".join(", ".join(NAMES[k : k + 5]) for k in range(0, len(NAMES), 5)),
        picture=picture(
            _draw(people, figures), "As Fig. 10: standard deviation and peak frequency of the norm"
        ),
    )
    progress(1.0)
    return Study("motion-modes", "Motion modes", tuple(claims), text, ("motion-modes.png",), seed)


_TEXT = """Two features: standard deviation and peak frequency of the norm (Fig. 10). All:
{names}.
Intervals are 95 % by person. Three modes that differ this much are told apart by almost anything, on real
people (two of the three) as on simulated ones: it says little about harder questions.

{errors}

Bayes with all features, shares of each row:

{confusion}

{picture}"""


def _left_out(motion: Motion, judge: Callable[[Mask, Mask], Rows]) -> Rows:
    found = np.empty(len(motion.mode), dtype=np.intp)
    for person in np.unique(motion.person):
        test = motion.person == person
        found[test] = judge(~test, test)
    return found


def _real(
    data: Path | None, seed: int, claims: list[Claim], rows: list[tuple[str, ...]]
) -> tuple[list[Claim], list[tuple[str, ...]]]:
    """Add what UCI HAR says: walking against stationary, there being no driving in it."""
    name = "ucihar: 30 people, windows of 2.56 s"
    if data is None:
        claim = Claim(
            WORK,
            "4.3",
            _BELOW.format("two modes, real people"),
            "almost always below 10 %",
            "-",
            name,
            Verdict.UNTESTED,
            "the real recordings are not here (--data)",
            evidence=Evidence.NONE,
        )
        return [*claims, claim], rows
    real = ucihar(data)
    every = tuple(range(len(NAMES)))
    ways = {
        ("Bayes", "two"): judge_by_bayes(real, TWO),
        ("Bayes", "all"): judge_by_bayes(real, every),
        ("boosted trees", "all"): judge_by_trees(real, every, seed),
    }
    claim = _error_claim("two modes, real people", _errors(real, ways), name + ", walking against stationary")
    return [*claims, claim], [*rows, *((*way, "UCI HAR", _share(real, found)) for way, found in ways.items())]


@dataclass(frozen=True, slots=True, eq=False)
class Spreads:
    """Standard deviations of the norm, g. walking: by window; resting: by recording; noises: by device."""

    walking: Array
    resting: Array
    noises: Array


def spreads(data: Path) -> Spreads:
    """Return the spreads of real recordings for Fig. 9."""
    real = ucihar(data)
    rests = [r for r in read_still(data) if not r.frozen]
    noises = {r.name: r.norms.std() for r in rests}
    return Spreads(
        real.sd[real.mode == MODES.index("walking")] / STANDARD,
        np.array([r.norms.std() for r in rests]) / STANDARD,
        np.array(list(noises.values())) / STANDARD,
    )


def _fig9_claims(real: Spreads | None) -> list[Claim]:
    """Compare Fig. 9 with real recordings; the simulator's own walk and drive are parameters, no evidence."""
    claim, why = "standard deviation of the norm, {}", "within a factor of two: theirs is one recording"
    missing = {"driving": "nobody drives in the recordings; the simulated drive's is a parameter of ours"}
    found: dict[str, tuple[float, str]] = {}
    spread = None
    if real is None:
        missing |= dict.fromkeys(("walking", "stationary"), "the real recordings are not here (--data)")
    else:
        near = int(np.sum((real.noises >= 0.5 * FIG9_G[2]) & (real.noises <= 2.0 * FIG9_G[2])))
        spread = Cause(
            f"at rest it is the sensor's own noise, which on {real.noises.size} devices goes from"
            f" {real.noises.min():.2g} to {real.noises.max():.2g} g; {near} of them are within a factor"
            " of two of the paper's",
            shown=near > 0,
        )
        walking, lying = (float(np.median(own)) for own in (real.walking, real.resting))
        found["walking"] = walking, "ucihar: walking and stairs, 30 people, windows of 2.56 s"
        found["stationary"] = lying, "hhar_still: phones and watches that lie still"
    claims = []
    for name, paper in zip(MODES, FIG9_G, strict=True):
        if name in missing:
            claims.append(
                Claim(
                    WORK,
                    "Fig. 9",
                    claim.format(name),
                    f"{paper:g} g",
                    "",
                    "none",
                    Verdict.UNTESTED,
                    missing[name],
                    evidence=Evidence.NONE,
                )
            )
            continue
        ours, source = found[name]
        good = 0.5 <= ours / paper <= 2.0
        claims.append(
            Claim(
                WORK,
                "Fig. 9",
                claim.format(name),
                f"{paper:g} g",
                f"{ours:.2g} g (median)",
                source,
                holds(good),
                why,
                evidence=Evidence.REAL,
                cause=spread if name == "stationary" else None,
            )
        )
    return claims


_BELOW = "{}: misclassified almost always below 10 %"


def _errors(motion: Motion, ways: dict[tuple[str, str], Rows]) -> list[Array]:
    """Return the share of windows misclassified by person, (people,), of each classifier."""
    return [error_by_person(motion, found) for found in ways.values()]


def _error_claim(who: str, errors: list[Array], data: str) -> Claim:
    """Judge all classifiers of one set of people as one claim: the paper speaks of the rates reported.

    errors: the share misclassified by person, (people,), of each classifier.
    """
    means = [100.0 * own.mean() for own in errors]
    above = max(int(np.count_nonzero(own >= 0.1)) for own in errors)
    people = len(errors[0])
    return Claim(
        WORK,
        "4.3",
        _BELOW.format(who),
        "almost always below 10 %",
        f"{min(means):.1f} to {max(means):.1f} % by classifier; above 10 % for at most {above} of {people}"
        " people",
        data,
        holds(max(means) < 10.0),
        "means over people left out one by one. An easy question: see `mode-sequences` for six activities",
        evidence=Evidence.SIMULATION if "simulated" in who else Evidence.REAL,
    )


def _share(motion: Motion, found: Rows) -> str:
    errors = error_by_person(motion, found)
    half = 1.96 * errors.std(ddof=1) / np.sqrt(errors.size)
    return f"{100 * errors.mean():.2f} +- {100 * half:.2f} %"


def _confusion(motion: Motion, found: Rows) -> str:
    rows = []
    for m, name in enumerate(MODES):
        own = found[motion.mode == m]
        rows.append((name, *(f"{100 * np.mean(own == k):.1f} %" for k in range(len(MODES)))))
    return table(("true, found", *MODES), rows)


def _draw(people: Motion, figures: Path) -> str:
    figure, (left, right) = drawing.panels(2)
    for m, name in enumerate(MODES):
        rows = people.mode == m
        left.semilogx(
            10.0 ** people.features[rows, 0] / STANDARD,
            people.features[rows, 1],
            ".",
            markersize=3,
            label=name,
        )
        coning = np.degrees(10.0 ** people.features[rows, -1])
        right.hist(np.log10(coning), bins=40, alpha=0.6, color=drawing.COLOURS[m], label=name)
    left.set(xlabel="standard deviation, g", ylabel="peak frequency, Hz")
    left.legend()
    right.set(xlabel="coning error within 1 s, deg", ylabel="windows")
    right.set_xticks(range(-6, 3), [f"$10^{{{power}}}$" for power in range(-6, 3)])
    right.legend()
    return drawing.save(figure, figures, "motion-modes")
