"""The static detector: Algorithm 1 of Grammenos et al. 2018, streaming, without I/O, on sample time.

Samples become rows of window statistics (windows.py). Each window is classified (classify.py) against a
learnt noise floor (noise_floor.py). Still windows that agree form runs, and runs become rests (interval.py),
in either mode (gather.py). Everything is computed on whole windows of one absolute time grid, never on the
blocks that came in: a stream cut anywhere gives the same rests to the last bit.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.static.classify import LABELS, Coarseness, Codes, Flags, Windows, classify, trainable
from stillcal.calib_core.static.gather import Gatherer, GatherState, cells_of
from stillcal.calib_core.static.noise_floor import Floor, counted, octave_of, renewed
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.static.settings import DetectorSettings, Ledger, Mode, Sense, Want
from stillcal.calib_core.static.windows import (
    BLOCK,
    COLUMNS,
    K_END,
    Density,
    K,
    N,
    Stream,
    matched,
    take,
    window_cells,
    with_rows,
)
from stillcal.calib_core.streams.samples import Samples, Sensor

_FIRST_EPOCH, _LAST_EPOCH = BLOCK, 64 * BLOCK
"""Cells between renewals of the noise floors: 4 s at first, so that a floor is known soon, and doubling up to
four minutes, far below the half-life of what the floor remembers."""

_MOST_ALONE = 4096
"""Cells of the gyroscope that wait for the accelerometer's: 34 minutes. Of more, the oldest are dropped."""


@dataclass(slots=True)
class DetectorState:
    """All that a detector remembers; one restored from it (codec.py) goes on bit for bit.

    Cells are counted on the absolute grid. accel, gyro: samples and rows not classified yet. gyro_expected:
    whether accelerometer windows wait for the gyroscope. next_cell: the first one not classified yet.
    epoch_end: the cell where the noise floors are renewed next, epoch_cells after the last time. pace: the
    density of samples, which sets the length of windows. floors, coarse: of accelerometer and gyroscope.
    gathered: the state of gathering.
    """

    mode: Mode
    accel: Stream = field(default_factory=Stream)
    gyro: Stream = field(default_factory=Stream)
    gyro_expected: bool = True
    next_cell: float = -math.inf
    epoch_end: float = -math.inf
    epoch_cells: int = _FIRST_EPOCH
    pace: Density = field(default_factory=Density)
    floors: list[Floor] = field(default_factory=lambda: [Floor(), Floor()])
    coarse: list[Coarseness] = field(default_factory=lambda: [Coarseness(), Coarseness()])
    gathered: GatherState = field(default_factory=GatherState)


def _before(rows: Array, cell: float) -> Array:
    """Return the rows before a cell."""
    return rows[: np.searchsorted(rows[:, K], cell)]


