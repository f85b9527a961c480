"""Devices grouped by bias and steadiness of rate (Stisen et al. 2015, 5.1, Figure 11)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.replay.fleet.summary.clusters import clusters
from stillcal.replay.studies.claim import Claim, Evidence, Progress, Study, agreement, holds, picture, table
from stillcal.replay.studies.drawing import COLOURS, panels, save
from stillcal.replay.studies.har.data import without_recordings
from stillcal.replay.studies.har.recordings import DATA, Still, by_device, read_still
from stillcal.replay.studies.stisen2015.biases import G

NAME, TITLE, WORK = "clusters", "Clusters of devices (Figure 11)", "Stisen 2015"
PAPER = {
    "number": ("5.1, Figure 11", "affinity propagation on bias and steadiness of rate: clusters", "5"),
    "same": ("5.1", "phones of one model may fall into different clusters", "stated"),
}
FEATURES = ("median bias, m/s²", "sd of sampling frequency, Hz")
MORE = (*FEATURES, "sd of bias, m/s²", "median sampling frequency, Hz")
"""The paper's two features of Figure 11, and the four behind its Figure 12."""


@dataclass(frozen=True, slots=True, eq=False)
class Devices:
    """Devices lying on their backs. features: (n, 4), in the order of MORE."""

    names: tuple[str, ...]
    models: tuple[str, ...]
    features: Array


def described(recordings: list[Still]) -> Devices:
    """Describe every device on its back whose sensor works; several recordings of one count as one."""
    groups = by_device([r for r in recordings if r.face == "back" and not r.frozen and not r.reference])
    return Devices(
        tuple(groups),
        tuple(group[0].model for group in groups.values()),
        np.array([_features(group) for group in groups.values()]),
    )


def _features(recordings: list[Still]) -> list[float]:
    norms = np.concatenate([r.norms for r in recordings])
    intervals = np.concatenate([np.diff(r.creation) for r in recordings])
    frequency = 1.0 / intervals[intervals > 0.0]
    return [
        float(np.median(norms) - G),
        float(frequency.std()),
        float(norms.std()),
        float(np.median(frequency)),
    ]


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Cluster the devices as the paper did, and see how far the number of clusters depends on choices."""
    if data is None:
        return without_recordings(NAME, TITLE, [(WORK, *row) for row in PAPER.values()], seed)
    devices = described(read_still(data))
    progress(0.3)
    labels, exemplars = clusters(devices.features[:, :2], seed)
    left_out = _left_out(devices.features[:, :2], seed)
    claims = (_number(len(exemplars), left_out), _split_models(devices, labels))
    progress(0.8)
    file = _draw(devices, labels, exemplars, figures)
    return Study(NAME, TITLE, claims, _text(devices, labels, exemplars, file, seed), (file,), seed)


def _left_out(features: Array, seed: int) -> list[int]:
    return [len(clusters(np.delete(features, k, axis=0), seed)[1]) for k in range(len(features))]


def _number(found: int, left_out: list[int]) -> Claim:
    """Judge how many clusters there are. left_out: how many without each of the devices in turn."""
    return Claim(
        WORK,
        *PAPER["number"],
        str(found),
        DATA,
        agreement(5, found, 1),
        f"tolerance one cluster: with any one device left out there are {min(left_out)} to"
        f" {max(left_out)}; the paper clustered 36 devices, here {len(left_out)} lie on their backs with a"
        " working sensor",
        evidence=Evidence.REAL,
    )


def _split_models(devices: Devices, labels: NDArray[np.intp]) -> Claim:
    models = np.array(devices.models)
    several = [m for m in sorted(set(devices.models)) if np.sum(models == m) > 1]
    split = [m for m in several if len(set(labels[models == m])) > 1]
    ours = f"{len(split)} of {len(several)} models with several devices"
    return Claim(
        WORK,
        *PAPER["same"],
        ours,
        DATA,
        holds(bool(split)),
        f"split: {', '.join(split)}",
        evidence=Evidence.REAL,
    )


def _draw(devices: Devices, labels: NDArray[np.intp], exemplars: NDArray[np.intp], folder: Path) -> str:
    figure, (axis,) = panels()
    figure.set_size_inches(7.6, 4.6)
    for k, row in enumerate(exemplars):
        x, y = devices.features[labels == k, :2].T
        axis.plot(x, y, "os^Dv*"[k % 6], color=COLOURS[k % 6], markersize=8, label=_short(devices.names[row]))
        axis.plot(*devices.features[row, :2], "x", color="white", markersize=5)
    axis.set(xlabel=FEATURES[0], ylabel=FEATURES[1], title="Clusters by their exemplars (crossed)")
    axis.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return save(figure, folder, NAME)


def _short(name: str) -> str:
    return name.removeprefix("Samsung-")


def _text(
    devices: Devices, labels: NDArray[np.intp], exemplars: NDArray[np.intp], file: str, seed: int
) -> str:
    rows = []
    for k, row in enumerate(exemplars):
        members = Counter(m for m, label in zip(devices.models, labels, strict=True) if label == k)
        listed = ", ".join(f"{n} {model}" for model, n in members.most_common())
        bias, scatter = devices.features[labels == k, :2].mean(axis=0)
        rows.append((devices.names[row], f"{bias:+.2f}", f"{scatter:.1f}", listed))
    half, four = clusters(devices.features[:, :2], seed, 2.0)[1], clusters(devices.features, seed)[1]
    return "\n\n".join(
        [
            "Median bias and the sd of the sampling frequency of each device on its back, brought to unit"
            " variance; preference at the median similarity. With twice that preference there are"
            f" {len(half)} clusters, with the four features behind Figure 12 {len(four)}: the number is the"
            " algorithm's, not the devices'. Members of the paper's clusters are told by its figure only.",
            picture(file, "Devices by bias and steadiness of rate"),
            table(("exemplar", f"mean {FEATURES[0]}", f"mean {FEATURES[1]}", "members"), rows),
        ]
    )
