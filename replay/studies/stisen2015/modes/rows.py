"""Windows of everybody through every device, and how each mode of evaluation parts them.

Stisen et al. 2015, 4.2. Everybody carries every device at once, in the paper as here. A mode that leaves
out a device or a model and keeps the people therefore keeps the very motion that it tests, as other devices
recorded it. Such modes are scored both ways by the same recognisers: on windows whose motion they were
trained on, as in the paper, and on windows whose motion they never saw.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.replay.fleet.summary.clusters import clusters
from stillcal.replay.studies.har.data import ACTIVITIES, Windows
from stillcal.replay.studies.har.devices import Device
from stillcal.replay.studies.har.features import FAMILIES
from stillcal.replay.studies.har.recordings import read_still
from stillcal.replay.studies.har.scoring import LEARNERS, Labels, Learner, fitted, folds, weighted_f1
from stillcal.replay.studies.stisen2015.clusters import described
from stillcal.replay.studies.stisen2015.families import some
from stillcal.replay.studies.stisen2015.recorded import Kinds, Recorded, record

EACH, FOLDS = 12, 5
"""Windows of each person on every device; groups of people, or of windows, that are left out in turn."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Windows of everybody through every device. features by family; the rest (n,).

    window: which stretch of motion, the same through all devices. device, model, cluster: an index.
    """

    features: dict[str, Array]
    label: Labels
    person: Labels
    window: Labels
    device: Labels
    model: Labels
    cluster: Labels

    def only(self, mask: Mask) -> Rows:
        """Return the rows of a mask (n,)."""
        columns = (self.label, self.person, self.window, self.device, self.model, self.cluster)
        return Rows({name: f[mask] for name, f in self.features.items()}, *(c[mask] for c in columns))


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Rows to train a recogniser on, and those to test it on by the name of the way; masks (n,)."""

    train: Mask
    test: dict[str, Mask]


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What recognisers made of the rows that they were tested on.

    f1: weighted, (families, learners, parts). right: (families, learners, n), whether each tested row was
    judged rightly. row, part: (n,), which row that was, and by the recognisers of which part.
    """

    f1: Array
    right: Mask
    row: Labels
    part: Labels

    @property
    def mean(self) -> Array:
        """F1 by family and learner, percent."""
        return np.asarray(100.0 * self.f1.mean(axis=2))

    def by(self, group: NDArray[Any]) -> Array:
        """Return the share judged rightly by group, percent; (families, learners, groups).

        group: of each of all rows.
        """
        own = group[self.row]
        return np.stack([100.0 * self.right[..., own == g].mean(axis=2) for g in np.unique(own)], axis=2)


def record_all(windows: Windows, devices: list[Device], seed: int) -> list[Recorded]:
    """Return the windows as each device would have recorded them, all its heterogeneities on."""
    draws = [np.random.default_rng(seed + k) for k in range(len(devices))]
    return [record(windows.accel, d, Kinds(), rng) for d, rng in zip(devices, draws, strict=True)]


NINE, DENSE = 9, 16
"""People of the paper; windows of each on every device where they are as few."""


def nine_people(windows: Windows, seed: int) -> Windows:
    """Return nine people's windows, DENSE of each, drawn from all, but for those of lying.

    The paper's nine people lie nowhere; they ride a bicycle, which nobody does here.
    """
    rng = np.random.default_rng(seed)
    people = rng.permutation(windows.people)[:NINE]
    upright = windows.only(np.isin(windows.person, people)).of(*(a for a in ACTIVITIES if a != "lie"))
    return some(upright, DENSE, rng)


def of_nine(windows: Windows, devices: list[Device], labels: list[int], seed: int) -> Rows:
    """Return `nine_people` through every device."""
    few = nine_people(windows, seed)
    return gathered(few, devices, labels, [r.samples for r in record_all(few, devices, seed)])


def device_clusters(data: Path, devices: list[Device], seed: int) -> list[int]:
    """Return the cluster of each device, of those of all still devices by the features of Figure 12."""
    still = described(read_still(data))
    labels = clusters(still.features, seed)[0]
    return [int(labels[still.names.index(d.name)]) for d in devices]


def gathered(windows: Windows, devices: list[Device], labels: list[int], samples: list[Array]) -> Rows:
    """Put the windows of all devices end to end."""
    n, models = len(windows), sorted({d.model for d in devices})
    families = [{name: make(values) for name, make in FAMILIES.items()} for values in samples]
    return Rows(
        {name: np.concatenate([f[name] for f in families]) for name in FAMILIES},
        np.tile(windows.label, len(devices)),
        np.tile(windows.person, len(devices)),
        np.tile(np.arange(n), len(devices)),
        np.repeat(np.arange(len(devices)), n),
        np.repeat([models.index(d.model) for d in devices], n),
        np.repeat(labels, n),
    )


Pairs = Iterator[tuple[Mask, Mask]]
"""Rows of the devices that are trained on, and of those that are tested."""


def _everything(rows: Rows) -> Pairs:
    every = np.ones_like(rows.device, dtype=np.bool_)
    yield every, every


def _model_out(rows: Rows) -> Pairs:
    yield from ((rows.model != m, rows.model == m) for m in np.unique(rows.model))


def _one_model(rows: Rows) -> Pairs:
    yield from ((rows.model == m, rows.model != m) for m in np.unique(rows.model))


def _cluster(rows: Rows) -> Pairs:
    yield from ((rows.cluster == c, rows.cluster == c) for c in np.unique(rows.cluster))


def _other_clusters(rows: Rows) -> Pairs:
    yield from ((rows.cluster != c, rows.cluster == c) for c in np.unique(rows.cluster))


def _device_out(rows: Rows, *groups: Labels) -> Pairs:
    """Leave out each device that has another one in each of its `groups`; train on those of the first."""
    for device in np.unique(rows.device):
        test = rows.device == device
        own = [(group == group[test][0]) & ~test for group in groups]
        if all(others.any() for others in own):
            yield own[0], test


DEVICES: dict[str, Callable[[Rows], Pairs]] = {
    "user out": _everything,
    "model out": _model_out,
    "one model": _one_model,
    "intra-model, device out": lambda rows: _device_out(rows, rows.model),
    "user and model out": _model_out,
    "one model, user out": _one_model,
    "cluster, user out": _cluster,
    "other clusters, user out": _other_clusters,
    "cluster, user and device out": lambda rows: _device_out(rows, rows.cluster, rows.model),
    "model, user and device out": lambda rows: _device_out(rows, rows.model, rows.cluster),
    "device out": lambda rows: _device_out(rows, 0 * rows.cluster, rows.cluster),
    "device out, within cluster": lambda rows: _device_out(rows, rows.cluster),
}
"""What the paper's modes, but for ten-fold, do with the devices."""

