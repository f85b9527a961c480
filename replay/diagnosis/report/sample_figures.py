"""Pictures of what single samples show without a name: samples where it happens, and what follows a count."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.sequence.codes import codes
from stillcal.calib_core.diagnosis.sequence.neighbours import REACH, residual
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.report.figures import RecordedAndSimulated, drawing
from stillcal.replay.diagnosis.words.units import pretty, shown_in

SHOWN = 14
"""Samples drawn on either side of the first that is concerned."""

PARTS = 32
"""Parts of a cycle that are drawn, at most."""

CODES, COUNT = "code", "count of samples"
"""What a cycle may be of."""


def samples_figure(sources: RecordedAndSimulated, unit: str, axis: int, at: float) -> str:
    """Draw single samples of one axis about the time `at`, s: the recording's, which is the first source."""
    with drawing() as (_, axes, out):
        label, colour, samples, _bins = sources[0]
        k = int(np.searchsorted(samples.t, at))
        rows = slice(max(k - SHOWN, 0), k + SHOWN + 1)
        values = samples.xyz[rows, axis]
        scale, name = shown_in(values, unit)
        axes.plot(
            (samples.t[rows] - at) * 1e3,
            values * scale,
            color=colour,
            lw=1.0,
            marker="o",
            ms=3.5,
            label=label,
        )
        axes.set_xlabel(f"time since {at:.2f} s, ms")
        axes.set_ylabel(f"sample, {'xyz'[axis]}, {pretty(name)}")
    return out[0]


def cycle_figure(sources: RecordedAndSimulated, unit: str, axis: int, period: float, what: str) -> str:
    """Draw how large what neighbours leave of samples is over a cycle of `period` codes or samples."""
    with drawing() as (_, axes, out):
        courses = [
            (label, colour, _course(samples, axis, period, what)) for label, colour, samples, _ in sources
        ]
        shown = [(label, colour, course) for label, colour, course in courses if course is not None]
        scale, name = shown_in(np.concatenate([c for *_, c in shown]) if shown else np.ones(1), unit)
        for label, colour, course in shown:
            place = (np.arange(course.size) + 0.5) * period / course.size
            axes.plot(place, course * scale, color=colour, lw=1.2, marker="o", ms=3.0, label=label)
        axes.set_xlabel(f"{what}, modulo {period:.4g}")
        axes.set_ylabel(f"size left by neighbours, {'xyz'[axis]}, {pretty(name)}")
    return out[0]


def _course(samples: Samples, axis: int, period: float, what: str) -> Array | None:
    """Return the median size of residuals in each part of a cycle; None where there is no such cycle."""
    driver: Array | None = np.arange(len(samples), dtype=np.float64)
    if what == CODES:
        code = codes(samples.xyz[:, axis])
        driver = None if code is None else code.astype(np.float64)
    if driver is None:
        return None
    count = int(min(round(period), PARTS)) or 1
    part = ((driver[REACH:-REACH] % period) / period * count).astype(np.int64)
    size = np.abs(residual(samples.xyz[:, [axis]])[:, 0])
    # Medians: what moves the phone is far larger than its noise.
    return np.array([np.median(size[part == k]) if (part == k).any() else 0.0 for k in range(count)])
