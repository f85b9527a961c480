"""Taking noise off at rest: rolling mean against rolling median (Grammenos et al. 2018, Tables 1 and 2)."""

from __future__ import annotations

import time
from bisect import bisect_left, insort
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.smoothing import RollingMean, window_for
from stillcal.replay.studies.claim import Cause, Claim, Evidence, Progress, Study, holds, picture, table
from stillcal.replay.studies.drawing import BLUE, GREY, RED, panels, save
from stillcal.replay.studies.har.data import without_recordings
from stillcal.replay.studies.har.recordings import Still, read_still

NAME, TITLE, WORK = "smoothing", "Smoothing at rest (Tables 1 and 2)", "Grammenos 2018"
TABLE_1 = {10: (4.6495e-05, 3.4568e-05), 20: (2.6465e-05, 1.8359e-05)}
"""Window: variance after the median and after the mean."""

DATA = "hhar_still: every recording of a working phone or watch"
PAPER = {
    10: ("4.6, Table 1", "median over mean variance, 10 steps", f"{TABLE_1[10][0] / TABLE_1[10][1]:.3f}"),
    20: ("4.6, Table 1", "median over mean variance, 20 steps", f"{TABLE_1[20][0] / TABLE_1[20][1]:.3f}"),
    "gain": ("4.6, Table 1", "mean, 20 over 10 steps", f"{TABLE_1[20][1] / TABLE_1[10][1]:.3f}"),
    "sorted": ("4.6", "the median is significantly dearer: sorted at every step", "significantly"),
    "kept": ("4.6", "the median is significantly dearer: its window kept sorted", "significantly"),
    "table 2": ("4.6, Table 2", "window by rate: worth its delay", "3, 5, 10, 20 steps"),
}
RATE_HZ = {3: 10.0, 5: 50.0, 10: 100.0, 20: 200.0}
"""A rate at which Table 2 has this window."""

SECONDS = 20.0
"""The middle of a recording is used: whoever started it has left."""