PEOPLE_KEPT = (
    "model out",
    "one model",
    "intra-model, device out",
    "device out",
    "device out, within cluster",
)
"""Modes whose people are in both parts, and with them the motion that is tested."""


def other_windows(mode: str) -> str:
    """Name the way in which a mode of PEOPLE_KEPT is tested on motion that was not trained on."""
    return f"{mode}, other windows"


def splits(rows: Rows, mode: str, seed: int, number: int = FOLDS) -> Iterator[Part]:
    """Yield what a mode trains on and tests, once for each of `number` groups of people or of windows.

    Where people are kept, a group of windows is not trained on. It is what the way `other_windows` tests; the
    next group, which was trained on through other devices, is what the mode itself tests.
    """
    rng = np.random.default_rng(seed)
    if mode == "ten-fold":
        group = rng.permutation(len(rows.label)) % 10
        yield from (Part(group != k, {mode: group == k}) for k in range(10))
    elif mode in PEOPLE_KEPT:
        windows, place = np.unique(rows.window, return_inverse=True)
        group = (rng.permutation(len(windows)) % number)[place]
        for train, test in DEVICES[mode](rows):
            for k in range(number):
                ways = {mode: test & (group == (k + 1) % number), other_windows(mode): test & (group == k)}
                yield Part(train & (group != k), ways)
    else:
        for out in folds(rows.person, number, rng):
            yield from (Part(train & ~out, {mode: test & out}) for train, test in DEVICES[mode](rows))


def judge(
    rows: Rows,
    parts: list[Part],
    seed: int,
    learners: Mapping[str, Learner] = LEARNERS,
    *,
    most: int | None = None,
) -> dict[str, Judged]:
    """Train every family and learner on each part, and test them; by way.

    most: rows that a recogniser is trained on at most, drawn. The rows tested depend on `parts` alone, so two
    treatments can be paired row by row.
    """
    ways = list(parts[0].test)
    f1 = {way: np.zeros((len(rows.features), len(learners), len(parts))) for way in ways}
    right: dict[str, list[list[list[Mask]]]] = {
        way: [[[] for _ in learners] for _ in rows.features] for way in ways
    }
    for s, part in enumerate(parts):
        train = np.random.default_rng(seed + s).permutation(np.flatnonzero(part.train))[:most]
        for f, features in enumerate(rows.features.values()):
            for k, learner in enumerate(learners.values()):
                model = fitted(learner, features[train], rows.label[train], seed + s)
                for way, test in part.test.items():
                    predicted = model.predict(features[test])
                    f1[way][f, k, s] = weighted_f1(rows.label[test], predicted)
                    right[way][f][k].append(predicted == rows.label[test])
    return {way: Judged(f1[way], *_joined(right[way], [p.test[way] for p in parts])) for way in ways}


def _joined(right: list[list[list[Mask]]], tests: list[Mask]) -> tuple[Mask, Labels, Labels]:
    together = np.array([[np.concatenate(parts) for parts in family] for family in right], dtype=np.bool_)
    row = np.concatenate([np.flatnonzero(test) for test in tests])
    return together, row, np.repeat(np.arange(len(tests)), [int(test.sum()) for test in tests])


def together(rows: Rows, families: tuple[str, ...]) -> Rows:
    """Return the rows with the features of some families side by side, as one family."""
    joined = np.concatenate([rows.features[name] for name in families], axis=1)
    return replace(rows, features={" and ".join(families): joined})
