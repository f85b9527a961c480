"""Scores of families of features where devices differ, kind by kind, with and without remedies.

Stisen et al. 2015, 4 and 5: trained on a clean device, tested on what other devices would have recorded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.claim import Progress
from stillcal.replay.studies.har.data import Windows
from stillcal.replay.studies.har.devices import Device
from stillcal.replay.studies.har.features import FAMILIES, without_counts
from stillcal.replay.studies.har.scoring import (
    LEARNERS,
    Labels,
    fitted,
    folds,
    weighted_f1,
    with_interval,
)
from stillcal.replay.studies.stisen2015.recorded import Kinds, Recorded, record, reference, resample

EACH, FOLDS, COMMON_HZ = 20, 5, 25.0
"""Windows taken of each person; folds by people; the common rate (5.2)."""

HARMS = {
    "errors": Kinds(errors=True, rate=False, uneven=False),
    "rate": Kinds(errors=False, rate=True, uneven=False),
    "uneven": Kinds(errors=False, rate=False, uneven=True),
    "all": Kinds(),
}
UNCOUNTED = ("none", "errors", "rate", "all")
"""Columns in which time features are tried without those that count by the sample."""

REMEDIES = ("all, calibrated", "all, interpolated", "all, both")
COLUMNS = ("none", *HARMS, *REMEDIES)
PAIRED = ("rate", "uneven", "rate and uneven", "errors", "all")
"""Kinds whose loss is looked at with and without interpolation, for frequency features."""

ONLY_FREQUENCY = (
    "rate and uneven",
    *(f"{kind}, interpolated" for kind in ("none", *PAIRED) if kind != "all"),
)
"""Columns of frequency features alone, after COLUMNS."""


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """values: F1 by family, learner, column (COLUMNS), device and fold, (3, 4, 8, devices, folds).

    frequency: the same of frequency features alone, with the columns ONLY_FREQUENCY after COLUMNS.
    moved: how far a column moves the features of a window, by family, (3, 8), as `displacement` has it.
    uncounted: F1 of time features `without_counts`, (4, 4, devices, folds), of UNCOUNTED's columns.
    """

    values: Array
    frequency: Array
    moved: Array
    uncounted: Array

    def mean(self) -> Array:
        """Return the F1 by family, learner and column, in percent."""
        return np.asarray(100.0 * self.values.mean(axis=(3, 4)))

    def without_counts(self, column: str) -> Array:
        """Return points that time features `without_counts` lose by a column, by fold, (folds,)."""
        lost = self.uncounted[:, UNCOUNTED.index(column)] - self.uncounted[:, 0]
        return np.asarray(100.0 * lost.mean(axis=(0, 1)))

    def lost(self, kind: str, *, interpolated: bool) -> Array:
        """Return points that frequency features lose by a kind, by fold, (folds,).

        Against a clean device, both interpolated to the common rate or both as recorded.
        """
        names = (*COLUMNS, *ONLY_FREQUENCY)
        wanted = [names.index(f"{k}, interpolated" if interpolated else k) for k in (kind, "none")]
        one, clean = (self.frequency[:, column].mean(axis=(0, 1)) for column in wanted)
        return np.asarray(100.0 * (one - clean))

    def change(self, column: str, since: str = "none") -> Array:
        """Return what a column loses or gains by family and fold, percentage points; (3, folds)."""
        a, b = COLUMNS.index(column), COLUMNS.index(since)
        return np.asarray(100.0 * (self.values[:, :, a] - self.values[:, :, b]).mean(axis=(1, 2)))


def few_devices(devices: list[Device], each: int = 2) -> list[Device]:
    """Return the first few devices of each model, as the paper's people carried two of each."""
    models = dict.fromkeys(d.model for d in devices)
    return [d for model in models for d in [d for d in devices if d.model == model][:each]]


def some(windows: Windows, each: int, rng: np.random.Generator) -> Windows:
    """Return `each` windows of every person, drawn."""
    rows = [rng.permutation(np.flatnonzero(windows.person == p))[:each] for p in windows.people]
    return windows.only(np.sort(np.concatenate(rows)))


