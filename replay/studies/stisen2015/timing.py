"""Still devices: how evenly their samples come (Stisen et al. 2015, 3.2-3.3, Table 1, Figures 2 and 3)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.formats.trace import open_trace
from stillcal.replay.studies.claim import (
    Cause,
    Claim,
    Evidence,
    Progress,
    Study,
    Verdict,
    holds,
    picture,
    table,
)
from stillcal.replay.studies.drawing import BLUE, GREEN, panels, save
from stillcal.replay.studies.har.data import without_recordings
from stillcal.replay.studies.har.recordings import DATA, Still, read_still

NAME, TITLE, WORK = "intervals", "Intervals between samples (Table 1, Figures 2 and 3)", "Stisen 2015"

RATES_HZ = {
    "LG_G-Watch": 200.0,
    "Samsung-Galaxy-Gear": 100.0,
    "iphone-6_s": 100.0,
    "Samsung-Galaxy-Pocket+": 100.0,
    "Samsung-Galaxy-S3 Mini": 100.0,
    "LG-Nexus4": 200.0,
    "Samsung-Galaxy-S3": 150.0,
    "Samsung-Galaxy-Nexus": 125.0,
    "Samsung-Galaxy-S+": 50.0,
    "LG-Optimus-2X": 100.0,
    "HTC-Desire": 50.0,
    "HTC-Nexus-One": 25.0,
    "Samsung-Galaxy-Tab10.1": 100.0,
}
"""Table 1: highest accelerometer rate by model, under the names of the recordings."""

PAPER = {
    "rates": ("3.3, Table 1", "most models' median interval is near their nominal rate's", "stated"),
    "arrival": (
        "3.3, Figure 2a",
        "arrival scatters more than creation, prominently the LG Nexus 4",
        "stated",
    ),
    "outliers": ("3.3, Figure 2a", "intervals beyond the whiskers are not overly many", "not overly many"),
    "means": ("3.3, Figure 2a", "for many devices the mean interval lies far from the median", "many"),
    "iphone": ("3.3", "an iPhone suspends the app: a few very long intervals", "stated"),
    "load": ("3.3, Figure 2b", "under load the Nexus 4's median interval grows from 5.2 to 9.7 ms", "1.87"),
    "Nexus 4": (
        "3.3, Figure 3",
        "as the accelerometer's, the gyroscope's intervals scatter more by arrival: Nexus 4",
        "more",
    ),
    "Gear": (
        "3.3, Figure 3",
        "as the accelerometer's, the gyroscope's intervals scatter more by arrival: Gear",
        "even more",
    ),
}

FEW, MANY = 0.05, 1.0 / 3.0
"""Share of intervals that is not overly many; share of models that is many."""

FAR = 1.1
"""Times its median that a mean is far from it."""

AT_REST = {"Nexus 4": "LG-Nexus4", "Gear": "Samsung-Galaxy-Gear"}
"""The devices of the activity recordings by their models in the still experiment."""

LOST = 3.0
"""Medians of an interval beyond which samples were lost."""

PAUSE_MS = 1000.0
"""Longer intervals in the activity recordings lie between exercises."""


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """Intervals of one model by creation and by arrival, ms, (n,) each."""

    creation: Array
    arrival: Array

    @property
    def scatter(self) -> tuple[float, float]:
        """Standard deviation by creation and by arrival, ms."""
        return float(self.creation.std()), float(self.arrival.std())


def by_model(recordings: list[Still]) -> dict[str, Intervals]:
    """Pool the intervals of each model's recordings."""
    models = sorted({r.model for r in recordings})
    return {
        model: Intervals(
            np.concatenate([1e3 * np.diff(r.creation) for r in recordings if r.model == model]),
            np.concatenate([1e3 * np.diff(r.arrival) for r in recordings if r.model == model]),
        )
        for model in models
    }


