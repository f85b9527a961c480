"""Still devices: how far their readings are from gravity (Stisen et al. 2015, 3.1, Figure 1)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.studies.claim import (
    Cause,
    Claim,
    Evidence,
    Progress,
    Study,
    Verdict,
    agreement,
    holds,
    picture,
    table,
)
from stillcal.replay.studies.drawing import BLUE, GREY, RED, panels, save
from stillcal.replay.studies.har.data import without_recordings
from stillcal.replay.studies.har.devices import read_devices
from stillcal.replay.studies.har.recordings import DATA, Still, by_device, read_still

NAME, TITLE, WORK = "biases", "Devices at rest (Figure 1)", "Stisen 2015"
G = 9.81
"""What the paper took deviations from, m/s^2."""

PAPER = {
    "range": ("3.1, Figure 1b", "range of mean deviations from g", "-8.5 % to +7.5 %"),
    "absolute": ("3.1", "absolute deviation, mean over runs", "0.35 m/s²"),
    "mean": ("3.1", "mean reading over runs", "9.76 m/s²"),
    "gaussian": ("3.1", "the deviations are near Gaussian", "stated"),
    "faces": ("3.1", "all six orientations show similar biases", "stated"),
    "models": ("3.1", "biases differ within a model too", "stated"),
    "newer": ("6", "newer models have lower biases", "a trend"),
    "watches": ("6", "watches do not have larger biases than other devices", "not larger"),
    "reference": ("3.1", "reference unit: mean, sd of samples", "9.82, 0.008 m/s²"),
}
RELEASED = {
    "LG_G-Watch": 2014,
    "Samsung-Galaxy-Gear": 2013,
    "iphone-6_s": 2014,
    "Samsung-Galaxy-Pocket+": 2013,
    "Samsung-Galaxy-S3 Mini": 2012,
    "LG-Nexus4": 2012,
    "Samsung-Galaxy-S3": 2012,
    "Samsung-Galaxy-Nexus": 2011,
    "Samsung-Galaxy-S+": 2011,
    "LG-Optimus-2X": 2011,
    "HTC-Desire": 2010,
    "HTC-Nexus-One": 2010,
    "Samsung-Galaxy-Tab10.1": 2011,
}
"""Table 1: year of release by model, under the names of the recordings; LG's are also called LGE's."""

WATCHES = ("LG_G-Watch", "Samsung-Galaxy-Gear")
DEVICES, DRAWS = 36, 1000
"""Devices of the paper, which lists their models alone; how often as many are drawn."""

BIN = 0.01
"""Width of a bin of Figure 1b, as a fraction of g."""

_FACES = ("back", "front", "left", "right", "top", "bottom")


@dataclass(frozen=True, slots=True, eq=False)
class Deviations:
    """Mean norm less g of every recording of a sensor that works, m/s^2; face and device: (n,) names."""

    value: Array
    face: Array
    device: Array
    model: Array

    def on(self, *faces: str) -> Array:
        """Return the deviations on some faces."""
        return np.asarray(self.value[np.isin(self.face, faces)])


def deviations(recordings: list[Still], g: float = G) -> Deviations:
    """Return the deviations of all recordings given."""
    return Deviations(
        np.array([r.norms.mean() - g for r in recordings]),
        np.array([r.face for r in recordings]),
        np.array([r.name for r in recordings]),
        np.array([r.model for r in recordings]),
    )


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Compare range, size and shape of the deviations with the paper's."""
    if data is None:
        return without_recordings(NAME, TITLE, [(WORK, *row) for row in PAPER.values()], seed)
    recordings = read_still(data)
    devices = [r for r in recordings if not r.reference]
    working = deviations([r for r in devices if not r.frozen])
    everything = deviations(devices)
    progress(0.5)
    claims = (
        _range(working),
        *_sizes(working, everything),
        _gaussian(working),
        _faces(working, np.array([d.bias for d in read_devices(data)])),
        _models(working),
        _newer(working),
        _watches(working),
        _reference(*_summed([r.norms for r in recordings if r.reference])),
    )
    figure = _draw([r for r in devices if not r.frozen], working, figures)
    text = _text(working, everything, figure)
    progress(1.0)
    return Study(NAME, TITLE, claims, text, (figure,), seed)


