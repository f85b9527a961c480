"""Gathering rests from judged windows, in either mode: all of them, or only those that probes ask for.

Holds the open run and the probe under way; knows nothing of samples, streams or noise floors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.static.classify import GAPPED, LABELS, SPARSE, STILL, Codes, Flags
from stillcal.calib_core.static.interval import Run, absorb, contributions, drifted, judged, trimmed
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.static.settings import DetectorSettings, Label, Ledger, Sense, Sleep, Want
from stillcal.calib_core.static.windows import K_END, K

_MASK = (1 << 64) - 1


@dataclass(frozen=True, slots=True)
class Probe:
    """A probe on the grid of windows; all in cells.

    asked: when the sensors are wanted on; start: of the first whole window; full: length, w_max; drawn: the
    counter after its draws.
    """

    asked: int
    start: int
    full: int
    drawn: int

    @property
    def end(self) -> int:
        """The cell after the last that this probe may read."""
        return self.start + self.full

    def begun_at(self, start: int, cells: int) -> Probe:
        """Return it beginning at `start`, of whole windows of `cells` cells, at least two of them."""
        return Probe(self.asked, start, max(math.ceil(self.full / cells), 2) * cells, self.drawn)


def uniform(seed: int, counter: int) -> float:
    """Draw from [0, 1): output `counter` of the SplitMix64 sequence of `seed` (Steele et al. 2014)."""
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
class Gathered:
    """What is open, and the count of what became of things.

    run: open run of still windows; end_cell: the cell after the last window seen; probe: due or under way;
    drawn: counter of random draws.
    """

    run: Run = field(default_factory=Run)
    end_cell: float = -math.inf
    probe: Probe | None = None
    drawn: int = 0
    ledger: Ledger = field(default_factory=Ledger)


class Gatherer:
    """Turns judged windows into rests, kept in `found` until taken."""

    def __init__(self, settings: DetectorSettings, state: Gathered) -> None:
        self.settings = settings
        self.state = state
        self.found: list[RestState] = []
        self._most = cells_of(settings.max_rest_s, settings.window_s)
        self._least = settings.w_min_s * (1 - 1e-9) / settings.window_s

    def taken(self) -> list[RestState]:
        """Return the rests found since the last time."""
        found, self.found = self.found, []
        return found

    def scan(self, rows: Array, codes: Codes, steps: Steps) -> None:
        """Gather runs from all windows; anything but a still window that follows on closes the open one.

        rows: joint rows; codes: their fates; steps: what coarseness alone may move the two means by.
        """
        state = self.state
        n = rows.shape[0]
        apart = rows[:, K] != np.concatenate(([state.end_cell], rows[:-1, K_END]))
        cuts = np.flatnonzero(np.concatenate(([True], (codes[1:] != codes[:-1]) | apart[1:])))
        own, short = contributions(rows), rows[:, K_END] - rows[:, K] < self._least
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

    def probed(self, rows: Array, codes: Codes, steps: Steps) -> Flags:
        """Look only at windows that a probe asks for (Algorithm 1, lines 8-29); say which those were."""
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

    def passes_over(self, end: float) -> bool:
        """Tell whether the probe due begins no earlier than cell `end`; what lies before it is then past."""
        state = self.state
        if state.probe is None or end > state.probe.start:
            return False
        state.end_cell = end
        return True

    def wants(self, now: float) -> Want:
        """Say what the probe under way or due wants at time `now`, s, giving up one that nothing came for."""
        window, cell = self.settings.window_s, now / self.settings.window_s
        probe = self._awaited(cell)
        return Sleep(probe.start * window) if cell < probe.start else Sense(self._asked_end(probe) * window)

    def _awaited(self, cell: float) -> Probe:
        """Return the probe due at `cell`, giving up those before it that nothing came for.

        Each is given up at a time of its own, whoever asks and when: a gap lived through and a gap found
        in a recording leave the same probes.
        """
        probe, lag = self.due(cell), self.settings.max_lag_s / self.settings.window_s
        while not self.state.run.rows.shape[0] and cell > (last := self._asked_end(probe) + lag):
            self._end_probe(Label.GAP, last)
            probe = self.due(last)
        return probe

    def due(self, cell: float) -> Probe:
        """Return the probe that is under way or due, drawing the first one after `cell`."""
        state = self.state
        if state.probe is None:
            state.probe = draw_probe(cell, state.drawn, self.settings)
            state.drawn = state.probe.drawn
        return state.probe

    def stop(self) -> None:
        """Close what is open: a run, and the probe that gathers it."""
        if self.state.probe is not None and self.state.run.rows.shape[0]:
            self._end_probe(Label.STILL, self.state.end_cell)
        self._close(Label.STILL)

    def _gather(self, rows: Array, own: Array, steps: Steps) -> None:
        """Add still, adjoining windows to the open run, closing it where they step off or it is full."""
        state = self.state
        ends = np.add.accumulate(rows[:, K_END] - rows[:, K])
        at, n, gone = 0, rows.shape[0], 0.0
        while at < n:
            room = int(np.searchsorted(ends, self._most - state.run.cells + gone, side="right")) - at
            if room <= 0 and state.run.rows.shape[0]:
                self._close(Label.STILL)
                continue
            end = at + max(room, 1)
            state.run, taken = absorb(state.run, rows[at:end], own[:, at:end], steps, self.settings)
            if at + taken < min(end, n):
                self._close(Label.STEPPED)
            at += taken
            gone = float(ends[at - 1]) if at else 0.0

    def _close(self, ended_by: Label) -> None:
        """Close the open run: a rest joins `found`, a refusal the ledger."""
        state, run = self.state, self.state.run
        state.run = Run(after=ended_by)
        if run.rows.shape[0]:
            rest = judged(trimmed(run, ended_by), drifted(run, ended_by), self.settings)
            fate = rest if isinstance(rest, Label) else Label.STILL
            state.ledger.count_rest(fate)
            if not isinstance(rest, Label):
                self.found.append(rest)

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
        """Skip broken windows while the sensors start up; the probe begins at the first whole one."""
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
        """Return the cell up to which samples are wanted: w_min at first, w_max once that was still."""
        shortest = min(cells_of(self.settings.w_min_s, self.settings.window_s), probe.full)
        return probe.end if self.state.run.cells >= shortest else probe.start + shortest

    def _end_probe(self, ended_by: Label, cell: float) -> None:
        """Close the probe, which ended at `cell`, and draw the next one after that."""
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