def study(data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Filter every still recording both ways and compare variances."""
    if data is None:
        return without_recordings(NAME, TITLE, [(WORK, *row) for row in PAPER.values()], seed)
    rests = [r for r in read_still(data) if not r.frozen and not r.reference]
    parts = {r: middle(r) for r in rests if "iphone" not in r.model}
    variances = np.array([[filtered(p, n) for n in TABLE_1] for p in parts.values()])
    raw = np.array([p.var(axis=0).mean() for p in parts.values()])
    progress(0.6)
    claims = (
        *(_against(n, variances[:, k]) for k, n in enumerate(TABLE_1)),
        _gain(variances),
        *_costs(costs(next(iter(parts.values())))),
        _table_2(rests, parts),
    )
    file = _draw(raw, variances, figures)
    progress(1.0)
    return Study(NAME, TITLE, claims, _text(raw, variances, parts, file), (file,), seed)


def middle(rest: Still) -> Array:
    """Return the middle SECONDS of a recording, (n, 3) m/s^2."""
    centre = rest.creation[-1] / 2.0
    return np.asarray(rest.accel[np.abs(rest.creation - centre) <= SECONDS / 2.0])


def filtered(values: Array, window: int) -> tuple[float, float]:
    """Return the variance after the rolling median and the rolling mean, over the axes' mean, (m/s^2)^2."""
    median = rolling_median(values, window)
    mean = RollingMean(RATE_HZ[window]).smoothed(values)[window - 1 :]
    return float(median.var(axis=0).mean()), float(mean.var(axis=0).mean())


def rolling_median(values: Array, window: int) -> Array:
    """Return the medians of whole windows of values (n, 3), (n - window + 1, 3)."""
    return np.asarray(np.median(sliding_window_view(values, window, axis=0), axis=-1))


def _interval(values: Array) -> tuple[float, float, float]:
    """Return the median of values (n,) and the quartiles."""
    low, middle, high = np.percentile(values, [25, 50, 75])
    return float(low), float(middle), float(high)


def _against(window: int, variances: Array) -> Claim:
    low, mid, high = _interval(variances[:, 0] / variances[:, 1])
    paper = TABLE_1[window][0] / TABLE_1[window][1]
    why = (
        "reproduced where the paper's ratio, of one recording that it does not name, lies between the"
        " quartiles of ours; white Gaussian noise gives 1.38 and 1.47, for medians of 10 and 20"
    )
    ours = f"{mid:.3f} (quartiles {low:.3f} to {high:.3f})"
    return Claim(WORK, *PAPER[window], ours, DATA, holds(low <= paper <= high), why, evidence=Evidence.REAL)


def _gain(variances: Array) -> Claim:
    low, mid, high = _interval(variances[:, 1, 1] / variances[:, 0, 1])
    paper = TABLE_1[20][1] / TABLE_1[10][1]
    why = "as above; white noise would halve it, whatever wanders does not average out"
    ours = f"{mid:.3f} (quartiles {low:.3f} to {high:.3f})"
    return Claim(WORK, *PAPER["gain"], ours, DATA, holds(low <= paper <= high), why, evidence=Evidence.REAL)


def costs(values: Array) -> dict[int, tuple[float, ...]]:
    """Return s of processor time by window of a rolling mean and of two medians of values (n, 3).

    The mean adds the newest sample to a sum and takes the oldest off. The first median sorts its window at
    every step, as the paper says; the second keeps it sorted. All three take one number at a time.
    """
    axis = values[:, 0].tolist()
    return {n: tuple(_seconds(way, axis, n) for way in (running_mean, sorting, kept_sorted)) for n in TABLE_1}


def _costs(spent: dict[int, tuple[float, ...]]) -> list[Claim]:
    """Compare both ways to write a median with the mean: what it costs depends on how it is written."""
    claims = []
    for key, column in (("sorted", 1), ("kept", 2)):
        ratios = {n: times[column] / times[0] for n, times in spent.items()}
        claims.append(
            Claim(
                WORK,
                *PAPER[key],
                ", ".join(f"{ratio:.1f} times at {n} steps" for n, ratio in ratios.items()),
                DATA,
                holds(min(ratios.values()) >= 2.0),
                "significantly: at least twice the mean's processor time; all written alike, one number at a"
                " time, best of five in one run",
                evidence=Evidence.ARITHMETIC,
                cause=Cause(
                    "sorted at every step instead, the same median takes "
                    + ", ".join(
                        f"{times[1] / times[0]:.1f} times at {n} steps" for n, times in spent.items()
                    ),
                    shown=min(times[1] / times[0] for times in spent.values()) >= 2.0,
                ),
            )
        )
    return claims


def running_mean(values: list[float], window: int) -> list[float]:
    """Return the means of whole windows by a running sum."""
    total, out = sum(values[: window - 1]), []
    for new, old in zip(values[window - 1 :], values, strict=False):
        total += new
        out.append(total / window)
        total -= old
    return out


def sorting(values: list[float], window: int) -> list[float]:
    """Return the medians of whole windows, each window sorted anew."""
    return [_middle(sorted(values[k : k + window])) for k in range(len(values) - window + 1)]


def kept_sorted(values: list[float], window: int) -> list[float]:
    """Return the medians of whole windows; the window stays sorted as one sample comes and one goes."""
    held, out = sorted(values[: window - 1]), []
    for new, old in zip(values[window - 1 :], values, strict=False):
        insort(held, new)
        out.append(_middle(held))
        del held[bisect_left(held, old)]
    return out


def _middle(ordered: list[float]) -> float:
    half = len(ordered) // 2
    return ordered[half] if len(ordered) % 2 else 0.5 * (ordered[half - 1] + ordered[half])


def _seconds(function: Callable[[list[float], int], list[float]], values: list[float], window: int) -> float:
    best = np.inf
    for _ in range(5):
        begin = time.process_time()
        function(values, window)
        best = min(best, time.process_time() - begin)
    return max(float(best), 1e-6)


def _table_2(rests: list[Still], parts: dict[Still, Array]) -> Claim:
    left, delay = [], []
    for rest in rests:
        if rest not in parts:
            continue
        values = parts[rest]
        rate = (len(values) - 1) / SECONDS
        window = window_for(rate)
        left.append(filtered(values, window)[1] / values.var(axis=0).mean())
        delay.append((window - 1) / 2.0 / rate)
    ours = f"variance left {np.median(left):.2f}, delay {min(delay) * 1e3:.0f} to {max(delay) * 1e3:.0f} ms"
    why = "holds where at least half of the variance goes on the median and no delay is over 0.1 s"
    good = float(np.median(left)) <= 0.5 and max(delay) <= 0.1
    return Claim(WORK, *PAPER["table 2"], ours, DATA, holds(good), why, evidence=Evidence.REAL)


def _draw(raw: Array, variances: Array, folder: Path) -> str:
    figure, (axis,) = panels()
    for k, (window, colour) in enumerate(zip(TABLE_1, (BLUE, RED), strict=True)):
        axis.plot(raw, variances[:, k, 0], "x", color=colour, markersize=4, label=f"median, {window} steps")
        axis.plot(raw, variances[:, k, 1], "o", color=colour, markersize=3, label=f"mean, {window} steps")
    span = np.array([raw.min(), raw.max()])
    axis.plot(span, span, color=GREY, linewidth=0.8, label="as before: nothing taken off")
    axis.set(xscale="log", yscale="log", xlabel="variance before, (m/s²)²", ylabel="after, (m/s²)²")
    axis.set_xlim(5e-5, 2e-2)
    axis.legend(fontsize=7)
    return save(figure, folder, NAME)


def _text(raw: Array, variances: Array, parts: dict[Still, Array], file: str) -> str:
    models = sorted({r.model for r in parts})
    rows = []
    for model in models:
        chosen = np.array([r.model == model for r in parts])
        cells = [np.median(raw[chosen]), *np.median(variances[chosen], axis=0).ravel()]
        rows.append((model, str(int(chosen.sum())), *(f"{c:.3g}" for c in cells)))
    head = ("model", "recordings", "before", "median 10", "mean 10", "median 20", "mean 20")
    return "\n\n".join(
        [
            f"The middle {SECONDS:.0f} s of {len(parts)} recordings; variances in (m/s²)², mean of the three"
            " axes, medians over recordings. The iPhones are left out: their recordings break off.",
            picture(file, "Variance after filtering against variance before"),
            table(head, rows),
        ]
    )
