"""Rests gathered from classified windows: from all of them, or only from those that probes ask for.

This module keeps the open run and the current probe. When to probe and for how long is the random part of
Algorithm 1: draws are functions of (seed, counter), so that a detector restored from its state draws the same
times, without a hidden generator. All times of probes are in cells of the grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.static.classify import GAPPED, LABELS, SPARSE, STILL, Codes, Flags
from stillcal.calib_core.static.interval import (
    Run,
    absorb,
    contributions,
    drifted,
    rest_from_windows,
    trimmed,
)
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.static.settings import DetectorSettings, Label, Ledger, Sense, Sleep, Want
from stillcal.calib_core.static.windows import K_END, K

_MASK = (1 << 64) - 1
"""The random numbers wrap at 64 bits, as SplitMix64 has them."""


@dataclass(frozen=True, slots=True)
class Probe:
    """A probe on the grid of windows, in cells.

    asked: when the sensors are wanted on. start: of the first whole window. full: its length w_max. drawn:
    the counter of random draws after its own.
    """

    asked: int
    start: int
    full: int
    drawn: int

    @property
    def end(self) -> int:
        """The cell after the last one that this probe may read."""
        return self.start + self.full

    def begun_at(self, start: int, cells: int) -> Probe:
        """Return the probe beginning at `start`, of whole windows of `cells` cells, at least two."""
        return Probe(self.asked, start, max(math.ceil(self.full / cells), 2) * cells, self.drawn)


def uniform(seed: int, counter: int) -> float:
    """Return output `counter` of the SplitMix64 sequence of `seed`, in [0, 1) (Steele et al. 2014)."""
    z = (seed + (counter + 1) * 0x9E3779B97F4A7C15) & _MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _MASK
    return float((z ^ (z >> 31)) >> 11) * 2.0**-53


def cells_of(duration: float, window: float) -> int:
    """Return how many windows cover `duration` (both s), at least one."""
    return max(math.ceil(duration / window - 1e-9), 1)


def draw_probe(after: float, drawn: int, settings: DetectorSettings) -> Probe:
    """Draw the next probe at least probe_min_s after cell `after` (Algorithm 1, lines 5-7, 24, 29)."""
    pause = settings.probe_min_s + (settings.probe_max_s - settings.probe_min_s) * uniform(
        settings.seed, drawn
    )
    full = settings.w_min_s + settings.w_spread_s * uniform(settings.seed, drawn + 1)
    start = int(after) + cells_of(pause, settings.window_s)
    return Probe(start, start, cells_of(full, settings.window_s), drawn + 2)


Steps = tuple[float, float]


@dataclass(slots=True)
class GatherState:
    """The state of gathering.

    run: open run of still windows. end_cell: the cell after the last window. probe: the current or next one.
    drawn: counter of random draws. ledger: what was asked for and read.
    """

    run: Run = field(default_factory=Run)
    end_cell: float = -math.inf
    probe: Probe | None = None
    drawn: int = 0
    ledger: Ledger = field(default_factory=Ledger)


class Gatherer:
    """Turns classified windows into rests, which wait in `rests` until they are taken."""

    def __init__(self, settings: DetectorSettings, state: GatherState) -> None:
        self.settings = settings
        self.state = state
        self.rests: list[RestState] = []
        self._longest = cells_of(settings.max_rest_s, settings.window_s)
        self._shortest = settings.w_min_s * (1 - 1e-9) / settings.window_s

    def take_rests(self) -> list[RestState]:
        """Return the rests gathered since the last call."""
        rests, self.rests = self.rests, []
        return rests

    def scan(self, rows: Array, codes: Codes, steps: Steps) -> None:
        """Gather runs from all windows; anything but a still window without a gap closes the open run.

        rows: (n, 2 COLUMNS) joint rows. codes: (n,) their labels. steps: standard uncertainty that coarseness
        alone puts into the two means.
        """
        state = self.state
        n = rows.shape[0]
        apart = rows[:, K] != np.concatenate(([state.end_cell], rows[:-1, K_END]))
        cuts = np.flatnonzero(np.concatenate(([True], (codes[1:] != codes[:-1]) | apart[1:])))
        own, short = contributions(rows), rows[:, K_END] - rows[:, K] < self._shortest
        parts = zip(
            cuts.tolist(), [*cuts[1:].tolist(), n], apart[cuts].tolist(), codes[cuts].tolist(), strict=True
        )
        for first, last, broken, code in parts:
            if broken:
                self._close(Label.GAP)
            if code != STILL:
                self._close(LABELS[code])
            elif last - first == 1 and last < n and short[first] and not state.run.rows.shape[0]:
                # A lone window, too short for a rest: what comes next ends it, so it is counted ungathered.
                state.ledger.count_rest(Label.SHORT)
            else:
                self._gather(rows[first:last], own[:, first:last], steps)
        state.end_cell = float(rows[-1, K_END])
        state.ledger.asked_s += float((rows[:, K_END] - rows[:, K]).sum()) * self.settings.window_s

    def probe(self, rows: Array, codes: Codes, steps: Steps) -> Flags:
        """Read only windows that a probe asks for (Algorithm 1, lines 8-29); return which these are, (n,)."""
        looked = np.zeros(rows.shape[0], dtype=bool)
        at = 0
        while at < rows.shape[0]:
            probe = self._awaited(rows[at, K])
            if rows[at, K] < probe.start:
                at += int(np.searchsorted(rows[at:, K], probe.start))
                continue
            read = self._read(rows[at:], codes[at:], steps)
            looked[at : at + read] = True
            at += read
        self.state.end_cell = float(rows[-1, K_END])
        return looked

    def skip_to(self, end: float) -> bool:
        """Skip all cells before `end` where the next probe begins no earlier; tell whether that was so."""
        state = self.state
        if state.probe is None or end > state.probe.start:
            return False
        state.end_cell = end
        return True

    def wants(self, now: float) -> Want:
        """Return the request at time `now`, s; a probe for which no sample came is given up."""
        window, cell = self.settings.window_s, now / self.settings.window_s
        probe = self._awaited(cell)
        return Sleep(probe.start * window) if cell < probe.start else Sense(self._asked_end(probe) * window)

    def _awaited(self, cell: float) -> Probe:
        """Return the probe due at `cell`, giving up those before it for which no sample came.

        Each is given up at a time of its own, however often this is called, so that a gap lived through and a
        gap in a recording leave the same probes.
        """
        probe, lag = self.due(cell), self.settings.max_lag_s / self.settings.window_s
        while not self.state.run.rows.shape[0] and cell > (last := self._asked_end(probe) + lag):
            self._end_probe(Label.GAP, last)
            probe = self.due(last)
        return probe

    def due(self, cell: float) -> Probe:
        """Return the current or next probe, drawing the first one after `cell`."""
        state = self.state
        if state.probe is None:
            state.probe = draw_probe(cell, state.drawn, self.settings)
            state.drawn = state.probe.drawn
        return state.probe

    def cut(self, longest: int) -> None:
        """Close the open run where it has that many cells; what goes on being still begins another."""
        if self.state.run.cells >= longest:
            self._close(Label.STILL)

    def stop(self) -> None:
        """Close the open run and the probe that it belongs to."""
        if self.state.probe is not None and self.state.run.rows.shape[0]:
            self._end_probe(Label.STILL, self.state.end_cell)
        self._close(Label.STILL)

    def _gather(self, rows: Array, own: Array, steps: Steps) -> None:
        """Add still, adjoining windows to the open run; close it where their mean differs or it is full."""
        state = self.state
        ends = np.add.accumulate(rows[:, K_END] - rows[:, K])
        at, n, closed_cells = 0, rows.shape[0], 0.0
        while at < n:
            room = (
                int(np.searchsorted(ends, self._longest - state.run.cells + closed_cells, side="right")) - at
            )
            if room <= 0 and state.run.rows.shape[0]:
                self._close(Label.STILL)
                continue
            end = at + max(room, 1)
            state.run, taken = absorb(state.run, rows[at:end], own[:, at:end], steps, self.settings)
            if at + taken < min(end, n):
                self._close(Label.STEPPED)
            at += taken
            closed_cells = float(ends[at - 1]) if at else 0.0

    def _close(self, ended_by: Label) -> None:
        """Close the open run: count what it made, and keep it if it is a rest."""
        state, run = self.state, self.state.run
        state.run = Run(after=ended_by)
        if run.rows.shape[0]:
            rest = rest_from_windows(trimmed(run, ended_by), drifted(run, ended_by), self.settings)
            state.ledger.count_rest(rest if isinstance(rest, Label) else Label.STILL)
            if not isinstance(rest, Label):
                self.rests.append(rest)

    def _read(self, rows: Array, codes: Codes, steps: Steps) -> int:
        """Read windows up to the probe's end or the first that is not still; return how many were read."""
        state = self.state
        first = 0 if state.run.rows.shape[0] else self._started(rows, codes)
        probe = self.due(rows[0, K])
        rows, codes = rows[first:], codes[first:]
        expected = np.concatenate(([probe.start + state.run.cells], rows[:-1, K_END]))[: rows.shape[0]]
        good = (codes == STILL) & (rows[:, K] == expected) & (rows[:, K_END] <= probe.end)
        still = int(good.argmin()) if not good.all() else good.size
        state.run, taken = absorb(state.run, rows[:still], contributions(rows[:still]), steps, self.settings)
        if taken == rows.shape[0] and state.run.cells < probe.full:
            return first + taken
        if state.run.cells >= probe.full:
            self._end_probe(Label.STILL, probe.end)
            return first + taken
        broken = Label.STEPPED if taken < still else LABELS[codes[taken]]
        inside = rows[taken, K_END] <= probe.end
        self._end_probe(
            Label.GAP if broken is Label.STILL or not inside else broken, float(rows[taken, K_END])
        )
        return first + taken + int(inside)

    def _started(self, rows: Array, codes: Codes) -> int:
        """Return how many broken windows to skip at the start; the first whole one begins the probe."""
        probe = self.due(rows[0, K])
        late = probe.asked + cells_of(self.settings.startup_s, self.settings.window_s)
        skip = np.isin(codes, (GAPPED, SPARSE)) & (rows[:, K_END] <= late)
        first = rows.shape[0] if skip.all() else int(skip.argmin())
        if first:
            probe = replace(probe, start=int(rows[first - 1, K_END]))
        if first < rows.shape[0] and rows[first, K] <= late:
            probe = probe.begun_at(int(rows[first, K]), int(rows[first, K_END] - rows[first, K]))
        self.state.probe = probe
        return first

    def _asked_end(self, probe: Probe) -> int:
        """Return the cell up to which samples are wanted: w_min at first, w_max once w_min was still."""
        shortest = min(cells_of(self.settings.w_min_s, self.settings.window_s), probe.full)
        return probe.end if self.state.run.cells >= shortest else probe.start + shortest

    def _end_probe(self, ended_by: Label, cell: float) -> None:
        """End the probe at `cell`, and draw the next one after that."""
        state, window = self.state, self.settings.window_s
        probe = self.due(cell)
        state.ledger.probes += 1
        state.ledger.lapsed += int(state.run.rows.shape[0] == 0 and ended_by is Label.GAP)
        state.ledger.abandoned += int(state.run.cells < cells_of(self.settings.w_min_s, window))
        asked = min(max(cell, probe.start), self._asked_end(probe)) - probe.asked
        state.ledger.asked_s += float(asked) * window
        self._close(ended_by)
        state.run, state.probe = Run(), None
        self.due(max(cell, probe.start))
