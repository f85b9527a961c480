"""Slices of activity through devices, and the accuracy of classifiers on them by way (Tables 6 and 7).

Grammenos et al. 2018, 5.2: forty samples a slice, fed as they are; people left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.smoothing import RollingMean
from stillcal.replay.studies.grammenos2018.kalman import settled
from stillcal.replay.studies.har.data import RATE_HZ, Windows
from stillcal.replay.studies.har.devices import Device
from stillcal.replay.studies.har.scoring import Labels, Learner, by_person, fitted, folds

SLICE, FOLDS, MOST = 40, 5, 900
"""Samples a slice; folds by people; slices a classifier is trained on at most, drawn."""

WAYS = ("raw", "calibrated and filtered", "calibrated", "filtered", "Kalman", "no errors")
METHOD = "calibrated and filtered"
"""The paper's method whole: the calibration, then the rolling mean of 4.6 with Table 2's window for 50 Hz."""

Q_OVER_R = 1.0
"""The filter's: a gain of 0.62, which at 50 Hz leaves what is below 5 Hz nearly as it is."""

LOUDER = 5.0
"""Times the measured errors that devices are given to find a cause."""


@dataclass(frozen=True, slots=True, eq=False)
class Slices:
    """Slices of 40 samples (n, 40, 3) by way, with who, what, and through which device."""

    ways: dict[str, Array]
    label: Labels
    person: Labels
    device: Labels

    def features(self, way: str, make: Callable[[Array], Array]) -> Array:
        """Return features (n, k) of the slices after one way."""
        return make(self.ways[way])


@dataclass(frozen=True, slots=True, eq=False)
class Accuracy:
    """Accuracy by way, in WAYS' order. values: (people, ways). known: (ways,), on the slices trained on."""

    values: Array
    known: Array

    def gain(self, way: str) -> Array:
        """Return what a way gains over raw, by person, percentage points."""
        return np.asarray(100.0 * (self.values[:, WAYS.index(way)] - self.values[:, 0]))

    def by_way(self, way: str) -> Array:
        """Return the accuracy of a way, by person, percent."""
        return np.asarray(100.0 * self.values[:, WAYS.index(way)])


def slices(windows: Windows, devices: list[Device], seed: int, length: int = SLICE) -> Slices:
    """Carry every window through one device drawn for it and cut its last 120 samples into slices."""
    rng = np.random.default_rng(seed)
    device = rng.integers(0, len(devices), len(windows))
    raw, fixed = np.empty_like(windows.accel), np.empty_like(windows.accel)
    for k, d in enumerate(devices):
        rows = device == k
        raw[rows] = d.carry(windows.accel[rows], rng)
        fixed[rows] = d.calibrated(seed + k).apply(raw[rows])
    ways = {
        "raw": raw,
        METHOD: filtered(fixed),
        "calibrated": fixed,
        "filtered": filtered(raw),
        "Kalman": settled(raw, Q_OVER_R, 1.0),
        "no errors": windows.accel,
    }
    cut = {way: values[:, -3 * SLICE :].reshape(-1, length, 3) for way, values in ways.items()}
    return Slices(cut, *(np.repeat(c, 3 * SLICE // length) for c in (windows.label, windows.person, device)))


def louder(device: Device) -> Device:
    """Return the device with LOUDER times its errors."""
    return replace(
        device, forward=np.eye(3) + LOUDER * (device.forward - np.eye(3)), bias=LOUDER * device.bias
    )


def scattered(data: Slices, seed: int) -> Slices:
    """Return the slices with people drawn anew for each, so that everybody is in every part."""
    people = len(np.unique(data.person))
    return replace(data, person=np.random.default_rng(seed).integers(0, people, len(data.label)))


def filtered(windows: Array) -> Array:
    """Return windows (n, length, 3) at 50 Hz after the causal rolling mean of 4.6, of the same shape.

    The first samples are means of as many as there are; they lie before the slices that are cut.
    """
    return np.stack([RollingMean(RATE_HZ).smoothed(w) for w in windows])


def flat(windows: Array) -> Array:
    """Return the slices' samples as they are, (n, 120)."""
    return windows.reshape(len(windows), -1)


def tilt(windows: Array) -> Array:
    """Return which way is up in each slice, two angles in rad, and its mean norm in m/s^2; (n, 3)."""
    mean = windows.mean(axis=1)
    size = np.linalg.norm(mean, axis=1)
    angles = [np.arcsin(np.clip(mean[:, axis] / size, -1.0, 1.0)) for axis in (1, 2)]
    return np.stack([*angles, np.linalg.norm(windows, axis=2).mean(axis=1)], axis=1)


def compare(
    data: Slices,
    learner: Learner,
    make: Callable[[Array], Array],
    seed: int,
    other_device: bool,
    *,
    ways: tuple[str, ...] = WAYS,
    most: int = MOST,
) -> Accuracy:
    """Score all ways on the same folds by people; with `other_device`, trained on one and tested on the rest.

    In the latter, each fold trains on the slices of one fifth of the devices, and tests on the others'.
    """
    right, known_right = np.full((len(data.label), len(ways)), np.nan), np.zeros((FOLDS, len(ways)))
    rng = np.random.default_rng(seed)
    devices = rng.permutation(np.unique(data.device))
    for k, test in enumerate(folds(data.person, FOLDS, rng)):
        known = np.isin(data.device, devices[k::FOLDS])
        train = ~test & known if other_device else ~test
        asked = test & ~known if other_device else test
        chosen = rng.permutation(np.flatnonzero(train))[:most]
        for w, way in enumerate(ways):
            features = data.features(way, make)
            model = fitted(learner, features[chosen], data.label[chosen], seed)
            right[asked, w] = model.predict(features[asked]) == data.label[asked]
            known_right[k, w] = np.mean(model.predict(features[chosen]) == data.label[chosen])
    seen = np.isfinite(right[:, 0])
    return Accuracy(
        np.stack([by_person(right[seen, w], data.person[seen]) for w in range(len(ways))], axis=1),
        known_right.mean(axis=0),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Roc:
    """ROC curves, raw, by the method and without errors, people left out. false, true: shares (n,) by way.

    areas: under each person's own curve, by way, (people, 3).
    """

    false: tuple[Array, ...]
    true: tuple[Array, ...]
    areas: Array


def roc(data: Slices, learner: Learner, seed: int) -> Roc:
    """Score a classifier of two activities by its probability of the second, on the folds of `compare`."""
    from sklearn.metrics import roc_auc_score, roc_curve  # noqa: PLC0415 - an extra

    rng = np.random.default_rng(seed)
    rng.permutation(np.unique(data.device))  # as `compare` draws it, so that the folds are the same
    positive = data.label == np.unique(data.label)[1]
    ways = ("raw", METHOD, "no errors")
    score = np.zeros((len(data.label), len(ways)))
    for test in folds(data.person, FOLDS, rng):
        chosen = rng.permutation(np.flatnonzero(~test))[:MOST]
        for w, way in enumerate(ways):
            features = data.features(way, flat)
            model = fitted(learner, features[chosen], data.label[chosen], seed)
            score[test, w] = model.predict_proba(features[test])[:, 1]
    curves = [roc_curve(positive, score[:, w]) for w in range(len(ways))]
    areas = [
        [float(roc_auc_score(positive[own], score[own, w])) for w in range(len(ways))]
        for own in (data.person == p for p in np.unique(data.person))
    ]
    return Roc(tuple(c[0] for c in curves), tuple(c[1] for c in curves), np.array(areas))
