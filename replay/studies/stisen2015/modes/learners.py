"""What the paper says of families of features and of learners within the modes of evaluation (4.2)."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.claim import Cause, Claim, holds
from stillcal.replay.studies.har.features import FAMILIES
from stillcal.replay.studies.har.scoring import LEARNERS, interval
from stillcal.replay.studies.stisen2015.both_ways import OTHER, both_ways
from stillcal.replay.studies.stisen2015.modes.claims import (
    AS_FEW,
    CHANCE,
    NEAR,
    among_words,
    claim,
    in_draws,
    often,
)
from stillcal.replay.studies.stisen2015.modes.rows import other_windows
from stillcal.replay.studies.stisen2015.modes.scores import (
    FEW,
    FIGURE_5,
    INTRA,
    ONE,
    TREES,
    Found,
    among_nine,
    ways,
)

NEXT = ("one model", INTRA)
"""The modes that keep people and train on the fewest devices: the lowest of them."""

COMPARED = {
    "similar": (
        "4.2, Figure 5",
        "the three families score similarly in ten-fold and with a user out",
        "similar",
    ),
    "combined": ("4.2, Figure 6", "the three families together beat each alone", "in all modes"),
    "lowest": ("4.2, Figure 5", "time features: a user out is the lowest of the modes", "stated"),
    "trees": (
        "4.2, Figure 5",
        "time features, trees: a model out scores higher than a device out within its model",
        "C4.5, forest",
    ),
    "knn": ("4.2, Figure 5", "ECDF features: kNN outperforms the forest", "stated"),
    "alike": ("4.2, Figure 5", "learners are more alike on ECDF features than on the others", "more similar"),
    "both": (
        "4.2",
        "time and ECDF: user and model out is below user out with every learner",
        "all learners",
    ),
    "both frequency": (
        "4.2",
        "frequency: user and model out is below user out with every learner but kNN",
        "all but kNN",
    ),
    "breaks": ("4.2", "trained on one model, C4.5 breaks down the most of the learners", "most significant"),
    "pca": ("4.2, Figure 10", "PCA helps ECDF features with a tree trained on one model", "improved"),
    "pca others": ("4.2, Figure 10", "PCA lowers the scores of time and frequency features", "harmful"),
}


def _apart() -> list[str]:
    """Return the ways of other windows of Figure 5's modes."""
    return [way for way in ways(*FIGURE_5) if way not in FIGURE_5]


def comparisons(found: Found) -> list[Claim]:
    """Judge everything that is said of families and learners, in the order of COMPARED."""
    return [
        _similar(found),
        _combined(found),
        _lowest(found),
        _trees(found),
        _knn(found),
        _alike(found),
        *_both_out(found),
        _breaks(found),
        *_principal(found),
    ]


def _similar(found: Found) -> Claim:
    modes = ("ten-fold", "user out")
    means = [found.f1(mode).mean(axis=1) for mode in modes]
    cells = [", ".join(f"{name} {v:.1f}" for name, v in zip(FAMILIES, own, strict=True)) for own in means]
    apart = [float(np.ptp(own)) for own in means]
    by_axis = [float(found.causes.axes[mode].mean()) for mode in modes]
    closer = [
        float(np.ptp([axis if name == "frequency" else v for name, v in zip(FAMILIES, own, strict=True)]))
        for axis, own in zip(by_axis, means, strict=True)
    ]
    return claim(
        COMPARED["similar"],
        f"ten-fold: {cells[0]}; user out: {cells[1]} %",
        holds(bool(max(np.ptp(own) for own in means) <= NEAR)),
        f"holds where highest and lowest are {NEAR:.0f} points apart or less in both; means of learners",
        Cause(
            "frequency features are of the norm's spectrum, which tells no attitude; the paper does not say"
            " of what it takes them. Taken of each axis as well, as time features are, they have"
            f" {by_axis[0]:.1f} and {by_axis[1]:.1f} %, and the families lie {closer[0]:.1f} and"
            f" {closer[1]:.1f} points apart instead of {apart[0]:.1f} and {apart[1]:.1f}",
            shown=all(new <= old / 2.0 for new, old in zip(closer, apart, strict=True)),
        ),
    )


