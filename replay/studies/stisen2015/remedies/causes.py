"""Why remedies give back other than the paper says: each supposed cause, tried by itself.

What the activity allows at all, what the lower rate does by itself, features that count by the sample, a
spectrum's magnitudes instead of shares, and clusters of devices of one rate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.har.data import RATE_HZ, Windows
from stillcal.replay.studies.har.features import FAMILIES, frequency_features, without_counts
from stillcal.replay.studies.har.scoring import LEARNERS, signed_mcnemar
from stillcal.replay.studies.stisen2015.families import COMMON_HZ
from stillcal.replay.studies.stisen2015.modes.rows import (
    Judged,
    Part,
    Rows,
    judge,
    nine_people,
    other_windows,
    record_all,
    splits,
)
from stillcal.replay.studies.stisen2015.modes.scores import DRAWS
from stillcal.replay.studies.stisen2015.recorded import METHODS, by_rate, reference, resample
from stillcal.replay.studies.stisen2015.remedies.treated import Carried

MOST, HALVES = 400, 2
"""Rows that a recogniser is trained on at most; groups of windows of which one is not trained on."""

OUT, DEVICE, WITHIN = "model out", "device out", "device out, within cluster"
USER = "user out"
ByWay = dict[str, float]
"""Points by way: of a mode that keeps people, and of its `other_windows`."""


@dataclass(frozen=True, slots=True, eq=False)
class Magnitudes:
    """What interpolation gains on frequency features as magnitudes, a model out, by way.

    gain: points of F1 by method, learner and model left out, (4, 4, models). p: McNemar's, by method and
    learner, (4, 4), negative where it judges fewer rightly.
    """

    gain: dict[str, Array]
    p: dict[str, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Causes:
    """What was tried, in points of F1 but for `ceiling`, percent.

    ceiling: the SVM on frequency features of a faultless device at 25 Hz, people in both parts, all windows.
    slower: gained by going from 50 to 25 Hz on a faultless device, frequency features, mean of learners.
    magnitudes: what interpolation gains on frequency features that are magnitudes.
    nine: the SVM on frequency features, nine people and nobody lying, F1 in percent as shares and as
    magnitudes, raw and linear, by draw of people, (DRAWS, 2, 2).
    uncounted: gained by each of METHODS, a model out, on time features `without_counts`. uncounted_p:
    McNemar's, on these, by test, method and learner, (4, 4), negative where it judges fewer rightly.
    same_rate: (3, devices), gained by training on the other devices of one rate instead of on all.
    within: gained by linear interpolation among devices of one rate, frequency features. mixed: Hz,
    lowest and highest rate within the cluster that mixes them most.
    """

    ceiling: float
    slower: float
    magnitudes: Magnitudes
    nine: Array
    uncounted: dict[str, ByWay]
    same_rate: dict[str, Array]
    within: ByWay
    mixed: tuple[float, float]
    uncounted_p: dict[str, Array]


def tried(carried: Carried, rows: dict[str, Rows], windows: Windows) -> Causes:
    """Try every cause. rows: by way. windows: all that there are."""
    seed, few = carried.seed, carried.windows
    own = of_rows(rows, [device.rate_hz for device in carried.devices], seed)
    return Causes(
        ceiling=faultless(windows, COMMON_HZ, seed, learners=("SVM",)),
        slower=faultless(few, COMMON_HZ, seed) - faultless(few, RATE_HZ, seed),
        magnitudes=_magnitudes(carried),
        nine=np.array([_nine(carried, windows, seed + k) for k in range(DRAWS)]),
        **own._asdict(),
    )


class OfRows(NamedTuple):
    """What the rows themselves tell of causes: the fields of `Causes` of the same names."""

    uncounted: dict[str, ByWay]
    same_rate: dict[str, Array]
    mixed: tuple[float, float]
    within: ByWay
    uncounted_p: dict[str, Array]


def of_rows(rows: dict[str, Rows], rates: list[float], seed: int) -> OfRows:
    """Return what rows tell, by way. rates: Hz, of the devices."""
    plain = {way: _without_counts(rows[way], seed) for way in ("raw", *METHODS)}
    raw = plain["raw"]
    alike = {way: replace(rows[way], cluster=by_rate(rows[way].device, rates)) for way in ("raw", "linear")}
    anywhere = judge(alike["raw"], halves(alike["raw"], DEVICE, seed), seed, most=MOST)
    inside = {way: judge(own, halves(own, WITHIN, seed), seed, most=MOST) for way, own in alike.items()}
    return OfRows(
        uncounted={
            m: {
                test: float((plain[m][test].mean - raw[test].mean).mean())
                for test in (OUT, other_windows(OUT))
            }
            for m in METHODS
        },
        uncounted_p={
            test: np.stack([signed_mcnemar(plain[m][test].right, raw[test].right)[0] for m in METHODS])
            for test in raw
        },
        same_rate={
            WITHIN: (by_device(inside["raw"][WITHIN]) - by_device(anywhere[DEVICE])).mean(axis=1),
            other_windows(WITHIN): (
                by_device(inside["raw"][other_windows(WITHIN)]) - by_device(anywhere[other_windows(DEVICE)])
            ).mean(axis=1),
        },
        mixed=_most_mixed(rows["raw"], np.array(rates)),
        within=gained(inside["linear"], inside["raw"], _FREQUENCY),
    )


def _magnitudes(carried: Carried) -> Magnitudes:
    seed = carried.seed
    found = {}
    for way in ("raw", *METHODS):
        rows = carried.magnitudes(way)
        found[way] = judge(rows, halves(rows, OUT, seed), seed, most=MOST)
    raw = found["raw"]
    return Magnitudes(
        {t: np.stack([(by_device(found[m][t]) - by_device(raw[t]))[0] for m in METHODS]) for t in raw},
        {t: np.stack([signed_mcnemar(found[m][t].right, raw[t].right)[0] for m in METHODS]) for t in raw},
    )


def _nine(carried: Carried, windows: Windows, seed: int) -> list[list[float]]:
    few, svm = nine_people(windows, seed), {"SVM": LEARNERS["SVM"]}
    recorded = record_all(few, carried.devices, seed)
    own = Carried(few, carried.devices, carried.clusters, recorded, seed)
    return [
        [
            float(judge(rows, halves(rows, OUT, seed), seed, svm, most=MOST)[OUT].mean[0, 0])
            for rows in (make(way) for way in ("raw", "linear"))
        ]
        for make in (lambda way: of_family(own.rows(way), "frequency"), own.magnitudes)
    ]


def halves(rows: Rows, mode: str, seed: int) -> list[Part]:
    """Return the parts of a mode; where it keeps people, half of the windows are not trained on."""
    return list(splits(rows, mode, seed, HALVES))


def by_device(found: Judged) -> Array:
    """Return F1 of `halves` by what is left out, both halves together, percent; (families, learners, n)."""
    return np.asarray(100.0 * found.f1.reshape(*found.f1.shape[:2], -1, HALVES).mean(axis=3))


def gained(after: dict[str, Judged], before: dict[str, Judged], family: int = 0) -> ByWay:
    """Return by way how much more F1 one thing has than another, points, mean of learners."""
    return {way: float((found.mean - before[way].mean)[family].mean()) for way, found in after.items()}


_FREQUENCY = list(FAMILIES).index("frequency")


def of_family(rows: Rows, family: str) -> Rows:
    """Return the rows with the features of one family alone."""
    return replace(rows, features={family: rows.features[family]})


def _without_counts(rows: Rows, seed: int) -> dict[str, Judged]:
    """Judge the rows on time features `without_counts` in the modes of Figures 14 and 15, by way."""
    own = replace(rows, features={"time": without_counts(rows.features["time"])})
    found = judge(own, halves(own, OUT, seed), seed, most=MOST)
    found |= judge(own, halves(own, WITHIN, seed), seed, most=MOST)
    return found | judge(own, list(splits(own, USER, seed)), seed, most=MOST)


def _most_mixed(rows: Rows, rates: Array) -> tuple[float, float]:
    spans = [rates[np.unique(rows.device[rows.cluster == c])] for c in np.unique(rows.cluster)]
    widest = max(spans, key=lambda own: float(own.max() / own.min()))
    return float(widest.min()), float(widest.max())


def faultless(windows: Windows, rate: float, seed: int, learners: tuple[str, ...] = tuple(LEARNERS)) -> float:
    """Return the mean F1, percent, of frequency features of a device without errors, people in both parts."""
    clean = reference(windows.accel)
    samples = clean.samples if rate == RATE_HZ else resample(clean, rate, "linear")
    none = np.zeros(len(windows), dtype=np.intp)
    rows = Rows(
        {"frequency": frequency_features(samples)}, windows.label, windows.person, none, none, none, none
    )
    chosen = {name: LEARNERS[name] for name in learners}
    return float(judge(rows, list(splits(rows, "ten-fold", seed)), seed, chosen)["ten-fold"].mean.mean())
