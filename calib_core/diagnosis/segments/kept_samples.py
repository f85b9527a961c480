"""Which samples of a long recording are kept: whole seconds, chosen by the statistics of every second.

Rests, and so all slow effects, are judged on every second's mean. Samples themselves are needed for spectra
and values at rest, for turns between rests and for motion; of these a bounded number shows as much as the
tolerances ask for. What is rare is looked for by its own statistics: the largest values, and an axis that
stands still.

What is chosen depends on the recording's own seconds only, and of what was chosen from a part of a
recording nothing is missed when more of it is known. So a recording is read once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.overview import Overview
from stillcal.calib_core.diagnosis.segments.rests.rest_edges import Index, RestEdges, rest_edges
from stillcal.calib_core.diagnosis.segments.windows import WINDOW, Windows

Flags = NDArray[np.bool_]

AT_REST, TURNS, LIVELY, LARGEST, STANDING = 0.55, 0.25, 0.1, 0.05, 0.05
"""Parts of the seconds kept: in rests, turns between rests, other motion, largest values, an axis that gives
one value."""

LONGEST_AT_REST = 64.0
"""s that are kept of some bins: long enough for the longest spectra of lines, 60 s."""

SHORTEST_AT_REST = 6.0
"""s of a bin that are kept at least: a spectrum of the noise takes 256 samples."""

LONGEST_TURN = 60
"""Windows between two rests beyond which the gyroscope does not carry gravity from one to the other."""

MARGIN = 2
"""Windows of the rests on either side that are kept with a turn."""

MOTION = 24
"""Windows of motion that are kept together: two whole stretches of 8 s, wherever these begin."""

LEAST_RATE = 0.5
"""rad/s, rms, of motion that is kept."""

FEWEST_APART = 60
"""Sampling periods between two parts that are kept. Gaps of up to 50 count as lost samples."""

STANDS = 3
"""Windows of one value that make an axis that stands still."""


def chosen(overview: Overview, have: Flags, seconds: float) -> Flags:
    """Return which windows (n,) to keep, about `seconds` of them. have: (n,), which are there still."""
    edges = rest_edges(overview.force, overview.rate, overview.span)
    wanted = _at_rest(edges, have, AT_REST * seconds)
    wanted |= _turns(edges, have, TURNS * seconds)
    if overview.rate is not None:
        wanted |= _lively(overview.rate, have, LIVELY * seconds)
    for sensor in (overview.force, overview.rate):
        if sensor is not None:
            wanted |= _largest(sensor, have, LARGEST * seconds / 6.0)
            wanted |= _standing(sensor, have, STANDING * seconds / 2.0)
    return _in_cells(wanted, _cell(overview.force))


def _at_rest(edges: RestEdges, have: Flags, seconds: float) -> Flags:
    """Keep a short part of every bin, and a long one of some, chosen by chance.

    Lines that come and go are told from lasting ones by long parts without them, all along the recording.
    """
    runs = [_longest_run(have, int(a), int(b)) for a, b in zip(edges.first, edges.last, strict=True)]
    short = int(np.clip(0.5 * seconds / max(len(runs), 1), SHORTEST_AT_REST, LONGEST_AT_REST))
    keep = np.zeros_like(have)
    for first, size in runs:
        keep[first : first + min(size, short)] = True
    longest = int(LONGEST_AT_REST)
    long = [(first, first + longest) for first, size in runs if size >= longest]
    return keep | _some(long, have, 0.5 * seconds)


def _longest_run(have: Flags, first: int, last: int) -> tuple[int, int]:
    """Return first and size of the first long enough part of a bin that is there, else of the longest."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], have[first:last].astype(np.int8), [0]])))
    begins, sizes = edges[::2], edges[1::2] - edges[::2]
    if begins.size == 0:
        return first, 0
    best = int(np.argmax(np.minimum(sizes, int(LONGEST_AT_REST))))
    return first + int(begins[best]), int(sizes[best])