def _combined(found: Found) -> Claim:
    asked, apart = FIGURE_5, _apart()
    ahead = {
        way: float(found.together[way].mean() - found.f1(way).max(axis=0).mean()) for way in (*asked, *apart)
    }
    beaten, other = ([way for way in some if ahead[way] > 0.0] for some in (asked, apart))
    alone = found.f1("user out").max(axis=0)
    lean = found.causes.lean
    short = "; ".join(f"{way} {gain:+.1f}" for way, gain in ahead.items())
    return claim(
        COMPARED["combined"],
        f"in {len(beaten)} of {len(asked)} modes ({OTHER} {len(other)} of {len(apart)}); user out"
        f" {found.together['user out'].mean():.1f} against {alone.mean():.1f} %",
        holds(len(beaten) == len(asked)),
        "against the best single family of each learner, on the mean of learners, in all modes of Figure 5."
        f" Points ahead: {short}",
        Cause(
            "frequency features are the weakest here. Time and ECDF together, without them, have"
            f" {lean.mean():.1f} % with a user out, the best family alone {alone.mean():.1f} %",
            shown=bool(lean.mean() > alone.mean()),
        ),
    )


def _lowest(found: Found) -> Claim:
    asked = [mode for mode in FIGURE_5 if "user out" not in mode and "user and" not in mode]
    user = float(found.by_learner("user out", "time").mean())
    others = {way: float(found.by_learner(way, "time").mean()) for way in asked}
    lower = {way: value for way, value in others.items() if value <= user}
    least = min(others, key=lambda way: others[way])
    time = list(FAMILIES).index("time")
    few = {mode: found.causes.nine[mode][:, time].mean(axis=1) for mode in ("user out", *NEXT)}
    figures = "; ".join(f"{mode} {', '.join(f'{v:.1f}' for v in own)} %" for mode, own in few.items())
    return claim(
        COMPARED["lowest"],
        f"user out {user:.1f} %; {least} {others[least]:.1f} %",
        holds(not lower),
        "means of learners; against the modes that keep the people, as the paper says elsewhere that leaving"
        " out a model as well is lower. As low or lower: "
        + (", ".join(f"{way} {v:.1f} %" for way, v in lower.items()) or "none"),
        Cause(
            f"{AS_FEW}, by draw of people: {figures}",
            shown=often(np.all([few["user out"] < few[mode] for mode in NEXT], axis=0)),
        ),
    )


def _trees(found: Found) -> Claim:
    columns = [list(LEARNERS).index(name) for name in TREES]

    both = [("model out", INTRA), tuple(map(other_windows, ("model out", INTRA)))]
    scores = [tuple(found.by_learner(way, "time")[columns] for way in pair_of) for pair_of in both]
    words = [
        f"{', '.join(f'{v:.1f}' for v in a)} against {', '.join(f'{v:.1f}' for v in b)}" for a, b in scores
    ]
    few, plain = found.causes.few, found.causes.uncounted
    above = [bool((a > b).all()) for a, b in scores]
    half = all(
        bool((plain[a] - plain[b] >= 0.5 * (x - y)).all())
        for (a, b), (x, y) in zip(both, scores, strict=True)
    )
    listed = [
        "; ".join(
            f"{', '.join(f'{v:.1f}' for v in tried[a])} against {', '.join(f'{v:.1f}' for v in tried[b])}"
            for a, b in both
        )
        for tried in (few, plain)
    ]
    return claim(
        COMPARED["trees"],
        both_ways(words, above, " %"),
        holds(above[0]),
        f"{', '.join(TREES)}; holds where both are higher with a model out",
        Cause(
            "without the features that count by the sample, which are alike only within a model,"
            f" {listed[1]} %; on {FEW} rows each, all time features, {listed[0]} %",
            shown=half,
        ),
    )


