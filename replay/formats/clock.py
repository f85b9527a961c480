"""The time stamps of one file: their unit, rows out of order, repeats, gaps.

Time must not run backwards, nor jump by years, as where a log changes from one clock to another: such a
recording is refused with the row. Irregularities that are tolerated are
counted and reported in notes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.columns import LONG_TIME_UNITS, TIME_UNITS, ColumnMap
from stillcal.replay.formats.errors import TraceError

FASTEST_STEP_S = 5e-4
"""2 kHz, s: with a unit chosen by itself the median step lies between this and 1000 times it."""

SLOWEST_STEP_S = 1.02
"""s: a longer median step is another unit of time; a sensor's of less than 1 kHz is longer in ms. The 2 % are
for a log at 1 Hz: clocks are off by so much, and the median of uneven steps by less."""

GAP_S = 1.0
"""s: a step longer than this (and than ten median steps) is counted as a gap."""

TWO_CLOCKS_S = 10 * 365.25 * 86400.0
"""s: a longer step is no gap but another clock, as from the time since the start to that since 1970."""

_EPOCH_S = (9.5e8, 4.1e9)
"""s since 1970 of the years 2000 to 2100."""

_SPREADSHEET_DAYS = (36_500, 73_100)
"""The same years in days since 1899-12-30."""

REPEATS_ALLOWED = 0.05
"""Share of stamps that may repeat the previous one; with more, the clock is too coarse or has stopped."""


@dataclass(slots=True)
class Rows:
    """Rows on their way to samples: t (n,) s, values (n, k) in the file's units, lines (n,) in the file."""

    t: Array
    values: Array
    lines: NDArray[np.int64]

    def __len__(self) -> int:
        return int(self.t.size)

    def chosen(self, which: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Rows:
        """Return the rows chosen by a mask, an order or a slice."""
        return Rows(self.t[which], self.values[which], self.lines[which])

    def after(self, earlier: Rows | None) -> Rows:
        """Return these rows with `earlier` ones in front."""
        if earlier is None or not len(earlier):
            return self
        return Rows(
            np.concatenate([earlier.t, self.t]),
            np.concatenate([earlier.values, self.values]),
            np.concatenate([earlier.lines, self.lines]),
        )


@dataclass(slots=True)
class Tally:
    """Counts of irregularities, for the notes. twice: s, of rows left out whose readings repeat too."""

    samples: int = 0
    repeats: int = 0
    twice: list[Array] = field(default_factory=list)
    first_repeat: int = 0
    reordered: int = 0
    gaps: int = 0
    longest_gap: float = 0.0
    longest_gap_line: int = 0


@dataclass(slots=True)
class Clock:
    """Puts the rows of one file in time order, block by block, holding back at most `reorder` rows.

    readings: the columns of values that hold what the sensors read.
    """

    path: Path
    column_map: ColumnMap
    readings: NDArray[np.int64]
    tally: Tally = field(default_factory=Tally)
    _held_back: Rows | None = None
    _last: float = -np.inf
    _last_read: Array | None = None

    def ordered(self, rows: Rows) -> Rows:
        """Return rows that are surely next in time. Raises TraceError where time runs backwards."""
        window = self.column_map.reorder
        if window:
            self.tally.reordered += int(np.count_nonzero(np.diff(rows.t) < 0))
            rows = self._sorted(rows.after(self._held_back), window)
            rows, self._held_back = rows.chosen(slice(None, -window)), rows.chosen(slice(-window, None))
        return self._accepted(rows)

    def _sorted(self, rows: Rows, window: int) -> Rows:
        """Return the rows in time order. Raises TraceError where one moves by more than `window` rows."""
        order = np.argsort(rows.t, kind="stable")
        late = order[order - np.arange(len(order)) > window]
        if late.size:
            first = int(late.min())
            self._refuse(rows, first, float(rows.t[:first].max() - rows.t[first]))
        return rows.chosen(order)

    def rest(self) -> Rows | None:
        """Return the rows still held back at the end of the file, None where there are none."""
        held_back, self._held_back = self._held_back, None
        return None if held_back is None or not len(held_back) else self._accepted(held_back)

    def _accepted(self, rows: Rows) -> Rows:
        if not len(rows):
            return rows
        step = np.diff(rows.t, prepend=self._last)
        self._refuse_backwards(rows, step)
        self._count_gaps(rows, step)
        self._last = float(rows.t[-1])
        self.tally.samples += len(rows)
        repeated = step == 0
        kept = self._without_repeats(rows, repeated) if repeated.any() else rows
        self._last_read = rows.values[-1, self.readings]
        return kept

    def _refuse_backwards(self, rows: Rows, step: Array) -> None:
        backwards = step < 0
        if backwards.any():
            i = int(backwards.argmax())
            self._refuse(rows, i, float(-step[i]))

    def _refuse(self, rows: Rows, i: int, back: float) -> NoReturn:
        what = f"time runs backwards by {back:.6g} s, to {rows.t[i]:.6f} s"
        remedy = "cut the recording there, or put its rows in order (a column map's `reorder`)"
        raise TraceError(self.path, what, remedy, int(rows.lines[i]))

    def _without_repeats(self, rows: Rows, repeated: NDArray[np.bool_]) -> Rows:
        tally, policy = self.tally, self.column_map.repeats
        first = int(rows.lines[int(repeated.argmax())])
        if policy == "refuse":
            what = "the time stamp repeats the one before"
            raise TraceError(self.path, what, "delete one of the two rows", first)
        tally.first_repeat = tally.first_repeat or first
        tally.repeats += int(repeated.sum())
        if policy == "keep":
            return rows
        if tally.repeats > 10 and tally.repeats > REPEATS_ALLOWED * tally.samples:
            what = f"{tally.repeats} of {tally.samples} time stamps repeat the one before"
            remedy = "record with finer stamps, or read it by a column map with repeats = 'keep'"
            raise TraceError(self.path, what, remedy, tally.first_repeat)
        tally.twice.append(rows.t[repeated & self._read_again(rows)])
        return rows.chosen(~repeated)

    def _read_again(self, rows: Rows) -> NDArray[np.bool_]:
        """Return which rows (n,) read what the one before does; its arrival may be another."""
        read = rows.values[:, self.readings]
        first = np.full((1, read.shape[1]), np.nan) if self._last_read is None else self._last_read[None]
        return np.asarray((read == np.concatenate([first, read[:-1]])).all(axis=1))

    def _count_gaps(self, rows: Rows, step: Array) -> None:
        finite = np.isfinite(step)
        if not (finite & (step > GAP_S)).any():
            return
        gaps = finite & (step > max(GAP_S, 10 * float(np.median(step[finite]))))
        if gaps.any():
            longest = int(np.where(gaps, step, 0).argmax())
            if step[longest] > TWO_CLOCKS_S:
                what = f"time jumps ahead by {step[longest]:.6g} s, to {rows.t[longest]:.6f} s: two clocks"
                remedy = "cut the recording there, or give a column of one clock"
                raise TraceError(self.path, what, remedy, int(rows.lines[longest]))
            self.tally.gaps += int(gaps.sum())
            if step[longest] > self.tally.longest_gap:
                self.tally.longest_gap = float(step[longest])
                self.tally.longest_gap_line = int(rows.lines[longest])

    def notes(self) -> list[str]:
        """Return the irregularities that were tolerated, one line each."""
        tally, lines = self.tally, []
        if tally.reordered:
            lines.append(f"{tally.reordered} rows were out of time order and were sorted")
        if tally.repeats:
            done = "kept" if self.column_map.repeats == "keep" else "skipped"
            where = f"first in line {tally.first_repeat}"
            lines.append(f"{tally.repeats} samples repeat the previous time stamp and were {done} ({where})")
        if tally.gaps:
            longest = f"{tally.longest_gap:.6g} s before line {tally.longest_gap_line}"
            lines.append(f"{tally.gaps} gaps in time, the longest {longest}")
        return lines


def seconds_per_unit(unit: str, stamps: Array, rate_hz: float | None) -> float | None:
    """Return the length of one unit of a time column, s; None where "auto" finds no unit.

    stamps: (n,) the file's first stamps.
    """
    if unit == "samples":
        return 1.0 / rate_hz if rate_hz else None
    if unit == "date":
        return 1.0
    return _shown_unit(stamps) if unit == "auto" else (TIME_UNITS | LONG_TIME_UNITS)[unit]


def unit_since_1970(stamp: float) -> float | None:
    """Return the length, s, of the unit in which a stamp is a time since 1970; None where it is none."""
    return next((s for s in TIME_UNITS.values() if _EPOCH_S[0] < stamp * s < _EPOCH_S[1]), None)


def _shown_unit(stamps: Array) -> float | None:
    """Return the length of the unit that stamps show themselves to have, s; None where they show none.

    It is the only power of 1000 that puts the median step between 0.5 ms and 0.5 s, as in logs whose unit
    differs between devices (Stisen et al. 2015). Times since 1970 have the unit that their size shows, and
    step by 1 s at most; numbers of days are a spreadsheet's. Steps of about one, or a half, show no unit:
    they may be s of a slow log, ms of a fast one, or numbers of samples.
    """
    step = np.abs(np.diff(stamps))
    step = step[step > 0]
    if not step.size:
        return None
    typical, first = float(np.median(step)), float(stamps[0])
    units, day = TIME_UNITS.values(), LONG_TIME_UNITS["days"]
    days = day if _SPREADSHEET_DAYS[0] < first < _SPREADSHEET_DAYS[1] else None
    dated = [
        s for s in (unit_since_1970(first), days) if s and FASTEST_STEP_S <= typical * s <= SLOWEST_STEP_S
    ]
    in_range = [s for s in units if FASTEST_STEP_S <= typical * s < 1000 * FASTEST_STEP_S]
    fits = dated or ([] if 1000 * FASTEST_STEP_S <= typical <= SLOWEST_STEP_S else in_range)
    return fits[0] if fits else None