def _claim(key: str, ours: str, verdict: Verdict, because: str, cause: Cause | None = None) -> Claim:
    return Claim(WORK, *PAPER[key], ours, DATA, verdict, because, evidence=Evidence.REAL, cause=cause)


def _range(found: Deviations) -> Claim:
    low, high = found.value.min() / G, found.value.max() / G
    share = found.value / G
    outside = sorted(set(found.device[(share < -0.085 - BIN) | (share > 0.075 + BIN)]))
    verdict = holds(_as_printed(share))
    why = f"tolerance 1 % of g, the histogram's bin; beyond it: {', '.join(outside) or 'none'}"
    ends = [_between([getattr(own, end)() / G for own in drawn_anew(found)]) for end in ("min", "max")]
    within = ends[0][0] <= -0.085 <= ends[0][1] and ends[1][0] <= 0.075 <= ends[1][1]
    cause = Cause(
        f"which devices are in it, which the paper does not list: of {DEVICES} of ours, drawn anew, the"
        f" lowest is {ends[0][0]:+.1%} to {ends[0][1]:+.1%} and the highest {ends[1][0]:+.1%} to"
        f" {ends[1][1]:+.1%}, and the paper's range lies {'within' if within else 'beyond'} that. Farther out"
        f" than the paper's: {', '.join(outside) or 'none'}",
        shown=within,
    )
    return _claim("range", f"{low:+.1%} to {high:+.1%} ({len(found.value)} recordings)", verdict, why, cause)


def _as_printed(share: Array) -> bool:
    """Return whether deviations, shares of g, have the paper's range."""
    return bool(abs(share.min() + 0.085) <= BIN and abs(share.max() - 0.075) <= BIN)


def drawn_anew(found: Deviations) -> list[Array]:
    """Return the deviations of DEVICES devices drawn from those that there are, with replacement, often."""
    rng, names = np.random.default_rng(0), np.unique(found.device)
    own = [found.value[found.device == name] for name in names]
    return [np.concatenate([own[k] for k in rng.integers(0, len(own), DEVICES)]) for _ in range(DRAWS)]


def _between(values: list[float]) -> tuple[float, float]:
    low, high = np.percentile(values, [2.5, 97.5])
    return float(low), float(high)


def _sizes(found: Deviations, everything: Deviations) -> list[Claim]:
    size, level = float(np.abs(found.value).mean()), float(found.value.mean() + G)
    tried = {
        "with the frozen tablet left in": everything.value,
        "lying flat (back, front)": found.on("back", "front"),
        "flat with the tablet": everything.on("back", "front"),
        **{f"{face} alone": found.on(face) for face in _FACES},
    }
    both = [
        n
        for n, v in tried.items()
        if abs(np.abs(v).mean() - 0.35) <= 0.01 and abs(v.mean() + G - 9.76) <= 0.01
    ]
    drawn = drawn_anew(found)
    sizes = _between([float(np.abs(own).mean()) for own in drawn])
    levels = _between([float(own.mean() + G) for own in drawn])
    listed = ", ".join(f"{n} {np.abs(v).mean():.2f} and {v.mean() + G:.2f}" for n, v in tried.items())
    cause = Cause(
        f"absolute deviation and mean: {listed}. {_those(both)} both of the paper's figures, 0.35 and 9.76,"
        f" to 0.01; rms instead of mean absolute: {_rms(found.value):.2f}, with the tablet"
        f" {_rms(everything.value):.3f}. It is not which devices are in it: {DEVICES} of ours, drawn anew,"
        f" have {sizes[0]:.2f} to {sizes[1]:.2f} and {levels[0]:.2f} to {levels[1]:.2f}",
        shown=bool(both),
    )
    room = "tolerance its rounding, 0.005"
    return [
        _claim("absolute", f"{size:.3f} m/s²", agreement(0.35, size, 0.005), room, cause),
        _claim("mean", f"{level:.3f} m/s²", agreement(9.76, level, 0.005), room, cause),
    ]


def _those(both: list[str]) -> str:
    return f"Only {' and '.join(both)} give" if both else "No choice gives"


