"""Why remedies give back other than the paper says: each supposed cause, tried by itself.

What the activity allows at all, what the lower rate does by itself, features that count by the sample,
activities in motion and at rest, and clusters of devices of one rate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.har.data import ACTIVITIES, RATE_HZ, Windows
from stillcal.replay.studies.har.features import FAMILIES, frequency_features, without_counts
from stillcal.replay.studies.har.scoring import LEARNERS
from stillcal.replay.studies.stisen2015.families import COMMON_HZ
from stillcal.replay.studies.stisen2015.modes import Rows, only, score, splits
from stillcal.replay.studies.stisen2015.recorded import METHODS, reference, resample
from stillcal.replay.studies.stisen2015.treated import RATES_HZ, SPLITS, parts

MOVING = ("walk", "stairs up", "stairs down")


@dataclass(frozen=True, slots=True, eq=False)
class Causes:
    """What was tried, in points of F1 but for `ceiling`, percent.

    ceiling: the SVM on frequency features of a faultless device at 25 Hz, people in both parts, all windows.
    slower: gained by going from 50 to 25 Hz on a faultless device, frequency features, mean of learners.
    moving, still: gained by smoothed splines, a model out, forest on frequency features, among activities in
    motion and among the others. uncounted: gained by each of METHODS, a model out, on time features
    `without_counts`. same_rate: (3, parts), gained by training on the other devices of one rate instead of on
    all. within: gained by linear interpolation among devices of one rate, frequency features. mixed: Hz,
    lowest and highest rate within the cluster that mixes them most.
    """

    ceiling: float
    slower: float
    moving: float
    still: float
    uncounted: dict[str, float]
    same_rate: Array
    within: float
    mixed: tuple[float, float]


def tried(rows: dict[str, Rows], rates: list[float], windows: Windows, few: Windows, seed: int) -> Causes:
    """Try every cause. rows: by way, of devices with these rates, Hz. few: the windows behind them."""
    out = list(splits(rows["raw"], "model out", seed))
    forest = {"forest": LEARNERS["forest"]}
    frequency = {way: of_family(rows[way], "frequency") for way in ("raw", "smoothed")}
    moves = np.isin(rows["raw"].label, [ACTIVITIES.index(a) for a in MOVING])
    gains = []
    for mask in (moves, ~moves):
        before, after = (only(frequency[way], mask) for way in ("raw", "smoothed"))
        again = list(splits(before, "model out", seed))
        gains.append(_points(score(after, again, seed, forest)) - _points(score(before, again, seed, forest)))
    plain = _points(score(_uncounted(rows["raw"]), out, seed))
    alike = {way: replace(rows[way], cluster=_by_rate(rows[way].device, rates)) for way in ("raw", "linear")}
    anywhere, inside = (list(parts(alike["raw"], split, seed)) for split in SPLITS[2:])
    within = {way: score(alike[way], inside, seed) for way in alike}
    return Causes(
        ceiling=_faultless(windows, COMMON_HZ, seed, learners=("SVM",)),
        slower=_faultless(few, COMMON_HZ, seed) - _faultless(few, RATE_HZ, seed),
        moving=gains[0],
        still=gains[1],
        uncounted={m: _points(score(_uncounted(rows[m]), out, seed)) - plain for m in METHODS},
        same_rate=100.0 * (within["raw"] - score(alike["raw"], anywhere, seed)).mean(axis=1),
        mixed=_most_mixed(rows["raw"], np.array(rates)),
        within=_points(within["linear"][_FREQUENCY]) - _points(within["raw"][_FREQUENCY]),
    )


_FREQUENCY = list(FAMILIES).index("frequency")


def of_family(rows: Rows, family: str) -> Rows:
    """Return the rows with the features of one family alone."""
    return replace(rows, features={family: rows.features[family]})


def _uncounted(rows: Rows) -> Rows:
    return replace(rows, features={"time": without_counts(rows.features["time"])})


def _by_rate(device: NDArray[np.intp], rates: list[float]) -> NDArray[np.intp]:
    """Return the nearest of RATES_HZ, as a ratio, of each row's device (n,)."""
    nearest = np.abs(np.log(np.array(rates)[:, None] / np.array(RATES_HZ))).argmin(axis=1)
    return np.asarray(nearest[device], dtype=np.intp)


def _most_mixed(rows: Rows, rates: Array) -> tuple[float, float]:
    spans = [rates[np.unique(rows.device[rows.cluster == c])] for c in np.unique(rows.cluster)]
    widest = max(spans, key=lambda own: float(own.max() / own.min()))
    return float(widest.min()), float(widest.max())


def _faultless(
    windows: Windows, rate: float, seed: int, learners: tuple[str, ...] = tuple(LEARNERS)
) -> float:
    """Return the mean F1, percent, of frequency features of a device without errors, people in both parts."""
    clean = reference(windows.accel)
    samples = clean.samples if rate == RATE_HZ else resample(clean, rate, "linear")
    none = np.zeros(len(windows), dtype=np.intp)
    rows = Rows({"frequency": frequency_features(samples)}, windows.label, windows.person, none, none, none)
    chosen = {name: LEARNERS[name] for name in learners}
    return _points(score(rows, list(splits(rows, "ten-fold", seed)), seed, chosen, most=len(windows)))


def _points(f1: Array) -> float:
    return 100.0 * float(f1.mean())