def _knn(found: Found) -> Claim:
    asked, apart = FIGURE_5, _apart()
    lead = {way: _lead(found, way) for way in (*asked, *apart)}
    ahead, other = ([way for way in some if lead[way] > 0.0] for some in (asked, apart))
    seen = {way for way in asked if way == "ten-fold" or other_windows(way) in apart}
    listed = ", ".join(f"{way} {v:+.1f}" for way, v in lead.items())
    user = found.by_learner("user out", "ECDF")
    knn, forest = (list(LEARNERS).index(name) for name in ("kNN", "forest"))
    draws = found.causes.nine["user out"][:, list(FAMILIES).index("ECDF")]
    few = ", ".join(f"{own[knn] - own[forest]:+.1f}" for own in draws)
    return claim(
        COMPARED["knn"],
        f"in {len(ahead)} of {len(asked)} modes ({OTHER} {len(other)} of {len(apart)}); user out"
        f" {user[knn]:.1f} against {user[forest]:.1f} %",
        holds(len(ahead) == len(asked)),
        f"in all modes of Figure 5. Points of kNN above the forest: {listed}",
        Cause(
            f"kNN is ahead in {len(ahead)} modes: "
            + (", ".join(f"{way} {lead[way]:+.1f}" for way in ahead) or "none")
            + (", where the tested motion itself is in training" if set(ahead) <= seen else "")
            + f". {AS_FEW[0].upper()}{AS_FEW[1:]}, with a user out, by draw of people: {few}",
            shown=False,
        ),
    )


def _lead(found: Found, way: str) -> float:
    own = dict(zip(LEARNERS, found.by_learner(way, "ECDF"), strict=True))
    return float(own["kNN"] - own["forest"])


def _alike(found: Found) -> Claim:
    ecdf = list(FAMILIES).index("ECDF")
    asked, apart = FIGURE_5, _apart()
    modes, other = (np.array([np.ptp(found.f1(way), axis=1) for way in some]) for some in (asked, apart))
    least = int(np.sum(modes.argmin(axis=1) == ecdf))

    def closest(right: dict[str, Array]) -> bool:
        return bool(np.mean([np.ptp(own, axis=1) for own in right.values()], axis=0).argmin() == ecdf)

    share = among_nine(found, asked, closest)
    good = [bool(own.mean(axis=0).argmin() == ecdf) for own in (modes, other)]
    cells = [
        ", ".join(f"{name}{v:.1f}" for name, v in zip(names, own.mean(axis=0), strict=True))
        for names, own in (([f"{name} " for name in FAMILIES], modes), ([""] * len(FAMILIES), other))
    ]
    return claim(
        COMPARED["alike"],
        both_ways([f"apart by {cells[0]}", cells[1]], good, " points"),
        holds(good[0]),
        f"best less worst learner, mean of the modes of Figure 5; ECDF is the least in {least} of"
        f" {len(asked)} modes",
        Cause(
            f"{among_words(share)} learners are closest on ECDF features, mean of the modes; mode by mode,"
            f" over everybody, in {least} of {len(asked)}",
            shown=share > CHANCE,
        ),
    )