def _gaussian(found: Deviations) -> Claim:
    from scipy import stats  # noqa: PLC0415 - slow to import

    p, excess = stats.shapiro(found.value).pvalue, stats.kurtosis(found.value)
    why = "Shapiro-Wilk at the 5 % level, recordings taken as independent, which favours rejection"
    groups = [found.on("back", "front"), found.on(*_FACES[2:])]
    least = stats.shapiro(found.value).statistic
    rng = np.random.default_rng(0)
    mixed = [
        np.concatenate([rng.normal(own.mean(), own.std(), own.size) for own in groups]) for _ in range(DRAWS)
    ]
    as_far = float(np.mean([stats.shapiro(draw).statistic <= least for draw in mixed]))
    cause = Cause(
        f"lying flat they spread by {groups[0].std():.2f}, on edges by {groups[1].std():.2f} m/s², and two"
        f" normal distributions of these spreads together are as far from one in {as_far:.0%} of draws",
        shown=as_far > 0.05,
    )
    return _claim("gaussian", f"p = {p:.2g}, excess kurtosis {excess:+.1f}", holds(p > 0.05), why, cause)


def _faces(found: Deviations, biases: Array) -> Claim:
    """Compare the faces. biases: (n, 3) m/s^2 of the devices that their faces calibrate."""
    from scipy import stats  # noqa: PLC0415 - slow to import

    p = stats.levene(*(found.on(face) for face in _FACES)).pvalue
    flat, edge = np.abs(found.on("back", "front")).mean(), np.abs(found.on(*_FACES[2:])).mean()
    why = "Levene's test of equal spread at the 5 % level"
    size = np.median(np.abs(biases), axis=0)
    sizes = ", ".join(f"{name} {value:.2f}" for name, value in zip("xyz", size, strict=True))
    cause = Cause(
        f"the biases of the {len(biases)} devices that six faces calibrate: {sizes} m/s² (median size). It is"
        " z, across the chip, that stands upright on the flat faces",
        shown=bool(size[2] >= 1.5 * size[:2].max()),
    )
    ours = f"mean absolute deviation flat {flat:.2f}, on edges {edge:.2f} m/s² (p = {p:.1g})"
    return _claim("faces", ours, holds(p > 0.05), why, cause)


def _models(found: Deviations) -> Claim:
    within, groups = [], 0
    for model in np.unique(found.model):
        for face in _FACES:
            values = found.value[(found.model == model) & (found.face == face)]
            if len(values) > 1:
                within += list(values - values.mean())
                groups += 1
    own = float(np.sqrt(np.sum(np.square(within)) / max(len(within) - groups, 1)))
    whole = float(found.value.std(ddof=1))
    why = "holds where the sd within model and face is half or more of the sd over all"
    return _claim("models", f"sd {own:.2f} of {whole:.2f} m/s²", holds(own >= 0.5 * whole), why)


def _sizes_by(found: Deviations, names: Array) -> dict[str, float]:
    """Return the mean absolute deviation by name, of each device first, m/s^2. names: (n,)."""
    devices = {d: float(np.abs(found.value[found.device == d]).mean()) for d in np.unique(found.device)}
    return {
        name: float(np.mean([devices[d] for d in np.unique(found.device[names == name])]))
        for name in np.unique(names)
    }


def _newer(found: Deviations) -> Claim:
    """Compare the size of deviations with the year of release, device by device and model by model."""
    from scipy import stats  # noqa: PLC0415 - slow to import

    named = np.array([name.replace("LGE-", "LG-") for name in found.model])
    known = np.isin(named, list(RELEASED))
    own = Deviations(*(column[known] for column in (found.value, found.face, found.device, named)))
    model = dict(zip(own.device, own.model, strict=True))
    by_device, by_model = _sizes_by(own, own.device), _sizes_by(own, own.model)
    devices = stats.spearmanr([RELEASED[model[d]] for d in by_device], list(by_device.values()))
    models = stats.spearmanr([RELEASED[m] for m in by_model], list(by_model.values()))
    return _claim(
        "newer",
        f"rank correlation with year: {len(by_device)} devices {devices.statistic:+.2f}"
        f" (p = {devices.pvalue:.2g}), {len(by_model)} models {models.statistic:+.2f}"
        f" (p = {models.pvalue:.2g})",
        holds(devices.statistic < 0.0 and devices.pvalue < 0.05),
        "holds where it is below zero at the 5 % level over devices, as the paper counts them. Devices of one"
        " model share its year: over models the trend is as large and may be chance",
    )


