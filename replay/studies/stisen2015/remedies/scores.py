"""The scores of every remedy in the modes of Figures 13 to 15."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.claim import Progress
from stillcal.replay.studies.har.scoring import LEARNERS, signed_mcnemar
from stillcal.replay.studies.stisen2015.modes.rows import Judged, Rows, judge, other_windows, splits
from stillcal.replay.studies.stisen2015.recorded import METHODS, RATES_HZ
from stillcal.replay.studies.stisen2015.remedies.causes import (
    DEVICE,
    MOST,
    OUT,
    USER,
    WITHIN,
    Causes,
    by_device,
    halves,
    of_family,
)
from stillcal.replay.studies.stisen2015.remedies.treated import WAYS, Carried

UNKNOWN = (OUT, other_windows(OUT))
"""A model out, tested on windows that were trained on through other devices, and on others."""

INSIDE = (WITHIN, other_windows(WITHIN))
ANYWHERE = (DEVICE, other_windows(DEVICE))
TESTS = (*UNKNOWN, USER, *INSIDE)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """scores: F1 by test and way, percent, (3 families, 4 learners, n) by model, device or people left out.

    right: by test and way, whether each tested window was judged rightly, (3 families, 4 learners, n). sweep:
    F1 by test, method and rate, percent, Figure 13.
    """

    scores: dict[tuple[str, str], Array]
    right: dict[tuple[str, str], NDArray[np.bool_]]
    sweep: dict[tuple[str, str, float], float]
    causes: Causes

    def gain(self, test: str, way: str) -> Array:
        """Return points of F1 over raw, (3, 4, n)."""
        return np.asarray(self.scores[test, way] - self.scores[test, "raw"])

    def significance(self, test: str, way: str) -> Array:
        """Return McNemar's p-value of a way against raw, (3, 4); negative where it judges fewer rightly."""
        return signed_mcnemar(self.right[test, way], self.right[test, "raw"])

    def clustering(self) -> list[Array]:
        """Return points of F1 by training within the cluster instead of on all, (3, 4, n), both ways."""
        return [
            np.asarray(self.scores[inside, "raw"] - self.scores[anywhere, "raw"])
            for inside, anywhere in zip(INSIDE, ANYWHERE, strict=True)
        ]


def score_all(carried: Carried, rows: dict[str, Rows], causes: Causes, progress: Progress) -> Found:
    """Score every way in every mode, and Figure 13's sweep. rows: by way, at the common rate."""
    seed = carried.seed
    found = Found({}, {}, {}, causes)
    for k, way in enumerate(WAYS):
        judged: dict[str, Judged] = {}
        for mode in (OUT, WITHIN, DEVICE) if way == "raw" else (OUT, WITHIN):
            judged |= judge(rows[way], halves(rows[way], mode, seed), seed, most=MOST)
        found.scores.update({(test, way): by_device(own) for test, own in judged.items()})
        judged |= judge(rows[way], list(splits(rows[way], USER, seed)), seed, most=MOST)
        found.scores[USER, way] = 100.0 * judged[USER].f1
        found.right.update({(test, way): own.right for test, own in judged.items()})
        progress(0.3 + 0.5 * (k + 1) / len(WAYS))
    found.sweep.update({(test, "raw", 0.0): f1 for test, f1 in _figure_13(rows["raw"], seed).items()})
    for k, method in enumerate(METHODS):
        for rate in RATES_HZ:
            cells = _figure_13(carried.rows(method, rate), seed)
            found.sweep.update({(test, method, rate): f1 for test, f1 in cells.items()})
        progress(0.8 + 0.2 * (k + 1) / len(METHODS))
    return found


def _figure_13(rows: Rows, seed: int) -> dict[str, float]:
    svm = {"SVM": LEARNERS["SVM"]}
    judged = judge(of_family(rows, "frequency"), halves(rows, OUT, seed), seed, svm, most=MOST)
    return {test: float(own.mean[0, 0]) for test, own in judged.items()}