class StationaryDetector:
    """Finds rests in two streams of samples, fed in any interleaving; it never waits and reads no clock."""

    def __init__(self, settings: DetectorSettings | None = None, state: DetectorState | None = None) -> None:
        self.settings = settings or DetectorSettings()
        self._state = copy.deepcopy(state) if state else DetectorState(self.settings.mode)
        self._state.accel, self._state.gyro = self._state.accel.reshaped(), self._state.gyro.reshaped()
        run = self._state.gathered.run
        run.rows = run.rows.reshape(-1, 2 * COLUMNS)
        self._gatherer = Gatherer(self.settings, self._state.gathered)
        self._unlearnt: list[tuple[Windows, Codes, Flags]] = []
        """Windows of the present epoch not learnt from yet, their labels, and which of them were looked at.

        What they teach is used from the next epoch on, so that they are learnt from together."""

    @property
    def state(self) -> DetectorState:
        """A copy of all that is remembered, which further feeding does not change."""
        self._learn()
        return copy.deepcopy(self._state)

    @property
    def ledger(self) -> Ledger:
        """What was asked for and read so far, and the labels of windows and candidate rests."""
        self._learn()
        return self._state.gathered.ledger.copy()

    @property
    def asked_s(self) -> float:
        """For how long samples were asked for so far, s."""
        return self._state.gathered.ledger.asked_s

    @property
    def mode(self) -> Mode:
        """How the detector runs now."""
        return self._state.mode

    def feed(self, *blocks: Samples) -> list[RestState]:
        """Take blocks of either sensor, each stream in time order; return the rests that they complete.

        An accelerometer window waits for gyroscope samples of the same time, up to max_lag_s of stream time.
        Blocks passed in one call are taken together. Raises ValueError where a stream runs backwards.
        """
        counted = self._unasked_until(blocks)
        for block in blocks:
            self._take(block, counted)
        self._advance(self._horizon())
        self._state.gyro.rows = self._state.gyro.rows[-_MOST_ALONE:]
        return self._gatherer.take_rests()

    def finish(self) -> list[RestState]:
        """Classify what is buffered, close the open rest, and return the rests that this completes."""
        state, window = self._state, self.settings.window_s
        state.accel = take(state.accel, Samples.empty(Sensor.ACCELEROMETER), window, close=True)
        state.gyro = take(state.gyro, Samples.empty(Sensor.GYROSCOPE), window, close=True)
        self._advance(math.inf)
        self._gatherer.stop()
        return self._gatherer.take_rests()

    def cut_rest(self, longest_s: float) -> list[RestState]:
        """Return the open rest where it has lasted so long (s) in scan mode, without waiting for its end."""
        self._gatherer.cut(cells_of(longest_s, self.settings.window_s))
        return self._gatherer.take_rests()

    def set_mode(self, mode: Mode) -> list[RestState]:
        """Switch between scanning and probing from the next window on; return the rests that this closes."""
        if mode is not self._state.mode:
            self._gatherer.stop()
            self._state.mode, self._state.gathered.probe = mode, None
        return self._gatherer.take_rests()

    def learn_gyroscope_anew(self) -> None:
        """Forget the gyroscope's noise, because it no longer is what was learnt."""
        self._learn()
        self._state.floors[1], self._state.coarse[1] = Floor(), Coarseness()

    def wants(self, now: float) -> Want:
        """Return the detector's request at time `now`, s: samples until some time, or none before one.

        A probe for which no sample came is given up max_lag_s after its end, and the next one is drawn.
        """
        return Sense(math.inf) if self._state.mode is Mode.SCAN else self._gatherer.wants(now)

    def next_probe(self, now: float) -> float:
        """Return when the current or next probe begins, s; in scan mode `now`."""
        window = self.settings.window_s
        return now if self._state.mode is Mode.SCAN else self._gatherer.due(now / window).start * window

    @property
    def judged_by(self) -> tuple[float, ...]:
        """What `still_valid` goes by; as long as this stays the same, so do its answers."""
        accel, gyro = self._state.floors
        return (*accel.level.tolist(), *gyro.level.tolist(), *(c.step for c in self._state.coarse))

    def still_valid(self, rest: RestState) -> bool:
        """Tell whether an accepted rest still counts as one by the noise floors as they are known now.

        A rest accepted while the floor was too high, because nothing quieter had been seen, fails later. The
        standard deviation of the rest's samples is compared with the floor of its own sampling rate.
        """
        state, k = self._state, self.settings
        pairs = ((rest.force_sd, k.accel_factor), (rest.rate_sd, k.gyro_factor))
        rate = octave_of(rest.n / max(rest.duration, 1e-9))
        for floor, coarse, (sd, factor) in zip(state.floors, state.coarse, pairs, strict=True):
            if sd is None:
                continue
            x, y, z = sd.tolist()
            limit = math.hypot(factor * float(floor.level[rate]), coarse.step)
            if math.sqrt((x * x + y * y + z * z) / 3.0) > limit:
                return False
        return True

    def noise_floor(self, rate_hz: float) -> tuple[float, float]:
        """Return both sensors' noise floors at a sampling rate, m/s^2 and rad/s, inf where unknown yet."""
        octave = octave_of(rate_hz)
        return float(self._state.floors[0].level[octave]), float(self._state.floors[1].level[octave])

    def _unasked_until(self, blocks: Iterable[Samples]) -> float:
        """Return the cell before which these blocks complete every window, and no probe asks for one.

        All cells of the longest windows, of BLOCK cells, lie on one side of it.
        """
        state, window = self._state, self.settings.window_s
        if state.mode is Mode.SCAN or state.gathered.probe is None:
            return -math.inf
        streams = {Sensor.ACCELEROMETER: state.accel.t, Sensor.GYROSCOPE: state.gyro.t}
        streams |= {block.sensor: block.t for block in blocks if len(block)}
        accel, gyro = (np.floor(t[-1] / window) if t.size else -math.inf for t in streams.values())
        known = min(accel, gyro) if state.gyro_expected or gyro >= state.next_cell else accel
        return float(np.floor(min(known, state.gathered.probe.start) / BLOCK) * BLOCK)

    def _take(self, block: Samples, counted: float) -> None:
        """Add a block to its stream; rows that come too late to be classified are dropped.

        counted: of the cells before this one only the number of samples will be asked for.
        """
        state, accel = self._state, block.sensor is Sensor.ACCELEROMETER
        stream = state.accel if accel else state.gyro
        last = stream.t[-1] if stream.t.size else -math.inf
        if len(block) and block.t[0] < last:
            raise ValueError(f"{block.sensor} runs backwards, from {last:.6f} to {block.t[0]:.6f} s: sort it")
        stream = take(stream, block, self.settings.window_s, counted=counted)
        late = int(np.searchsorted(stream.rows[:, K], state.next_cell))
        stream.rows = stream.rows[late:]
        if accel:
            state.accel = stream
        else:
            state.gyro = stream
            state.gathered.ledger.gyro_late += late

    def _horizon(self) -> float:
        """Return the first cell that is not complete yet, and decide whether to wait for the gyroscope."""
        state, window = self._state, self.settings.window_s
        if state.accel.t.size == 0:
            return -math.inf
        accel = float(math.floor(state.accel.t[-1] / window))
        gyro = float(math.floor(state.gyro.t[-1] / window)) if state.gyro.t.size else -math.inf
        start = float(state.accel.rows[0, K]) if state.accel.rows.shape[0] else accel
        gyro_missing = accel - max(gyro, start) > self.settings.max_lag_s / window
        state.gyro_expected = not gyro_missing and (state.gyro_expected or gyro >= state.next_cell)
        return min(accel, gyro) if state.gyro_expected else accel

    def _advance(self, horizon: float) -> None:
        """Classify all windows that are complete before cell `horizon`."""
        state = self._state
        accel, gyro = _before(state.accel.rows, horizon), _before(state.gyro.rows, horizon)
        at, present = matched(gyro[:, K], accel[:, K])
        counts = accel[:, N].copy()
        counts[present] = np.minimum(counts[present], gyro[at[present], N])
        widths = window_cells(state.pace, accel[:, K], counts, self.settings.min_samples)
        ends = (np.floor(accel[:, K] / widths) + 1.0) * widths
        whole = int(np.searchsorted(ends, horizon, side="right"))
        if whole == 0:
            return
        if state.mode is Mode.PROBE and self._gatherer.skip_to(float(ends[whole - 1])):
            self._count_unasked(accel[:whole], ends[:whole] - widths[:whole])
        else:
            self._classify_epochs(Windows.of(accel[:whole], gyro, widths[:whole], self.settings))
        state.pace = with_rows(state.pace, accel[:whole, K], counts[:whole])
        state.next_cell = float(ends[whole - 1])
        state.accel.rows = state.accel.rows[whole:]
        state.gyro.rows = state.gyro.rows[np.searchsorted(state.gyro.rows[:, K], state.next_cell) :]

    def _count_unasked(self, rows: Array, starts: Array) -> None:
        """Count the samples of cells that no probe asks for. starts: (n,) of the windows they belong to."""
        state = self._state
        first = int(np.searchsorted(starts, state.epoch_end))
        while first < starts.size:
            self._renew(starts[first])
            first = int(np.searchsorted(starts, state.epoch_end))
        state.gathered.ledger.accel_unasked += int(rows[:, N].sum())

    def _classify_epochs(self, windows: Windows) -> None:
        """Classify windows, renewing the noise floors wherever an epoch ends."""
        state, first = self._state, 0
        starts = windows.rows[:, K]
        while first < len(windows):
            if starts[first] >= state.epoch_end:
                self._renew(starts[first])
            last = int(np.searchsorted(starts, state.epoch_end))
            self._classify(windows[slice(first, last)])
            first = last

    def _classify(self, windows: Windows) -> None:
        """Classify the windows of one epoch and gather rests from them."""
        state = self._state
        steps = (state.coarse[0].step, state.coarse[1].step)
        codes = classify(windows, (state.floors[0], state.floors[1]), state.coarse[0].coarse, self.settings)
        if state.mode is Mode.SCAN:
            looked = np.ones(len(windows), dtype=bool)
            self._gatherer.scan(windows.rows, codes, steps)
        else:
            looked = self._gatherer.probe(windows.rows, codes, steps)
        self._unlearnt.append((windows, codes, looked))

    def _learn(self) -> None:
        """Learn from the windows classified since the last time, and enter them into the ledger."""
        if self._unlearnt:
            parts, codes, looked = zip(*self._unlearnt, strict=True)
            windows = Windows.joined(parts), np.concatenate(codes), np.concatenate(looked)
            self._unlearnt = []
            self._train(*windows)
            self._count(*windows)

    def _train(self, windows: Windows, codes: Codes, looked: Flags) -> None:
        """Train the noise floors and the sensors' coarseness with the windows looked at."""
        state = self._state
        ceilings = (self.settings.accel_ceiling, self.settings.gyro_ceiling)
        may_train = trainable(windows, codes)
        for i, half in enumerate((windows.accel, windows.gyro)):
            use = may_train[i] & looked
            state.floors[i] = counted(state.floors[i], half.rates[use], half.spread[use])
            state.coarse[i] = state.coarse[i].observed(half, looked, ceilings[i])

    def _count(self, windows: Windows, codes: Codes, looked: Flags) -> None:
        """Enter the windows into the ledger."""
        ledger, window = self._state.gathered.ledger, self.settings.window_s
        width = windows.rows[:, K_END] - windows.rows[:, K]
        accel_n, gyro_n = windows.accel.rows[:, N], windows.gyro.rows[:, N]
        ledger.accel_samples += int(accel_n[looked].sum())
        ledger.gyro_samples += int(gyro_n[looked].sum())
        ledger.accel_unasked += int(accel_n[~looked].sum())
        ledger.accel_on_s += float(width[looked].sum()) * window
        ledger.gyro_on_s += float(width[looked & (gyro_n > 0)].sum()) * window
        for code, count in enumerate(np.bincount(codes[looked], minlength=len(LABELS)).tolist()):
            if count:
                ledger.windows[LABELS[code]] = ledger.windows.get(LABELS[code], 0) + count

    def _renew(self, cell: float) -> None:
        """Begin an epoch: use what was learnt in the last one."""
        self._learn()
        state, k = self._state, self.settings
        state.floors = [renewed(floor, k) for floor in state.floors]
        state.coarse = [coarse.renewed(k) for coarse in state.coarse]
        if math.isfinite(state.epoch_end):
            state.epoch_cells = min(2 * state.epoch_cells, _LAST_EPOCH)
        state.epoch_end = (math.floor(cell / state.epoch_cells) + 1.0) * state.epoch_cells
