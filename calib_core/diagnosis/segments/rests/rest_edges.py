"""Where the rests of a recording begin and end and are cut into bins, in windows of a second or less."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.rests.slow_moves import without_slow_moves
from stillcal.calib_core.diagnosis.segments.rests.stillness import SHORTEST_REST, rest_runs, still_seconds
from stillcal.calib_core.diagnosis.segments.windows import (
    WINDOW,
    Windows,
    without_spikes,
)
from stillcal.calib_core.streams.events import Charging

Index = NDArray[np.int64]

BRIEFEST_REST, FEW = 2, 12
"""Windows of a rest that counts where those of `SHORTEST_REST` windows give fewer bins than `FEW`."""

BINS, SHORTEST_BIN = 200, 10.0
"""A bin is as long as a recording's part of so many, at least so many s."""

MOST_BINS = 300
"""More bins, where rests are very many, are thinned: work grows with their cube."""

BRIEFEST_BIN = 4
"""Windows of a bin that may lie in motion, or be left beside a plug: three differences tell its noise."""

FACES = 6
"""Stops that are cut into shorter bins where they would give fewer than `FEW`: on each of its faces once, a
sensor shows its bias and scale."""

TURNED = 0.2
"""rad between two attitudes, at least: a phone that lies in a vehicle that brakes leans by less."""

MORE = 1.5
"""Times as many stops that briefer windows must show."""

PLUG_LATE = 3.0
"""s by which the event of a plug may come after the plug: a phone tells it when its charger has answered."""


@dataclass(frozen=True, slots=True, eq=False)
class RestEdges:
    """Where a recording rests, in windows. still: (w,); runs: [first, last) of each rest.

    first, last: (n,) of each bin, at most `MOST_BINS`; rest: (n,), the run that each lies in. width: s, of a
    window. stops: number of rests in another attitude than the one before, and the first.
    """

    still: NDArray[np.bool_]
    runs: list[tuple[int, int]]
    first: Array
    last: Array
    rest: Index
    width: float = WINDOW
    stops: int = 0

    def shows_more_than(self, other: RestEdges) -> bool:
        """Whether it has far more stops than another, or enough bins of all faces where that has too few."""
        enough = self.stops >= max(FACES, other.stops) and self.first.size >= FEW > other.first.size
        return enough or self.stops >= MORE * max(other.stops, 1)

    def beside_plugs(self, events: Sequence[Charging], start: float) -> RestEdges:
        """Return bins of which it is known throughout whether the phone was on the charger.

        What lies from `PLUG_LATE` before an event of the plug up to it is cut off, with the shorter side of
        a bin; bins that become too brief are left out. start: s, the first window's.
        """
        first, last = self.first.copy(), self.last.copy()
        for event in plugs(events):
            low, high = (
                np.floor((event.t - PLUG_LATE - start) / self.width),
                np.ceil((event.t - start) / self.width),
            )
            touched = (first < high) & (last > low)
            at_end = low - first >= last - high
            last[touched & at_end], first[touched & ~at_end] = low, high
        kept = (last - first >= BRIEFEST_BIN) | ((first == self.first) & (last == self.last))
        return replace(self, first=first[kept], last=last[kept], rest=self.rest[kept])


def rest_edges(
    force: Windows,
    rate: Windows | None,
    span: tuple[float, float],
    bin_length: float | None = None,
    width: float = WINDOW,
) -> RestEdges:
    """Find the rests of a recording and cut them into bins of `bin_length` s (None: as in `cut`).

    width: s, of the windows.
    """
    if rate is not None:
        force, rate = without_spikes(force, rate), without_spikes(rate, force)
    still = still_seconds(force, rate)
    length = bin_length or max(SHORTEST_BIN, (span[1] - span[0]) / BINS)
    runs = _rests(still, rate, SHORTEST_REST)
    first, last, rest = _bin_edges(runs, length / width)
    if first.size < FEW:
        runs = _rests(still, rate, BRIEFEST_REST)
        first, last, rest = _bin_edges(runs, length / width)
    stops = _stops(runs, force.mean)
    if first.size < FEW and stops >= FACES:
        at_rest = sum(b - a for a, b in runs)
        first, last, rest = _bin_edges(runs, max(at_rest / (2 * FEW), BRIEFEST_BIN))
    kept = _longest(last - first)
    return RestEdges(still, runs, first[kept], last[kept], rest[kept], width, stops)


def _rests(still: NDArray[np.bool_], rate: Windows | None, shortest: int) -> list[tuple[int, int]]:
    """Return [first, last) windows of rests, free of slow moves at their ends where a gyroscope tells."""
    runs = rest_runs(still, shortest)
    return runs if rate is None else without_slow_moves(runs, rate.mean, shortest)


def _stops(runs: list[tuple[int, int]], force: Array) -> int:
    """Return how many runs lie in another attitude than the one before, and the first; force: (w, 3)."""
    up = np.array([force[a:b].mean(axis=0) for a, b in runs]).reshape(-1, 3)
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    turned = (up[1:] * up[:-1]).sum(axis=1) < np.cos(TURNED)
    return int(turned.sum()) + len(runs[:1])


def _bin_edges(runs: list[tuple[int, int]], length: float) -> tuple[Array, Array, Index]:
    """Return [first, last) of the bins of runs, and the run of each; length: of a bin, in windows."""
    parts = [np.linspace(a, b, max(1, round((b - a) / length)) + 1).round() for a, b in runs]
    if not parts:
        return np.empty(0), np.empty(0), np.empty(0, dtype=np.int64)
    rest = np.repeat(np.arange(len(parts), dtype=np.int64), [p.size - 1 for p in parts])
    return np.concatenate([p[:-1] for p in parts]), np.concatenate([p[1:] for p in parts]), rest


def _longest(length: Array) -> Index:
    """Return which bins are kept: all, or the longest of each of `MOST_BINS` groups of neighbours."""
    if length.size <= MOST_BINS:
        return np.arange(length.size)
    groups = np.array_split(np.arange(length.size), MOST_BINS)
    return np.array([g[np.argmax(length[g])] for g in groups], dtype=np.int64)


def plugs(events: Sequence[Charging]) -> list[Charging]:
    """Return the events at which the charger came or went, in time order: some logs tell its state again."""
    told = sorted((e for e in events if isinstance(e, Charging)), key=lambda e: e.t)
    return [e for k, e in enumerate(told) if k == 0 or e.on != told[k - 1].on]