def _watches(found: Deviations) -> Claim:
    watch = np.where(np.isin(found.model, WATCHES), "watch", "other")
    size = _sizes_by(found, watch)
    number = len(np.unique(found.device[watch == "watch"]))
    return _claim(
        "watches",
        f"mean absolute deviation: {number} watches {size['watch']:.3f}, others {size['other']:.3f} m/s²",
        holds(size["watch"] <= size["other"]),
        "means by device; so few watches tell no more than that theirs are not far larger",
    )


def _summed(norms: list[Array]) -> tuple[float, float, list[float]]:
    """Return the mean, the sd within a recording, and each recording's mean, m/s^2."""
    noise = float(np.sqrt(np.mean([own.var() for own in norms])))
    return float(np.concatenate(norms).mean()), noise, [float(own.mean()) for own in norms]


def _reference(mean: float, noise: float, faces: list[float]) -> Claim:
    verdict = holds(abs(mean - 9.82) <= 0.01 and abs(noise - 0.008) <= 0.0005)
    why = (
        "mean within 0.01, as much as its own faces leave open; sd within its rounding, taken within a"
        f" recording: from face to face its means run from {min(faces):.2f} to {max(faces):.2f}"
    )
    return _claim("reference", f"{mean:.3f}, {noise:.4f} m/s²", verdict, why)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _draw(recordings: list[Still], found: Deviations, folder: Path) -> str:
    figure, (left, right) = panels(2, gridspec_kw={"width_ratios": (1.6, 1.0)})
    figure.set_size_inches(9.6, 7.2)
    back = [r for r in recordings if r.face == "back"]
    groups = by_device(sorted(back, key=lambda r: r.name))
    norms = [np.concatenate([r.norms for r in group]) for group in groups.values()]
    stats = [np.percentile(n, [0, 25, 50, 75, 100]) for n in norms]
    boxes = [
        {"whislo": s[0], "q1": s[1], "med": s[2], "q3": s[3], "whishi": s[4], "label": name}
        for name, s in zip(groups, stats, strict=True)
    ]
    left.bxp(boxes, orientation="horizontal", showfliers=False, widths=0.6, medianprops={"color": RED})
    left.axvline(G, color=GREY, linewidth=1.0)
    left.set_xlim(8.9, 11.0)
    left.tick_params(axis="y", labelsize=7)
    left.invert_yaxis()
    left.set(xlabel="norm lying on the back, m/s²; box, range", title="By device (beyond 8.9 to 11: cut)")
    edges = np.arange(-0.115, 0.1, BIN)
    right.hist(found.value / G, list(edges), color=BLUE, edgecolor="white", zorder=2)
    for bound in (-0.085, 0.075):
        right.axvline(bound, color=RED, linestyle="--", linewidth=1.0)
    right.xaxis.set_major_formatter(lambda x, _: f"{100 * x:.0f} %")
    right.set(
        xlabel="mean deviation from g\n(dashed: the paper's range)", ylabel="recordings", title="All faces"
    )
    return save(figure, folder, NAME)


def _text(found: Deviations, everything: Deviations, figure: str) -> str:
    rows = [
        (
            face,
            str(len(found.on(face))),
            f"{found.on(face).mean() + G:.3f}",
            f"{np.abs(found.on(face)).mean():.3f}",
            f"{100 * found.on(face).min() / G:+.1f} … {100 * found.on(face).max() / G:+.1f} %",
        )
        for face in _FACES
    ]
    dead = len(everything.value) - len(found.value)
    return "\n\n".join(
        [
            f"{len(found.value)} recordings of {len(set(found.device))} devices; {dead} more hold one value"
            " throughout (a tablet's frozen sensor) and are left out unless said. These are the recordings"
            " published with the paper, not its selection, which it does not state: nameless devices are"
            " kept, and the faces are as labelled, though two labels are known to name one face twice.",
            picture(figure, "Norm by device lying on its back; deviations of all recordings from g"),
            table(("face", "recordings", "mean norm, m/s²", "mean abs. deviation, m/s²", "range"), rows),
        ]
    )