def scores(windows: Windows, devices: list[Device], seed: int, progress: Progress) -> Scores:
    """Score every family and learner, trained on the reference and tested on every device and column."""
    clean = reference(windows.accel)
    trained = {False: _features(clean.samples), True: _features(resample(clean, COMMON_HZ, "linear"))}
    tested = [_columns(windows, d, seed + k, trained[False]) for k, d in enumerate(devices)]
    progress(0.3)
    masks = list(folds(windows.person, FOLDS, np.random.default_rng(seed)))
    values = []
    for f, family in enumerate(FAMILIES):
        asked = (*COLUMNS, *ONLY_FREQUENCY) if family == "frequency" else COLUMNS
        values.append(_scored(windows.label, trained, tested, family, masks, asked=asked, seed=seed))
        progress(0.3 + 0.6 * (f + 1) / len(FAMILIES))
    frequency = values[list(FAMILIES).index("frequency")]
    fewer = {common: {"time": without_counts(own["time"])} for common, own in trained.items()}
    bare = [{c: {"time": without_counts(own[c]["time"])} for c in UNCOUNTED} for own in tested]
    uncounted = _scored(windows.label, fewer, bare, "time", masks, asked=UNCOUNTED, seed=seed)
    progress(1.0)
    alike = np.array([own[:, : len(COLUMNS)] for own in values])
    return Scores(alike, frequency, _moves(tested, trained), uncounted)


Features = dict[str, Array]
"""Features (n, k) by family."""


def _scored(
    label: Labels,
    trained: dict[bool, Features],
    tested: list[dict[str, Features]],
    family: str,
    masks: list[NDArray[np.bool_]],
    *,
    asked: tuple[str, ...],
    seed: int,
) -> Array:
    """Return F1 by learner, column `asked`, device and fold, trained on clean features of the same rate."""
    values = np.zeros((len(LEARNERS), len(asked), len(tested), len(masks)))
    for fold, test in enumerate(masks):
        for k, learner in enumerate(LEARNERS.values()):
            models = {
                common: fitted(learner, features[family][~test], label[~test], seed)
                for common, features in trained.items()
            }
            for c, column in enumerate(asked):
                for d, columns in enumerate(tested):
                    predicted = models[_common(column)].predict(columns[column][family][test])
                    values[k, c, d, fold] = weighted_f1(label[test], predicted)
    return values


def _common(column: str) -> bool:
    return column.endswith("interpolated") or column == "all, both"


def _moves(tested: list[dict[str, dict[str, Array]]], trained: dict[bool, dict[str, Array]]) -> Array:
    return np.array(
        [
            [
                np.mean([displacement(trained[_common(c)][family], own[c][family]) for own in tested])
                for c in COLUMNS
            ]
            for family in FAMILIES
        ]
    )


def displacement(clean: Array, moved: Array) -> float:
    """Return how far the same windows' features (n, k) lie from clean ones, median over the features.

    Each feature's rms distance, in units of its own spread over the clean windows; those that never change
    are left out.
    """
    spread = clean.std(axis=0)
    varied = spread > 1e-9
    off = np.sqrt(np.square(moved - clean).mean(axis=0))
    return float(np.median(off[varied] / spread[varied]))


def _columns(
    windows: Windows, device: Device, seed: int, clean: dict[str, Array]
) -> dict[str, dict[str, Array]]:
    """Return the features of every column, by family."""
    model = device.calibrated(seed)
    found = {"none": clean, "none, interpolated": _mended(reference(windows.accel))}
    kinds = {"rate and uneven": Kinds(errors=False), **HARMS}
    for name, own in kinds.items():
        raw = record(windows.accel, device, own, np.random.default_rng(seed))
        found[name] = _features(raw.samples)
        if name != "all":
            found[f"{name}, interpolated"] = _mended(raw)
    fixed = Recorded(model.apply(raw.samples), raw.stamps)
    found["all, calibrated"] = _features(fixed.samples)
    found["all, interpolated"] = _features(resample(raw, COMMON_HZ, "linear"))
    found["all, both"] = _features(resample(fixed, COMMON_HZ, "linear"))
    return found


def _mended(recorded: Recorded) -> dict[str, Array]:
    """Return the frequency features of what was recorded, interpolated to the common rate."""
    return {"frequency": FAMILIES["frequency"](resample(recorded, COMMON_HZ, "linear"))}


def _features(samples: Array) -> dict[str, Array]:
    return {name: make(samples) for name, make in FAMILIES.items()}


def by_family(changes: Array) -> str:
    """Say what each family gains or loses, points (3, n), with intervals over its second axis."""
    return ", ".join(f"{name} {with_interval(changes[k])}" for k, name in enumerate(FAMILIES)) + " points"