def outliers(intervals: Array) -> NDArray[np.bool_]:
    """Tell which of (n,) lie beyond 1.5 interquartile ranges of the quartiles (Tukey's whiskers)."""
    low, high = np.percentile(intervals, [25, 75])
    reach = 1.5 * (high - low)
    return np.asarray((intervals < low - reach) | (intervals > high + reach), dtype=np.bool_)


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Compare the intervals of devices lying on their backs with what the paper says of them."""
    if data is None:
        return without_recordings(NAME, TITLE, [(WORK, *row) for row in PAPER.values()], seed)
    recordings = [r for r in read_still(data) if not r.reference]
    found = by_model([r for r in recordings if r.face == "back"])
    spreads = {model: both_stamps(own) for model, own in found.items()}
    progress(0.5)
    both = {name: _sensors(data / "hhar" / kind) for name, kind in (("Nexus 4", "Phones"), ("Gear", "Watch"))}
    claims = (
        _rates(spreads),
        _arrival(spreads),
        *_outliers(spreads),
        _iphone(spreads),
        Claim(
            WORK,
            *PAPER["load"],
            "",
            "none",
            Verdict.UNTESTED,
            "no recording was made under load among these",
            evidence=Evidence.NONE,
        ),
        *(
            _gyro(name, both_stamps(a), both_stamps(g), spreads[AT_REST[name]][0].longest)
            for name, (a, g) in both.items()
        ),
    )
    file = _draw(found, figures)
    progress(1.0)
    return Study(NAME, TITLE, claims, _text(found, file), (file,), seed)


def _sensors(folder: Path) -> tuple[Intervals, Intervals]:
    """Return the intervals of accelerometer and gyroscope of the short activity recordings."""
    path = folder.parent / f"{folder.name}_accelerometer.csv.gz"
    parts = list(open_trace(path, "hhar").chunks())
    return _of([p.accelerometer for p in parts]), _of([p.gyroscope for p in parts])


def _of(blocks: list[Samples]) -> Intervals:
    samples = Samples.joined([b for b in blocks if len(b)])
    assert samples.t_arrival is not None, "this format has both stamps"
    made, came = 1e3 * np.diff(samples.t), 1e3 * np.diff(samples.t_arrival)
    return Intervals(made[made < PAUSE_MS], came[came < PAUSE_MS])


def _claim(
    key: str, ours: str, good: bool, because: str, *, data: str = DATA, cause: Cause | None = None
) -> Claim:
    return Claim(WORK, *PAPER[key], ours, data, holds(good), because, evidence=Evidence.REAL, cause=cause)


@dataclass(frozen=True, slots=True)
class Spread:
    """How the intervals of one model, of one kind of stamp, are spread, ms.

    number: of intervals. box: from the lower to the upper quartile. beyond: how many lie beyond the whiskers;
    near: of those, within half a median of it. long: how many are longer than 1.5 medians. outside: whether
    the mean lies outside of the quartiles. steady: the standard deviation of those up to LOST medians.
    lost: share of those beyond.
    """

    number: int
    median: float
    mean: float
    sd: float
    box: float
    longest: float
    beyond: int
    near: int
    long: int
    outside: bool
    steady: float
    lost: float


def spread(intervals: Array) -> Spread:
    """Describe intervals (n,), ms."""
    median, far = float(np.median(intervals)), outliers(intervals)
    off = intervals / median - 1.0
    low, high = np.percentile(intervals, [25, 75])
    return Spread(
        number=len(intervals),
        median=median,
        mean=float(intervals.mean()),
        sd=float(intervals.std()),
        box=float(high - low),
        longest=float(intervals.max()),
        beyond=int(far.sum()),
        near=int(np.sum(np.abs(off[far]) < 0.5)),
        long=int(np.sum(off > 0.5)),
        outside=not bool(low <= intervals.mean() <= high),
        steady=float(intervals[intervals <= LOST * median].std()),
        lost=float(np.mean(intervals > LOST * median)),
    )


BothStamps = tuple[Spread, Spread]
"""By creation and by arrival."""


def both_stamps(intervals: Intervals) -> BothStamps:
    """Describe the intervals by both kinds of stamps."""
    return spread(intervals.creation), spread(intervals.arrival)


def _rates(found: dict[str, BothStamps]) -> Claim:
    ratios = {
        model: made.median * RATES_HZ[model] / 1e3 for model, (made, _) in found.items() if model in RATES_HZ
    }
    off = [f"{model} {ratio:.2f} times" for model, ratio in ratios.items() if abs(ratio - 1) > 0.1]
    near = len(ratios) - len(off)
    why = f"most: more than half; near: within 10 %; not: {', '.join(off) or 'none'}"
    return _claim("rates", f"{near} of {len(ratios)} models", near > len(ratios) / 2, why)


def _arrival(found: dict[str, BothStamps]) -> Claim:
    more = [model for model, (made, came) in found.items() if came.sd > made.sd]
    ratio = {model: came.sd / made.sd for model, (made, came) in found.items() if "iphone" not in model}
    most = max(ratio, key=lambda m: ratio[m])
    made, came = found["LG-Nexus4"]
    why = (
        "holds where arrival's sd is larger for more than half of the models and the Nexus 4's for certain;"
        f" the largest ratio but for the suspended iPhones is {ratio[most]:.0f} ({most})"
    )
    ours = f"{len(more)} of {len(found)} models; Nexus 4: {made.sd:.2f} and {came.sd:.2f} ms"
    return _claim("arrival", ours, len(more) > len(found) / 2 and came.sd > made.sd, why)


def _outliers(found: dict[str, BothStamps]) -> list[Claim]:
    made, came = ([stamps[k] for stamps in found.values()] for k in (0, 1))
    number, beyond = sum(i.number for i in made), sum(i.beyond for i in made)
    arrival = sum(i.beyond for i in came) / sum(i.number for i in came)
    small, long = sum(i.near for i in made) / max(beyond, 1), sum(i.long for i in made) / number
    most = {m: i.beyond / i.number for m, i in zip(found, made, strict=True)}
    model = max(most, key=lambda m: most[m])
    far = [m for m, i in zip(found, made, strict=True) if i.mean > FAR * i.median]
    outside = [sum(i.outside for i in kind) for kind in (made, came)]
    return [
        _claim(
            "outliers",
            f"{beyond / number:.1%} of intervals; {model} {most[model]:.0%}",
            beyond / number <= FEW,
            f"by creation ({arrival:.1%} by arrival); holds up to {FEW:.0%}, seven times what a normal"
            " distribution has",
            cause=Cause(
                f"of those beyond the whiskers {small:.0%} are within half a median of it: the boxes of"
                " steady"
                " devices are so narrow that a tick of their clock lies outside. Longer than 1.5 medians are"
                f" {long:.1%} of all intervals, and long ones are few",
                shown=small > 0.5 and long <= FEW,
            ),
        ),
        _claim(
            "means",
            f"{len(far)} of {len(found)} models",
            len(far) >= MANY * len(found),
            f"many: a third of the models or more; far: over {FAR:g} times the median; so are"
            f" {', '.join(far) or 'none'}",
            cause=Cause(
                "the paper reads it from box plots, where a mean is seen outside of its box. It is so for"
                f" {outside[0]} of {len(found)} models by creation, {outside[1]} by arrival",
                shown=max(outside) >= MANY * len(found),
            ),
        ),
    ]


def _iphone(found: dict[str, BothStamps]) -> Claim:
    longest = {model: came.longest / 1e3 for model, (_, came) in found.items()}
    others = max(value for model, value in longest.items() if "iphone" not in model)
    ours = f"{longest['iphone-6_s']:.0f} s at the longest; other models {others:.2f} s"
    why = "holds where the longest is over 1 s and ten times that of any other model"
    return _claim("iphone", ours, longest["iphone-6_s"] > max(1.0, 10 * others), why)


def _gyro(name: str, accelerometer: BothStamps, gyroscope: BothStamps, at_rest: float) -> Claim:
    """Compare the scatter of both sensors of one device, by creation and by arrival.

    at_rest: the longest interval of its model by creation in the still experiment, ms.
    """
    (made, came), (turned, turned_came) = accelerometer, gyroscope
    return _claim(
        name,
        f"{made.sd:.2f} by creation, {came.sd:.2f} ms by arrival; gyroscope {turned.sd:.2f},"
        f" {turned_came.sd:.2f} ms",
        came.sd > made.sd and turned_came.sd > turned.sd,
        "sd, pauses of 1 s and more left out; holds where arrival's is larger for both sensors. One device in"
        " activity: the still experiment has no gyroscope here",
        data="hhar: first 10,000 rows of each sensor",
        cause=Cause(
            f"gaps of up to {made.longest:.0f} ms, which widen both stamps alike; at rest its accelerometer"
            f" has none over {at_rest:.0f} ms. Without intervals over {LOST:g} medians,"
            f" {max(made.lost, turned.lost):.1%} of them, {made.steady:.2f} by creation, {came.steady:.2f} ms"
            f" by arrival; gyroscope {turned.steady:.2f}, {turned_came.steady:.2f} ms",
            shown=came.steady > made.steady and turned_came.steady > turned.steady,
        ),
    )


def _draw(found: dict[str, Intervals], folder: Path) -> str:
    figure, axes = panels(2, sharey=True)
    figure.set_size_inches(9.6, 5.2)
    for axis, cut in zip(axes, (True, False), strict=True):
        for shift, colour, kind in ((-0.18, BLUE, "creation"), (0.18, GREEN, "arrival")):
            boxes = [_box(getattr(i, kind), cut) for i in found.values()]
            style = {"color": colour}
            axis.bxp(
                boxes,
                positions=np.arange(len(found)) + shift,
                orientation="horizontal",
                widths=0.3,
                showfliers=False,
                showmeans=True,
                meanprops={"marker": "*", "markerfacecolor": colour, "markeredgecolor": colour},
                boxprops=style,
                whiskerprops=style,
                capprops=style,
                medianprops=style,
            )
            axis.plot([], [], color=colour, label=kind)
    axes[0].set_yticks(range(len(found)), list(found), fontsize=8)
    axes[0].invert_yaxis()
    axes[0].set(xlabel="interval, ms", title="Whiskers at 1.5 IQR; stars: means", xlim=(0, 50))
    axes[1].set(
        xlabel="interval, ms", title="Whiskers over all: with outliers", xscale="log", xlim=(0.5, 3e5)
    )
    axes[1].legend()
    return save(figure, folder, NAME)


def _box(values: Array, cut: bool) -> dict[str, float]:
    q1, median, q3 = np.percentile(values, [25, 50, 75])
    kept = values[~outliers(values)] if cut else values[values > 0.0]
    low, high = float(kept.min()), float(kept.max())
    return {"whislo": low, "q1": q1, "med": median, "q3": q3, "whishi": high, "mean": float(values.mean())}


def _text(found: dict[str, Intervals], file: str) -> str:
    rows = []
    for model, i in found.items():
        nominal = f"{1e3 / RATES_HZ[model]:.1f}" if model in RATES_HZ else "-"
        made, came = i.scatter
        middle = float(np.median(i.creation))
        beyond = f"{np.mean(outliers(i.creation)):.1%}, {np.mean(outliers(i.arrival)):.1%}"
        longest = f"{i.creation.max():.0f}, {i.arrival.max():.0f}"
        cells = (nominal, f"{middle:.2f}", f"{i.creation.mean():.2f}", f"{made:.2f}, {came:.2f}")
        rows.append((model, *cells, beyond, longest))
    head = ("model", "nominal", "median", "mean", "sd: creation, arrival", "beyond whiskers", "longest")
    return "\n\n".join(
        [
            "Devices on their backs; intervals in ms. Creation stamps come in units that differ by device and"
            " are told from arrival. Arrival was recorded to the millisecond.",
            picture(file, "Intervals by model, creation and arrival"),
            table(head, rows),
        ]
    )