def _turns(edges: RestEdges, have: Flags, seconds: float) -> Flags:
    """Keep whole gaps between successive rests."""
    ends = [b for _, b in edges.runs[:-1]]
    starts = [a for a, _ in edges.runs[1:]]
    spans = [
        (b - MARGIN, a + MARGIN) for b, a in zip(ends, starts, strict=True) if a - b <= LONGEST_TURN / WINDOW
    ]
    return _some(spans, have, seconds)


def _lively(rate: Windows, have: Flags, seconds: float) -> Flags:
    """Keep spans of motion in which the phone turns."""
    n = rate.t.size // MOTION
    power = (rate.mean**2 + rate.variance).sum(axis=1)[: n * MOTION].reshape(n, MOTION).mean(axis=1)
    spans = [(k * MOTION, (k + 1) * MOTION) for k in np.flatnonzero(power > LEAST_RATE**2).tolist()]
    return _some(spans, have, seconds)


def _some(spans: list[tuple[int, int]], have: Flags, seconds: float) -> Flags:
    """Keep whole spans of windows, up to so many seconds: those that come first in an order by chance.

    The order is that of their own first window: what was kept of a part of the recording is a part of what
    is kept of all.
    """
    keep = np.zeros_like(have)
    left = seconds / WINDOW
    for a, b in sorted(spans, key=lambda s: (s[0] * 2654435761) % 2**32):
        left -= b - a
        if left < 0.0:
            break
        if have[max(a, 0) : b].all():
            keep[max(a, 0) : b] = True
    return keep


def _largest(sensor: Windows, have: Flags, seconds: float) -> Flags:
    """Keep the windows of the largest values on each axis."""
    far = sensor.mean + (sensor.mean - sensor.calm_mean) * np.maximum(sensor.count - 1.0, 1.0)[:, None]
    keep = np.zeros_like(have)
    count = max(int(seconds / WINDOW), 1)
    for size in np.where(have[:, None], np.abs(far), 0.0).T:
        keep[np.argsort(-size, kind="stable")[:count]] = True
    return keep & have


def _standing(sensor: Windows, have: Flags, seconds: float) -> Flags:
    """Keep the beginning of the longest run of windows in which one axis alone gives one value."""
    same = (sensor.variance == 0.0) & (sensor.count >= STANDS)[:, None]
    keep = np.zeros_like(have)
    best = (STANDS - 1, 0)
    for axis in range(3):
        alone = same[:, axis] & ~np.delete(same, axis, axis=1).any(axis=1) & have
        edges = np.flatnonzero(np.diff(np.concatenate([[0], alone.astype(np.int8), [0]])))
        sizes = edges[1::2] - edges[::2]
        if sizes.size and sizes.max() > best[0]:
            best = int(sizes.max()), int(edges[::2][np.argmax(sizes)])
    size, first = best
    if size >= STANDS:
        keep[max(first - 1, 0) : first + min(size + 1, int(seconds / WINDOW))] = True
    return keep & have


def _cell(force: Windows) -> int:
    """Return how many windows are kept or left out together, so that what is left out is no lost sample."""
    usual = float(np.median(force.count[force.count > 0.0]))
    return int(np.ceil(FEWEST_APART / usual / WINDOW))


def _in_cells(wanted: Flags, cell: int) -> Flags:
    """Return windows (n,) with every cell kept whole of which any is wanted."""
    cells: Index = np.arange(wanted.size) // cell
    return np.asarray(np.bincount(cells, weights=wanted)[cells] > 0.0)


def of_samples(t: Array, span: tuple[float, float], keep: Flags) -> Flags:
    """Return which samples at t (n,) s lie in windows that are kept."""
    window = np.floor((t - span[0]) / WINDOW).astype(np.int64)
    within = (window >= 0) & (window < keep.size)
    return np.asarray(within & keep[np.clip(window, 0, keep.size - 1)])
