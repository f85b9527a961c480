"""What the paper says of remedies, judged both ways: on motion that was trained on, and on other motion.

The paper's way decides. A cause counts as shown only where it holds both ways. One that is held against the
gains with a model out is judged the paper's way alone: on other windows those gains are few.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.claim import Cause, Claim, Evidence, Verdict, holds
from stillcal.replay.studies.har.features import FAMILIES
from stillcal.replay.studies.har.scoring import INDEPENDENT, LEARNERS, interval, with_interval
from stillcal.replay.studies.stisen2015.both_ways import OTHER, both_ways
from stillcal.replay.studies.stisen2015.families import COMMON_HZ, by_family
from stillcal.replay.studies.stisen2015.modes.claims import AS_FEW, often
from stillcal.replay.studies.stisen2015.recorded import METHODS, RATES_HZ
from stillcal.replay.studies.stisen2015.remedies.causes import USER, ByWay, Causes
from stillcal.replay.studies.stisen2015.remedies.scores import INSIDE, UNKNOWN, Found

WORK = "Stisen 2015"
HALF = 15.5
"""Points: half of what the SVM gains by interpolation in the paper."""

SPLINES = ("cubic", "smoothed")
FREQUENCY, TIME, ECDF = (list(FAMILIES).index(name) for name in ("frequency", "time", "ECDF"))
PAPER = {
    "interpolation": ("5.2, Figure 13", "interpolation, SVM on frequency, model out: F1", "55 → 86 %"),
    "low": ("5.2, Figure 13", "the highest gains are at low target rates", "25 Hz"),
    "simple": (
        "5.2, Figures 13 and 14b",
        "SVM on frequency, model out: nearest and linear do better than splines",
        "stated",
    ),
    "frequency": (
        "5.2, Figure 14b",
        "model out: frequency features gain by all interpolations and learners",
        "all, by 30 points and more with the SVM",
    ),
    "time": (
        "5.2, Figure 14b",
        "model out: time features gain by nearest and linear, lose by splines",
        "stated",
    ),
    "ecdf": ("5.2, Figure 14b", "model out: ECDF features gain little or nothing by interpolation", "stated"),
    "known": (
        "5.2, Figure 14a",
        "on known devices (user out) interpolation loses most of its effect",
        "stated",
    ),
    "significant": (
        "5.2, Figure 14b",
        "model out: gains of frequency features are significant by McNemar's test",
        "p < 0.001 in all",
    ),
    "known significant": (
        "5.2, Figure 14a",
        "on known devices (user out) few gains are significant by McNemar's test",
        "lost most",
    ),
    "within": (
        "5.3, Figure 15",
        "within a cluster interpolation gains in a few instances only, McNemar",
        "a few: SVM, kNN, forest on frequency",
    ),
    "within significant": (
        "5.3, Figure 15",
        "within a cluster SVM, kNN and forest gain on frequency features, McNemar",
        "p < 0.001",
    ),
    "cluster": ("5.1, 5.3", "what clustering gives back, by family", "increases performance"),
    "calibrated": ("3.1, 6", "what calibration gives back on an unknown model, by family", "-"),
}


def judged(found: Found) -> list[Claim]:
    """Judge all claims, in the order of PAPER."""
    return [*_figure_13(found), *_figure_14(found), *_significance(found), *_given_back(found)]


def _claim(key: str, ours: str, verdict: Verdict, because: str, cause: Cause | None = None) -> Claim:
    return Claim(WORK, *PAPER[key], ours, "", verdict, because, evidence=Evidence.SEMI_SYNTHETIC, cause=cause)


def _judged(
    key: str,
    cells: list[str],
    good: list[bool],
    because: str,
    cause: Cause | None = None,
    *,
    unit: str = "",
) -> Claim:
    """Judge a claim by whether it holds as the paper tests. cells, good: that way, and on other windows."""
    return _claim(key, both_ways(cells, good, unit), holds(good[0]), because, cause)


def _both(cells: list[str]) -> str:
    return f"{cells[0]}; {OTHER} {cells[1]}"


def _named(values: list[dict[str, float]], form: str) -> list[str]:
    """Say figures by name, and those on other windows in the same order."""
    first = ", ".join(f"{name} {v:{form}}" for name, v in values[0].items())
    return [first, ", ".join(f"{v:{form}}" for v in values[1].values())]


def _figure_13(found: Found) -> list[Claim]:
    none = [found.sweep[test, "raw", 0.0] for test in UNKNOWN]
    best = [found.sweep[test, "linear", COMMON_HZ] for test in UNKNOWN]
    ceiling, few = found.causes.ceiling, found.causes.nine
    gains = few[:, 1, 1] - few[:, 1, 0]
    by_rate = [
        {rate: max(found.sweep[test, method, rate] for method in METHODS) for rate in RATES_HZ}
        for test in UNKNOWN
    ]
    highest = [max(own, key=lambda rate: own[rate]) for own in by_rate]
    methods = [{method: found.sweep[test, method, COMMON_HZ] for method in METHODS} for test in UNKNOWN]
    svm = list(LEARNERS).index("SVM")
    own = {m: found.scores[UNKNOWN[0], m][FREQUENCY, svm] for m in METHODS}
    pairs = {
        (simple, spline): own[simple] - own[spline]
        for simple in METHODS
        if simple not in SPLINES
        for spline in SPLINES
    }
    below = [pair for pair, gain in pairs.items() if interval(gain)[1] < 0.0]
    above = [pair for pair, gain in pairs.items() if interval(gain)[0] > 0.0]
    interpolation = _judged(
        "interpolation",
        [f"{a:.1f} → {b:.1f}" for a, b in zip(none, best, strict=True)],
        [b - a >= HALF for a, b in zip(none, best, strict=True)],
        "holds with half of the paper's gain of 31 points or more",
        Cause(
            f"{AS_FEW}, linear interpolation brings it to {_drawn(few[:, 0, 1])} % by draw of people, where"
            f" the paper has 86; here a faultless device at 25 Hz has {ceiling:.1f} % with all people and"
            f" rows. It starts from {_drawn(few[:, 0, 0])} %, with coefficients as magnitudes, not as shares"
            f" of the spectrum's sum, from {_drawn(few[:, 1, 0])} %, and gains with these"
            f" {_drawn(gains)} points",
            shown=often(gains >= HALF),
        ),
        unit=" % (linear, 25 Hz)",
    )
    return [
        replace(interpolation, brief=f"{none[0]:.1f} → {best[0]:.1f} %; {OTHER} {best[1]:.1f}"),
        _judged(
            "low",
            [
                names + ", ".join(f"{v:.1f}" for v in own.values())
                for names, own in zip(
                    (f"{', '.join(f'{r:.0f}' for r in RATES_HZ)} Hz: ", ""), by_rate, strict=True
                )
            ],
            [rate == COMMON_HZ for rate in highest],
            "best method at each rate; holds where 25 Hz is the highest",
            unit=" %",
        ),
        _judged(
            "simple",
            _named(methods, ".1f"),
            [
                min(own[m] for m in METHODS if m not in SPLINES) > max(own[m] for m in SPLINES)
                for own in methods
            ],
            "at 25 Hz; holds where both are above both splines",
            Cause(
                "chance, by model left out: ahead by, points,"
                f" {', '.join(f'{a} of {b} {with_interval(gain)}' for (a, b), gain in pairs.items())}. The"
                f" paper's order is certain in {len(above)} of {len(pairs)}, the other one in {len(below)}",
                shown=bool(above) and not below,
            ),
            unit=" %",
        ),
    ]


def _figure_14(found: Found) -> list[Claim]:
    # points by test, method, family and learner
    cells = np.array([[found.gain(test, m).mean(axis=2) for m in METHODS] for test in UNKNOWN])
    by_method = cells.mean(axis=3)
    sure = [
        sum(
            interval(found.gain(test, m)[FREQUENCY, k])[0] > 0.0
            for m in METHODS
            for k in range(len(LEARNERS))
        )
        for test in UNKNOWN
    ]
    number = cells[0, :, FREQUENCY].size
    unknown = [float(np.mean([found.gain(test, m)[FREQUENCY] for m in METHODS])) for test in UNKNOWN]
    known = float(np.mean([found.gain(USER, m)[FREQUENCY] for m in METHODS]))
    listed = {
        f: _named([dict(zip(METHODS, own[:, f], strict=True)) for own in by_method], "+.1f")
        for f in (TIME, ECDF)
    }
    why = found.causes
    counted = ", ".join(f"{m} {_ways(v)}" for m, v in why.uncounted.items())
    simple, splines = by_method[:, :2, TIME], by_method[:, 2:, TIME]
    return [
        _judged(
            "frequency",
            [
                f"{n} of {number}, {own[:, FREQUENCY].min():+.1f} to {own[:, FREQUENCY].max():+.1f}"
                for n, own in zip(sure, cells, strict=True)
            ],
            [n == number for n in sure],
            "counted where the interval by model left out lies above zero; to 25 Hz; holds where all do",
            _magnitudes(why),
            unit=" points",
        ),
        _judged(
            "time",
            listed[TIME],
            [bool((a > 0.0).all() and (b < 0.0).all()) for a, b in zip(simple, splines, strict=True)],
            "mean of learners; holds where the signs are as stated",
            Cause(
                "without the eight features that count by the sample, which any common rate mends, time"
                f" features gain {counted} points",
                shown=max(max(why.uncounted[m].values()) for m in SPLINES) < 0.0,
            ),
            unit=" points",
        ),
        _judged(
            "ecdf",
            listed[ECDF],
            [bool((own[:, ECDF] <= 1.0).all()) for own in by_method],
            "mean of learners; little: a point at most by any method",
            unit=" points",
        ),
        _judged(
            "known",
            [f"{known:+.1f} of {v:+.1f}" for v in unknown],
            [known < v / 2.0 for v in unknown],
            "frequency features, mean of methods and learners; holds with less than half of the gain with a"
            " model out",
            Cause(
                "on a faultless device, where there is nothing to mend, the same features gain"
                f" {why.slower:+.1f} points by going from 50 to 25 Hz",
                shown=why.slower >= 0.5 * known,
            ),
            unit=" points",
        ),
    ]


def _drawn(values: Array) -> str:
    return ", ".join(f"{value:.1f}" for value in values)


def _ways(gain: ByWay) -> str:
    same, other = gain.values()
    return f"{same:+.1f} ({OTHER} {other:+.1f})"


def _magnitudes(why: Causes) -> Cause:
    """Say what interpolation gains where a spectrum grows with the number of samples."""
    own = why.magnitudes
    sure = [sum(interval(cell)[0] > 0.0 for row in gain for cell in row) for gain in own.gain.values()]
    certain = [_sure(p, 0.001) for p in own.p.values()]
    number = next(iter(own.p.values())).size
    means = [gain.mean(axis=2) for gain in own.gain.values()]
    return Cause(
        "the paper says that coefficients are normalised, and not by what. Here they are shares of the"
        " spectrum's sum, which sets right most of what a rate does. As magnitudes, which grow with the"
        f" number of samples, interpolation gains in {sure[0]} of {number} (other windows {sure[1]}) by the"
        f" intervals, {means[0].min():+.1f} to {means[0].max():+.1f} points ({means[1].min():+.1f} to"
        f" {means[1].max():+.1f}), and with p < 0.001 in {certain[0]} ({certain[1]})",
        shown=min(*sure, *certain) == number,
    )


def _sure(p: Array, level: float) -> int:
    return int(np.sum((p >= 0.0) & (p < level)))


def _significance(found: Found) -> list[Claim]:
    # p by test, method, family and learner
    p = {
        test: np.stack([found.significance(test, method) for method in METHODS])
        for test in (*UNKNOWN, USER, *INSIDE)
    }
    frequency = [p[test][:, FREQUENCY] for test in UNKNOWN]
    number = frequency[0].size
    sure = [_sure(own, 0.001) for own in frequency]
    misses = [
        f"{learner} by {method} (p = {abs(frequency[0][m, k]):.1g})"
        for m, method in enumerate(METHODS)
        for k, learner in enumerate(LEARNERS)
        if not 0.0 <= frequency[0][m, k] < 0.001
    ]
    without = f". Not so: {', '.join(misses)}" if misses else ""
    why = f"by recogniser and method, Yates' correction; {INDEPENDENT}"
    gains = {test: _sure(own, 0.01) for test, own in p.items()}
    plain = {
        test: _sure(np.delete(own, TIME, axis=1), 0.01) + _sure(found.causes.uncounted_p[test], 0.01)
        for test, own in p.items()
    }
    time = {test: _sure(own[:, TIME], 0.01) for test, own in p.items()}
    left = {test: _sure(own, 0.01) for test, own in found.causes.uncounted_p.items()}
    every = p[USER].size
    linear = [p[test][METHODS.index("linear"), FREQUENCY] for test in INSIDE]
    three = [list(LEARNERS).index(name) for name in ("SVM", "kNN", "forest")]
    listed = [
        ", ".join(
            f"{name}{abs(own[k]):.0e}{'' if own[k] >= 0.0 else ' (loses)'}"
            for name, k in zip(names, three, strict=True)
        )
        for own, names in zip(linear, (("SVM ", "kNN ", "forest "), ("", "", "")), strict=True)
    ]
    return [
        _judged(
            "significant",
            [f"p < 0.001 in {n} of {number}" for n in sure],
            [n == number for n in sure],
            f"{why}: see the intervals by model. Holds where all are{without}",
            _magnitudes(found.causes),
        ),
        _judged(
            "known significant",
            [
                f"p < 0.01 in {gains[USER]} of {every}, model out {gains[UNKNOWN[0]]}",
                f"{gains[UNKNOWN[1]]}",
            ],
            [gains[USER] <= gains[test] / 2.0 for test in UNKNOWN],
            f"{why}; all families. Holds with at most half as many as with a model out",
            Cause(
                f"{time[USER]} of these are gains of time features, eight of which count by the sample, which"
                f" any common rate mends. Without the eight, time features gain in {left[USER]}, and all"
                f" families in {plain[USER]}, with a model out in {plain[UNKNOWN[0]]}"
                f" ({OTHER} {plain[UNKNOWN[1]]})",
                shown=plain[USER] <= plain[UNKNOWN[0]] / 2.0,
            ),
        ),
        _judged(
            "within",
            [f"p < 0.01 in {gains[INSIDE[0]]} of {every}", f"{gains[INSIDE[1]]}"],
            [gains[test] < every / 2.0 for test in INSIDE],
            f"{why}; all families; device out, within its cluster. A few: fewer than half",
            Cause(
                f"{time[INSIDE[0]]} of these ({OTHER} {time[INSIDE[1]]}) are gains of time features, eight of"
                " which count by the sample, which any common rate mends. Without the eight, time features"
                f" gain in {left[INSIDE[0]]} ({left[INSIDE[1]]}), and all families in {plain[INSIDE[0]]}"
                f" ({plain[INSIDE[1]]})",
                shown=max(plain[test] for test in INSIDE) < every / 2.0,
            ),
        ),
        _judged(
            "within significant",
            listed,
            [bool(((own[three] >= 0.0) & (own[three] < 0.001)).all()) for own in linear],
            f"p by linear interpolation, {why}; device out, within its cluster. Holds where all three are",
            Cause(
                f"devices of one rate alone, where linear interpolation gains {_ways(found.causes.within)}"
                " points, mean of learners",
                shown=False,
            ),
        ),
    ]


def _given_back(found: Found) -> list[Claim]:
    clustering = [own.mean(axis=1) for own in found.clustering()]
    calibration = [found.gain(test, "calibrated").mean(axis=1) for test in UNKNOWN]
    alike = list(found.causes.same_rate.values())
    return [
        _judged(
            "cluster",
            _means(clustering),
            [_helps(own) for own in clustering],
            "holds where some family's interval by device lies above zero and none below; trained"
            f" on its cluster's devices instead of on all: {_both([by_family(own) for own in clustering])}",
            Cause(
                "grouped by rate instead, training within a group gives"
                f" {_both([by_family(own) for own in alike])}."
                f" The paper's clusters put devices of {found.causes.mixed[0]:.0f} to"
                f" {found.causes.mixed[1]:.0f} Hz together",
                shown=all(map(_helps, alike)),
            ),
            unit=" points",
        ),
        _claim(
            "calibrated",
            f"{_both(_means(calibration))} points",
            Verdict.OPEN,
            f"a model left out; intervals by model: {_both([by_family(own) for own in calibration])}",
        ),
    ]


def _means(gain: list[Array]) -> list[str]:
    return _named([dict(zip(FAMILIES, own.mean(axis=1), strict=True)) for own in gain], "+.1f")


def _helps(gain: Array) -> bool:
    """Return whether some family gains and none loses, by intervals over the second axis; (3, n) points."""
    spans = [interval(row) for row in gain]
    return any(low > 0.0 for low, _ in spans) and all(high >= 0.0 for _, high in spans)
