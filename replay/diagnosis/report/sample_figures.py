"""Pictures of what samples show without a name: where it happens, over a count, a code or a period."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.sequence.codes import codes
from stillcal.calib_core.diagnosis.sequence.neighbours import REACH, residual
from stillcal.calib_core.streams.samples import Samples
from stillcal.replay.diagnosis.report.figures import RecordedAndSimulated, drawing
from stillcal.replay.diagnosis.words.moments import moment
from stillcal.replay.diagnosis.words.units import pretty, shown_in

SHOWN = 14
"""Samples drawn on either side of the first that is concerned."""

PARTS = 32
"""Parts of a cycle that are drawn, at most."""

LEAST_IN_PART = 10
"""Samples in each part of a period whose mean is drawn."""

AROUND_S, EACH_S = 60.0, 1.0
"""s on either side of a jump that are drawn, and how long each mean of samples is."""

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
    courses = [(label, colour, _course(samples, axis, period, what)) for label, colour, samples, _ in sources]
    said = f"{what}, modulo {period:.4g}", f"size left by neighbours, {'xyz'[axis]}"
    return _over_a_cycle(courses, unit, period, *said)


def _over_a_cycle(
    courses: Sequence[tuple[str, str, Array | None]], unit: str, period: float, along: str, up: str
) -> str:
    """Draw values in each part of a cycle: label, colour and values (k,), None of a source without any.

    along, up: what the axes say; the unit is added to the second.
    """
    with drawing() as (_, axes, out):
        shown = [(label, colour, course) for label, colour, course in courses if course is not None]
        scale, name = shown_in(np.concatenate([c for *_, c in shown]) if shown else np.ones(1), unit)
        for label, colour, course in shown:
            place = (np.arange(course.size) + 0.5) * period / course.size
            axes.plot(place, course * scale, color=colour, lw=1.2, marker="o", ms=3.0, label=label)
        axes.set_xlabel(along)
        axes.set_ylabel(f"{up}, {pretty(name)}")
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


def period_figure(sources: RecordedAndSimulated, unit: str, axis: int, period: float) -> str:
    """Draw the mean of one axis at rest in each part of a period, s."""
    courses = [
        (label, colour, _folded(samples, bins, axis, period)) for label, colour, samples, bins in sources
    ]
    said = f"time, modulo {period:.4g} s", f"mean minus the interval's, {'xyz'[axis]}"
    return _over_a_cycle(courses, unit, period, *said)


def _folded(samples: Samples, bins: Bins, axis: int, period: float) -> Array | None:
    """Return the mean at rest in each part of a period, the mean of each interval off; None without any."""
    edges = np.stack([bins.t - bins.duration / 2.0, bins.t + bins.duration / 2.0], axis=1)
    rows = np.searchsorted(samples.t, edges)
    parts = [(samples.t[a:b], samples.xyz[a:b, axis]) for a, b in rows if b > a]
    if not parts:
        return None
    t = np.concatenate([times for times, _ in parts])
    values = np.concatenate([x - x.mean() for _, x in parts])
    count = int(min(PARTS, values.size // LEAST_IN_PART))
    if count < 2:
        return None
    part = np.minimum((t % period) / period * count, count - 1).astype(np.int64)
    return np.asarray(np.bincount(part, values, count) / np.maximum(np.bincount(part, minlength=count), 1))


def jump_figure(sources: RecordedAndSimulated, unit: str, axis: int, at: float) -> str:
    """Draw the means of one axis in seconds about the time `at`, s: the recording's, the first source."""
    with drawing() as (_, axes, out):
        label, colour, samples, _bins = sources[0]
        part = samples.between(at - AROUND_S, at + AROUND_S)
        which = np.floor((part.t - at) / EACH_S).astype(np.int64)
        seconds, place = np.unique(which, return_inverse=True)
        values = np.bincount(place, part.xyz[:, axis]) / np.bincount(place)
        scale, name = shown_in(values, unit)
        axes.plot((seconds + 0.5) * EACH_S, values * scale, ".", color=colour, ms=4, label=label)
        axes.axvline(0.0, color="#999999", lw=1.0, ls=":")
        axes.set_xlabel(f"time since {moment(at)}, s")
        axes.set_ylabel(f"mean of a second, {'xyz'[axis]}, {pretty(name)}")
    return out[0]
