"""Recognisers tested on people and devices they were not trained on (Stisen et al. 2015, Figures 5 to 12)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from stillcal.replay.studies.claim import Evidence, Progress, Study, picture, table
from stillcal.replay.studies.drawing import COLOURS, panels, save
from stillcal.replay.studies.har.data import read_windows, without_recordings
from stillcal.replay.studies.har.devices import CARRIED, Device, read_devices
from stillcal.replay.studies.har.features import FAMILIES, frequency_by_axis
from stillcal.replay.studies.har.scoring import INDEPENDENT, LEARNERS
from stillcal.replay.studies.stisen2015.families import few_devices, some
from stillcal.replay.studies.stisen2015.modes.claims import AVERAGES, WORK, averages
from stillcal.replay.studies.stisen2015.modes.learners import COMPARED, comparisons
from stillcal.replay.studies.stisen2015.modes.rows import (
    EACH,
    FOLDS,
    device_clusters,
    gathered,
    of_nine,
    other_windows,
    record_all,
)
from stillcal.replay.studies.stisen2015.modes.scores import (
    DRAWS,
    FIGURE_5,
    FIGURE_12,
    INTRA,
    Altered,
    Found,
    measure,
    paired,
    ways,
)

NAME, TITLE = "modes", "Unknown people, unknown devices (Figures 5 to 12)"
PAPER = {**AVERAGES, **COMPARED}
TOGETHER = "all three"


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Run the paper's modes of evaluation with all heterogeneities on."""
    if data is None:
        return without_recordings(NAME, TITLE, [(WORK, *row) for row in PAPER.values()], seed)
    devices = few_devices(read_devices(data))
    windows = some(read_windows(data), EACH, np.random.default_rng(seed))
    recorded = record_all(windows, devices, seed)
    labels = device_clusters(data, devices, seed)
    rows = gathered(windows, devices, labels, [r.samples for r in recorded])
    everybody = read_windows(data)
    nine = [of_nine(everybody, devices, labels, seed + k) for k in range(DRAWS)]
    by_axis = np.concatenate([frequency_by_axis(r.samples) for r in recorded])
    altered = Altered(nine, replace(rows, features={"frequency": by_axis}), [d.rate_hz for d in devices])
    found = measure(rows, altered, seed, progress)
    carried = f"{CARRIED.format(len(devices))}, their rates and stamps; {len(windows)} windows on each"
    claims = tuple(
        c if c.evidence is Evidence.NONE else replace(c, data=carried)
        for c in (*averages(found), *comparisons(found))
    )
    file = _draw(found, figures)
    return Study(NAME, TITLE, claims, _text(found, devices, labels, file), (file,), seed)


def _draw(found: Found, folder: Path) -> str:
    figure, (left,) = panels(1)
    figure.set_size_inches(9.6, 4.2)
    asked = (*ways(*FIGURE_5), FIGURE_12[0])
    place = np.arange(len(asked))
    for f, family in enumerate(FAMILIES):
        heights = [found.f1(way)[f].mean() for way in asked]
        left.bar(place + 0.2 * (f - 1.5), heights, 0.19, color=COLOURS[f], label=family)
    heights = [found.together[way].mean() for way in asked[:-1]]
    left.bar(place[:-1] + 0.3, heights, 0.19, color=COLOURS[len(FAMILIES)], label=TOGETHER)
    left.set_xticks(place, [way.replace(", ", ",\n").replace(" and ", "\nand ") for way in asked], fontsize=7)
    left.set(ylabel="F1, mean of learners, %", title="All heterogeneities on")
    left.set_ylim(0, 112)
    left.legend(fontsize=7, ncols=4)
    return save(figure, folder, NAME)


def _text(found: Found, devices: list[Device], labels: list[int], file: str) -> str:
    rows = [
        (way, family, *(f"{v:.1f}" for v in values))
        for way in ways(*FIGURE_5, *FIGURE_12)
        for family, values in zip(
            (*FAMILIES, TOGETHER), (*found.f1(way), found.together.get(way)), strict=True
        )
        if values is not None
    ]
    members = ", ".join(f"{d.name} in {k}" for d, k in zip(devices, labels, strict=True))
    n = len(np.unique(found.rows.window))
    return "\n\n".join(
        [
            f"{n} windows of thirty people through each of {len(devices)} devices, errors, rates and uneven"
            " sampling on: as if each had carried all of them. Modes that leave people out leave out a"
            " fifth of"
            " them in turn, and train on all other rows that the mode allows. Clusters are those of all still"
            f" devices by the four features behind Figure 12, rate among them: {members}.",
            "A mode that keeps the people keeps their motion too: everybody carried all devices at once,"
            " in the"
            " paper as here, so a window that is tested through one device is trained on through another."
            " Such"
            f" modes are shown both ways, by the same recognisers, trained on {FOLDS - 1} of {FOLDS}"
            " groups of"
            " windows: tested on a group that was trained on (as the paper does), and on the one that was not"
            " (*other windows*).",
            picture(file, "F1 by mode and family"),
            table(("mode", "features", *LEARNERS), rows),
            "Trained on the device's own model against another model, McNemar's p by recogniser."
            f" {INDEPENDENT},"
            " nor is one window through several devices; so no two recognisers are put together:",
            table(("tested on", "features", *LEARNERS), _p_values(found)),
        ]
    )


def _p_values(found: Found) -> list[tuple[str, ...]]:
    pairs = {
        "windows trained on": (INTRA, "one model"),
        "other windows": (other_windows(INTRA), other_windows("one model")),
    }
    p = {
        words: paired(found.judged[a], found.judged[b], found.rows.window) for words, (a, b) in pairs.items()
    }
    return [
        (words, family, *(f"{abs(v):.1g}{'' if v >= 0.0 else ' (loses)'}" for v in values))
        for words, own in p.items()
        for family, values in zip(FAMILIES, own, strict=True)
    ]
