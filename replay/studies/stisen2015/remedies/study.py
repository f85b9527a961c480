"""What calibration, clustering and interpolation give back (Stisen et al. 2015, 5, Figures 13 to 15)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from stillcal.replay.studies.claim import Progress, Study, picture, table
from stillcal.replay.studies.drawing import COLOURS, panels, save
from stillcal.replay.studies.har.data import read_windows, without_recordings
from stillcal.replay.studies.har.devices import CARRIED, read_devices
from stillcal.replay.studies.har.features import FAMILIES
from stillcal.replay.studies.stisen2015.families import COMMON_HZ, by_family, few_devices, some
from stillcal.replay.studies.stisen2015.modes.rows import EACH, device_clusters, record_all
from stillcal.replay.studies.stisen2015.recorded import METHODS, RATES_HZ
from stillcal.replay.studies.stisen2015.remedies.causes import MOST, OUT, tried
from stillcal.replay.studies.stisen2015.remedies.claims import PAPER, WORK, judged
from stillcal.replay.studies.stisen2015.remedies.scores import TESTS, UNKNOWN, Found, score_all
from stillcal.replay.studies.stisen2015.remedies.treated import WAYS, Carried

NAME, TITLE = "remedies", "What calibration, clustering and interpolation give back (Figures 13 to 15)"


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Score every remedy on unknown models, people and devices, all heterogeneities on."""
    if data is None:
        return without_recordings(NAME, TITLE, [(WORK, *row) for row in PAPER.values()], seed)
    devices = few_devices(read_devices(data))
    windows = some(read_windows(data), EACH, np.random.default_rng(seed))
    recorded = record_all(windows, devices, seed)
    carried = Carried(windows, devices, device_clusters(data, devices, seed), recorded, seed)
    rows = {way: carried.rows(way) for way in WAYS}
    progress(0.1)
    causes = tried(carried, rows, read_windows(data))
    progress(0.3)
    found = score_all(carried, rows, causes, progress)
    words = f"{CARRIED.format(len(devices))}, their rates and stamps; {len(windows)} windows on each"
    claims = tuple(replace(c, data=words) for c in judged(found))
    file = _draw(found, figures)
    return Study(NAME, TITLE, claims, _text(found, file), (file,), seed)


def _draw(found: Found, folder: Path) -> str:
    figure, (left, right) = panels(2)
    place = np.arange(len(WAYS) - 1)
    for f, family in enumerate(FAMILIES):
        gains = [found.gain(OUT, way)[f].mean() for way in WAYS[1:]]
        left.bar(place + 0.27 * (f - 1), gains, 0.26, color=COLOURS[f], label=family)
        other = [found.gain(UNKNOWN[1], way)[f].mean() for way in WAYS[1:]]
        left.plot(place + 0.27 * (f - 1), other, "k_", label="other windows" if f == 0 else None)
    left.axhline(0.0, color="black", linewidth=0.8)
    left.set_xticks(place, [w.replace(" and ", "\nand ") for w in WAYS[1:]], rotation=35, ha="right")
    left.set(ylabel="gain of F1 over raw, points", title="A model out, mean of learners")
    left.legend()
    for m, method in enumerate(METHODS):
        for test, line in zip(UNKNOWN, ("o-", "o:"), strict=True):
            f1 = [found.sweep[test, method, rate] for rate in RATES_HZ]
            right.plot(RATES_HZ, f1, line, color=COLOURS[m], label=method if test == OUT else None)
    for test, line in zip(UNKNOWN, ("-", ":"), strict=True):
        right.axhline(found.sweep[test, "raw", 0.0], color="0.5", linestyle=line)
    right.plot([], [], "-", color="0.5", label="no interpolation")
    right.plot([], [], "k:", label="other windows")
    right.set(xlabel="target rate, Hz", ylabel="F1, %", title="SVM on frequency, model out (Fig. 13)")
    right.legend(fontsize="small", ncols=2)
    return save(figure, folder, NAME)


def _text(found: Found, file: str) -> str:
    rows = [
        (test, family, f"{found.scores[test, 'raw'][f].mean():.1f}",
         *(f"{found.gain(test, way)[f].mean():+.1f}" for way in WAYS[1:]))
        for test in TESTS
        for f, family in enumerate(FAMILIES)
    ]  # fmt: skip
    figure_13 = [
        (test, method, *(f"{found.sweep[test, method, rate]:.1f}" for rate in RATES_HZ))
        for test in UNKNOWN
        for method in METHODS
    ]
    none = [found.sweep[test, "raw", 0.0] for test in UNKNOWN]
    same, other = (by_family(own.mean(axis=1)) for own in found.clustering())
    return "\n\n".join(
        [
            "Devices and windows as in `modes`, all heterogeneities on: weighted F1 as recorded, and points"
            f" gained by each remedy, mean of the four learners, each trained on {MOST} rows at most."
            f" Interpolation is to {COMMON_HZ:.0f} Hz. *Model out* and *device out* leave the people in both"
            " parts, and with them their motion, as the paper does, whose people carried all devices at once."
            " So they are shown both ways, by the same recognisers: trained on half of the windows, and"
            " tested"
            " on that half as the device left out recorded it, and on the other half (*other windows*). *User"
            " out* leaves a fifth of the people out.",
            picture(file, "F1 gained by remedy and family; interpolation by method and rate"),
            table(("split", "features", "raw, %", *WAYS[1:]), rows),
            f"Clustering, trained on its cluster instead of on all: {same}; other windows: {other}.",
            "SVM on frequency features with a model left out (Figure 13):"
            f" {none[0]:.1f} % without interpolation ({none[1]:.1f} % on other windows); with it, by target"
            " rate:",
            table(("split", "method", *(f"{rate:.0f} Hz" for rate in RATES_HZ)), figure_13),
        ]
    )
