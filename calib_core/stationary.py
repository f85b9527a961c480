"""The stationary detector: Algorithm 1 of Grammenos et al. 2018, streaming, sans-I/O, on sample time.

Samples become rows of window statistics (stillness_windows); each window is judged (stillness_judge) against
a learnt noise floor (stillness_floor); still windows that agree gather into runs (stillness_run), and runs
become rests (stillness_rests). Everything is computed on whole windows of one absolute time grid, never on
blocks: a stream cut anywhere gives the same rests to the last bit.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field

import numpy as np

from stillcal.calib_core.rests import RestState
from stillcal.calib_core.samples import Array, Samples, Sensor
from stillcal.calib_core.stillness_floor import Floor, counted, rate_class, renewed
from stillcal.calib_core.stillness_judge import (
    FATES,
    GAPPED,
    SPARSE,
    STILL,
    Coarseness,
    Codes,
    Flags,
    Windows,
    fates,
    lively,
)
from stillcal.calib_core.stillness_probe import Probe, cells_of, draw_probe
from stillcal.calib_core.stillness_rests import refusal, rest_of
from stillcal.calib_core.stillness_run import Run, absorb, drifted, trimmed
from stillcal.calib_core.stillness_settings import (
    DetectorSettings,
    Fate,
    Ledger,
    Mode,
    Sense,
    Sleep,
    Want,
)
from stillcal.calib_core.stillness_windows import COLUMNS, K_END, K, N, Stream, take

__all__ = [
    "DetectorSettings",
    "DetectorState",
    "Fate",
    "Ledger",
    "Mode",
    "Sense",
    "Sleep",
    "StationaryDetector",
    "Want",
]

_FIRST_EPOCH, _LAST_EPOCH = 8, 128  # cells between renewals of the floors, doubling
_MOST_CELLS = 8  # of one window, for slow sensors


@dataclass(slots=True)
class DetectorState:
    """All that a detector remembers; packs and unpacks (codec) to go on bit for bit.

    Cells are counted on the absolute grid. next_cell: the first not judged yet; epoch_end: where the floors
    are renewed next; cells: of one window; seen: cells and samples of both sensors in this epoch.
    """

    mode: Mode
    accel: Stream = field(default_factory=Stream)
    gyro: Stream = field(default_factory=Stream)
    gyro_expected: bool = True
    next_cell: float = -math.inf
    epoch_end: float = -math.inf
    epoch_cells: int = _FIRST_EPOCH
    cells: int = 1
    seen: list[float] = field(default_factory=lambda: [0.0] * 4)
    floors: list[Floor] = field(default_factory=lambda: [Floor(), Floor()])
    coarse: list[Coarseness] = field(default_factory=lambda: [Coarseness(), Coarseness()])
    run: Run = field(default_factory=Run)
    probe: Probe | None = None
    drawn: int = 0
    ledger: Ledger = field(default_factory=Ledger)


def _before(rows: Array, cell: float) -> Array:
    return rows[: np.searchsorted(rows[:, K], cell)]


class StationaryDetector:
    """Finds rests in two streams of samples fed in any interleaving; never waits, never reads a clock."""

    def __init__(self, settings: DetectorSettings | None = None, state: DetectorState | None = None) -> None:
        self.settings = settings or DetectorSettings()
        self._s = copy.deepcopy(state) if state else DetectorState(self.settings.mode)
        self._s.accel, self._s.gyro = self._s.accel.reshaped(), self._s.gyro.reshaped()
        self._s.run.rows = self._s.run.rows.reshape(-1, 2 * COLUMNS)

    @property
    def state(self) -> DetectorState:
        """A snapshot of all that is remembered; feeding on does not change it."""
        return copy.deepcopy(self._s)

    @property
    def ledger(self) -> Ledger:
        """What was asked for and read so far, and the fates of windows and candidate rests."""
        return copy.deepcopy(self._s.ledger)

    @property
    def mode(self) -> Mode:
        """How the detector runs now."""
        return self._s.mode

    def feed(self, *blocks: Samples) -> list[RestState]:
        """Take blocks of either sensor, each stream in time order, and return the rests that they complete.

        An accelerometer window waits for gyroscope samples of the same time, up to max_lag_s of stream time;
        blocks handed over in one call are taken together. Raises ValueError where a stream runs backwards.
        """
        for block in blocks:
            self._take(block)
        return self._advance(self._horizon())

    def finish(self) -> list[RestState]:
        """Judge what is buffered, close the open rest, and return what that completes."""
        s, window = self._s, self.settings.window_s
        s.accel = take(s.accel, Samples.empty(Sensor.ACCELEROMETER), window, close=True)
        s.gyro = take(s.gyro, Samples.empty(Sensor.GYROSCOPE), window, close=True)
        found = self._advance(math.inf)
        self._stop(found)
        return found

    def set_mode(self, mode: Mode) -> list[RestState]:
        """Switch between scanning and probing from the next window on; return the rest that this closes."""
        found: list[RestState] = []
        if mode is not self._s.mode:
            self._stop(found)
            self._s.mode, self._s.probe = mode, None
        return found

    def wants(self, now: float) -> Want:
        """Say what the detector wants at time `now`, s: samples until some time, or none before one.

        A probe for which nothing came is given up, max_lag_s after its end, and the next one drawn.
        """
        if self._s.mode is Mode.SCAN:
            return Sense(math.inf)
        window, cell = self.settings.window_s, now / self.settings.window_s
        probe = self._probe(cell)
        if (
            cell > self._asked_end(probe) + self.settings.max_lag_s / window
            and self._s.run.rows.shape[0] == 0
        ):
            self._end_probe(Fate.GAP, cell, [])
            probe = self._probe(cell)
        if cell < probe.start:
            return Sleep(probe.start * window)
        return Sense(self._asked_end(probe) * window)

    def next_probe(self, now: float) -> float:
        """Return when the current or next probe begins, s; in scan mode `now`."""
        if self._s.mode is Mode.SCAN:
            return now
        return self._probe(now / self.settings.window_s).start * self.settings.window_s

    def _stop(self, found: list[RestState]) -> None:
        """Close what is open: a run, or the probe that gathers it."""
        s = self._s
        if s.mode is Mode.PROBE and s.run.rows.shape[0]:
            self._end_probe(Fate.STILL, s.next_cell, found)
        self._close(Fate.STILL, found)

    def still_valid(self, rest: RestState) -> bool:
        """Judge an accepted rest again by the floors as known now.

        A rest accepted while the floor was still too high (nothing quieter had been seen) fails later. The
        rest's pooled sample deviations are compared, at its own sampling rate.
        """
        s, k = self._s, self.settings
        pairs = ((rest.force_sd, k.accel_factor), (rest.rate_sd, k.gyro_factor))
        rate = rate_class(np.array([rest.n / max(rest.duration, 1e-9)]))[0]
        for floor, coarse, (sd, factor) in zip(s.floors, s.coarse, pairs, strict=True):
            if sd is None:
                continue
            limit = math.hypot(factor * float(floor.level[rate]), math.sqrt(3.0) * coarse.step)
            if math.sqrt(float((sd**2).mean())) > limit:
                return False
        return True

    def noise_floor(self, rate_hz: float) -> tuple[float, float]:
        """Return the floors known for a sampling rate, (m/s^2, rad/s), inf where none is known yet."""
        octave = rate_class(np.array([rate_hz]))[0]
        return float(self._s.floors[0].level[octave]), float(self._s.floors[1].level[octave])

    def _take(self, block: Samples) -> None:
        s = self._s
        name = "accel" if block.sensor is Sensor.ACCELEROMETER else "gyro"
        stream: Stream = getattr(s, name)
        last = stream.t[-1] if stream.t.size else -math.inf
        if len(block) and block.t[0] < last:
            raise ValueError(f"{block.sensor} runs backwards, from {last:.6f} to {block.t[0]:.6f} s: sort it")
        stream = take(stream, block, self.settings.window_s)
        late = int(np.searchsorted(stream.rows[:, K], s.next_cell))
        if late and name == "gyro":
            s.ledger.gyro_late += late
        stream.rows = stream.rows[late:]
        setattr(s, name, stream)

    def _horizon(self) -> float:
        """Return the first cell that cannot be judged yet, after deciding whether to wait for the gyroscope."""
        s, window = self._s, self.settings.window_s
        if s.accel.t.size == 0:
            return -math.inf
        accel = float(math.floor(s.accel.t[-1] / window))
        gyro = math.floor(s.gyro.t[-1] / window) if s.gyro.t.size else -math.inf
        start = float(s.accel.rows[0, K]) if s.accel.rows.shape[0] else accel
        lost = accel - max(gyro, start) > self.settings.max_lag_s / window
        s.gyro_expected = not lost and (s.gyro_expected or gyro >= s.next_cell)
        return min(accel, gyro) if s.gyro_expected else accel

    def _advance(self, horizon: float) -> list[RestState]:
        """Judge all complete windows before cell `horizon`, epoch by epoch."""
        s = self._s
        found: list[RestState] = []
        while True:
            if s.accel.rows.shape[0] and s.accel.rows[0, K] >= s.epoch_end:
                self._renew(s.accel.rows[0, K])
            whole = math.floor(horizon / s.cells) * s.cells if math.isfinite(horizon) else horizon
            accel, gyro = _before(s.accel.rows, whole), _before(s.gyro.rows, whole)
            if accel.shape[0] == 0:
                return found
            windows = Windows.of(accel, gyro, s.cells, self.settings)
            self._judge_epochs(windows, found)
            s.accel.rows = s.accel.rows[np.searchsorted(s.accel.rows[:, K], s.next_cell) :]
            s.gyro.rows = s.gyro.rows[np.searchsorted(s.gyro.rows[:, K], s.next_cell) :]

    def _judge_epochs(self, windows: Windows, found: list[RestState]) -> None:
        """Judge windows until they run out or a renewal changes the length that windows should have."""
        s, first, cells = self._s, 0, self._s.cells
        starts = windows.rows[:, K]
        while first < len(windows) and s.cells == cells:
            if starts[first] >= s.epoch_end:
                self._renew(starts[first])
                continue
            last = int(np.searchsorted(starts, s.epoch_end))
            self._judge(windows[slice(first, last)], found)
            s.next_cell = float(windows.rows[last - 1, K_END])
            first = last

    def _judge(self, windows: Windows, found: list[RestState]) -> None:
        s = self._s
        codes = fates(windows, (s.floors[0], s.floors[1]), s.coarse[0].coarse, self.settings)
        if s.mode is Mode.SCAN:
            self._scan(windows.rows, codes, found)
            looked = np.ones(len(windows), dtype=bool)
            s.ledger.asked_s += (
                float((windows.rows[:, K_END] - windows.rows[:, K]).sum()) * self.settings.window_s
            )
        else:
            looked = self._follow_probes(windows.rows, codes, found)
        self._learn(windows, codes, looked)

    def _learn(self, windows: Windows, codes: Codes, looked: Flags) -> None:
        """Count the windows looked at, for the floors and the ledger."""
        s, ledger, window = self._s, self._s.ledger, self.settings.window_s
        ceilings = (self.settings.accel_ceiling, self.settings.gyro_ceiling)
        teach = lively(windows, codes)
        width = windows.rows[:, K_END] - windows.rows[:, K]
        for i, half in enumerate((windows.accel, windows.gyro)):
            use = teach[i] & looked
            s.floors[i] = counted(s.floors[i], half.rates[use], half.spread[use])
            s.coarse[i] = s.coarse[i].observed(half, looked, ceilings[i])
            n = half.rows[:, N]
            s.seen[2 * i] += float(width[looked & (n > 0)].sum())
            s.seen[2 * i + 1] += float(n[looked].sum())
        accel_n, gyro_n = windows.accel.rows[:, N], windows.gyro.rows[:, N]
        ledger.accel_samples += int(accel_n[looked].sum())
        ledger.gyro_samples += int(gyro_n[looked].sum())
        ledger.accel_unasked += int(accel_n[~looked].sum())
        ledger.accel_on_s += float(width[looked].sum()) * window
        ledger.gyro_on_s += float(width[looked & (gyro_n > 0)].sum()) * window
        for code, count in enumerate(np.bincount(codes[looked], minlength=len(FATES)).tolist()):
            if count:
                ledger.windows[FATES[code]] = ledger.windows.get(FATES[code], 0) + count

    def _renew(self, cell: float) -> None:
        """Begin an epoch: use what the last one taught, and fit the windows' length to the sampling rate."""
        s, k = self._s, self.settings
        s.floors = [renewed(floor, k) for floor in s.floors]
        s.coarse = [coarse.renewed(k) for coarse in s.coarse]
        density = [s.seen[i + 1] / s.seen[i] for i in (0, 2) if s.seen[i]]
        if density:
            wanted = math.ceil(math.log2(max(k.min_samples / min(density), 1.0)))
            s.cells = min(1 << wanted, _MOST_CELLS)
        s.seen = [0.0] * 4
        if math.isfinite(s.epoch_end):
            s.epoch_cells = min(2 * s.epoch_cells, _LAST_EPOCH)
        s.epoch_end = (math.floor(cell / s.epoch_cells) + 1.0) * s.epoch_cells

    def _scan(self, rows: Array, codes: Codes, found: list[RestState]) -> None:
        """Gather runs from all windows; anything but a still window that follows on closes the open one."""
        s = self._s
        previous = np.concatenate(([s.next_cell], rows[:-1, K_END]))
        apart = rows[:, K] != previous
        cuts = np.flatnonzero(np.concatenate(([True], (codes[1:] != codes[:-1]) | apart[1:])))
        for first, last in zip(cuts, [*cuts[1:], rows.shape[0]], strict=True):
            if apart[first]:
                self._close(Fate.GAP, found)
            if codes[first] == STILL:
                self._gather(rows[first:last], found)
            else:
                self._close(FATES[codes[first]], found)

    def _gather(self, rows: Array, found: list[RestState]) -> None:
        """Add still, adjoining windows to the open run, closing it where they step off or it is full."""
        s, full = self._s, cells_of(self.settings.max_rest_s, self.settings.window_s)
        while rows.shape[0]:
            room = int(
                np.searchsorted(np.cumsum(rows[:, K_END] - rows[:, K]), full - s.run.cells, side="right")
            )
            if room == 0:
                self._close(Fate.STILL, found)
                continue
            s.run, taken = absorb(s.run, rows[:room], self._coarse_steps(), self.settings)
            if taken < room:
                self._close(Fate.STEPPED, found)
            rows = rows[taken:]

    def _coarse_steps(self) -> tuple[float, float]:
        return self._s.coarse[0].step, self._s.coarse[1].step

    def _close(self, ended_by: Fate, found: list[RestState]) -> bool:
        """Close the open run: a rest is added to `found`, a refusal to the ledger. True for a rest."""
        s, run = self._s, self._s.run
        s.run = Run(after=ended_by)
        if run.rows.shape[0] == 0:
            return False
        rows = trimmed(run, ended_by)
        fate = refusal(rows, drifted(run, ended_by), self.settings) or Fate.STILL
        s.ledger.rests[fate] = s.ledger.rests.get(fate, 0) + 1
        if fate is Fate.STILL:
            found.append(rest_of(rows))
        return fate is Fate.STILL

    def _follow_probes(self, rows: Array, codes: Codes, found: list[RestState]) -> Flags:
        """Look only at windows that a probe asks for (Algorithm 1, lines 8-29); say which those were."""
        looked = np.zeros(rows.shape[0], dtype=bool)
        at = 0
        while at < rows.shape[0]:
            probe = self._probe(rows[at, K])
            if rows[at, K] < probe.start:
                at += int(np.searchsorted(rows[at:, K], probe.start))
                continue
            read = self._read_probe(probe, rows[at:], codes[at:], found)
            looked[at : at + read] = True
            at += read
        return looked

    def _read_probe(self, probe: Probe, rows: Array, codes: Codes, found: list[RestState]) -> int:
        """Read windows up to the probe's end or the first that is not still; return how many were read."""
        s = self._s
        first = 0 if s.run.rows.shape[0] else self._started(probe, rows, codes)
        probe = s.probe or probe
        expected = np.concatenate(([probe.start + s.run.cells], rows[first:-1, K_END]))
        good = (codes[first:] == STILL) & (rows[first:, K] == expected) & (rows[first:, K_END] <= probe.end)
        still = int(good.argmin()) if not good.all() else good.size
        s.run, taken = absorb(s.run, rows[first : first + still], self._coarse_steps(), self.settings)
        last = first + taken
        if last == rows.shape[0] and s.run.cells < probe.full:
            return last
        ended_by, read = self._ending(probe, rows, codes, last, stepped=taken < still)
        self._end_probe(ended_by, rows[max(last + read - 1, 0), K_END], found)
        return last + read

    def _started(self, probe: Probe, rows: Array, codes: Codes) -> int:
        """Skip the broken windows while sensors start up, and let the probe begin at the first whole one."""
        late = cells_of(self.settings.startup_s, self.settings.window_s) + probe.asked
        broken = (codes == GAPPED) | (codes == SPARSE)
        skip = broken & (rows[:, K_END] <= late)
        first = int(skip.argmin()) if not skip.all() else rows.shape[0]
        begins = rows[min(first, rows.shape[0] - 1), K if first < rows.shape[0] else K_END]
        if begins <= late:
            self._s.probe = probe.begun_at(int(begins), self._s.cells)
        return first

    def _ending(
        self, probe: Probe, rows: Array, codes: Codes, last: int, *, stepped: bool
    ) -> tuple[Fate, int]:
        """Say what ended a probe, and how many windows of `rows` from `last` on it read in finding out."""
        if self._s.run.cells >= probe.full:
            return Fate.STILL, 0
        if rows[last, K_END] > probe.end:
            return Fate.GAP, 0
        if stepped:
            return Fate.STEPPED, 1
        return (FATES[codes[last]], 1) if codes[last] != STILL else (Fate.GAP, 1)

    def _probe(self, cell: float) -> Probe:
        """Return the probe that is under way or due, drawing the first one after `cell`."""
        s = self._s
        if s.probe is None:
            s.probe = draw_probe(cell, s.drawn, self.settings)
            s.drawn = s.probe.drawn
        return s.probe

    def _asked_end(self, probe: Probe) -> int:
        """Return the cell up to which samples are wanted: w_min at first, w_max once that was still (line 13)."""
        shortest = min(
            max(cells_of(self.settings.w_min_s, self.settings.window_s), self._s.cells), probe.full
        )
        return probe.end if self._s.run.cells >= shortest else probe.start + shortest

    def _end_probe(self, ended_by: Fate, cell: float, found: list[RestState]) -> None:
        """Close a probe that ended at `cell` and draw the next one after it."""
        s, window = self._s, self.settings.window_s
        probe = self._probe(cell)
        s.ledger.probes += 1
        s.ledger.lapsed += s.run.rows.shape[0] == 0 and ended_by is Fate.GAP
        s.ledger.abandoned += s.run.cells < cells_of(self.settings.w_min_s, window)
        end = max(self._asked_end(probe), cell)
        s.ledger.asked_s += (end - probe.asked) * window
        self._close(ended_by, found)
        s.run, s.probe = Run(), None
        self._probe(end)