def _both_out(found: Found) -> list[Claim]:
    """Compare a user and a model out with a user out: the same windows on the same devices."""
    right = {
        mode: 100.0 * found.judged[mode].right.mean(axis=2) for mode in ("user out", "user and model out")
    }
    change = right["user and model out"] - right["user out"]
    single = found.f1(ONE) - found.f1("user out")
    by_person = found.by_person("user and model out") - found.by_person("user out")
    made = []
    for key, families in (("both", ("time", "ECDF")), ("both frequency", ("frequency",))):
        rows = [list(FAMILIES).index(name) for name in families]
        own = change[rows]
        down = own < 0.0
        wanted = np.ones_like(down)
        if key == "both frequency":
            wanted[:, list(LEARNERS).index("kNN")] = False
        cells = "; ".join(
            f"{name} {_named_changes(values)}" for name, values in zip(families, own, strict=True)
        )
        alone = int(np.sum(single[rows] < 0.0))
        ends = [[interval(values) for values in own] for own in by_person[rows]]
        against = sum(
            low >= 0.0 if below else high <= 0.0
            for own, expected in zip(ends, wanted, strict=True)
            for (low, high), below in zip(own, expected, strict=True)
        )
        spans = "; ".join(
            f"{name} {', '.join(f'{low:+.1f} to {high:+.1f}' for low, high in own)}"
            for name, own in zip(families, ends, strict=True)
        )
        made.append(
            claim(
                COMPARED[key],
                f"{int(down.sum())} of {down.size} below; {own.min():+.1f} to {own.max():+.1f} points",
                holds(bool((down == wanted).all())),
                f"in windows judged rightly, the same ones on the same devices: {cells} points",
                Cause(
                    f"by intervals over people {against} of the {down.size} are otherwise for certain; they"
                    f" are {spans} points. Trained on one other model instead of on four,"
                    f" {alone} of {down.size} are below: "
                    + "; ".join(
                        f"{n} {_named_changes(v)}" for n, v in zip(families, single[rows], strict=True)
                    ),
                    shown=against == 0 or bool(((single[rows] < 0.0) == wanted).all()),
                ),
            )
        )
    return made


def _breaks(found: Found) -> Claim:
    """Compare the learners by what is lost where training is on one model instead of on all."""
    change = found.f1(ONE) - found.f1("user out")
    learners = change.mean(axis=0)
    families = ", ".join(f"{name} {v:+.1f}" for name, v in zip(FAMILIES, change.mean(axis=1), strict=True))
    by_family = "; ".join(f"{n} {_named_changes(v)}" for n, v in zip(FAMILIES, change, strict=True))
    few = (found.causes.nine[ONE] - found.causes.nine["user out"]).mean(axis=1)
    most = few.argmin(axis=1) == list(LEARNERS).index("tree")
    return claim(
        COMPARED["breaks"],
        f"{_named_changes(learners)} points",
        holds(bool(learners.argmin() == list(LEARNERS).index("tree"))),
        f"F1 on one model with a user out less a user out, mean of families; by family: {families}",
        Cause(
            f"{AS_FEW}, the tree loses the most {in_draws(most)} of people. Over everybody, family by family:"
            f" {by_family}",
            shown=often(most),
        ),
    )


def _named_changes(values: Array) -> str:
    return ", ".join(f"{name} {v:+.1f}" for name, v in zip(LEARNERS, values, strict=True))


def _principal(found: Found) -> list[Claim]:
    """Compare principal components with the features themselves, trained on one model, a user out."""
    gain = found.reduced - found.f1(ONE)
    rows = dict(zip(FAMILIES, gain, strict=True))
    column = list(LEARNERS).index("tree")
    tree = float(rows["ECDF"][column])
    others = {name: float(rows[name].mean()) for name in ("time", "frequency")}
    turned, unscaled = (
        own - float(found.by_learner(ONE, "ECDF")[column])
        for own in (found.causes.turned, found.causes.unscaled)
    )
    why = "F1 on one model with a user out; components keep 95 % of the variance of standardised features"
    return [
        claim(
            COMPARED["pca"],
            f"{tree:+.1f} points",
            holds(tree > 0.0),
            f"{why}; ECDF by learner: {_named_changes(rows['ECDF'])}",
            Cause(
                f"on every component, nothing dropped, the tree changes by {turned:+.1f} points: the turn of"
                f" the axes does that much, and dropping components the other {tree - turned:+.1f}. On"
                f" components of features as they are, not standardised, it changes by {unscaled:+.1f}",
                shown=False,
            ),
        ),
        claim(
            COMPARED["pca others"],
            ", ".join(f"{name} {value:+.1f}" for name, value in others.items()) + " points",
            holds(max(others.values()) < 0.0),
            f"{why}; mean of learners, holds where both lose",
        ),
    ]
