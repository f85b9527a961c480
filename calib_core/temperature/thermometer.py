"""The thermometer's readings of late, and how warm a sensor is that follows them late.

A thermometer and a sensor seldom sit in one place: while the phone warms up, one runs ahead of the other. A
sensor that follows the thermometer with a lag has the temperature of a first-order filter of its readings.
The lag is one of LAGS_S, or none; which one, the rests decide (calibration/bias_curve).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.maths.robust import MAD_TO_SD

LAGS_S = (60.0, 120.0, 240.0, 480.0)
"""Lags that are tried, s: a chip's and a phone's warm-up take 2 to 20 min."""

CELL_S = 30.0
"""One reading is kept for each of these cells of time, its first."""

SPAN_S = 3600.0
"""Readings older than this count for nothing: of a lag of 480 s, 0.06 % of a difference is left by then."""

LATE_S = 1800.0
"""Readings are kept for so much longer, because a temperature may be asked for that long after its time: that
of a rest is, when the rest has ended."""

FRESH_S = 600.0
"""A reading that is older tells nothing of the temperature now."""

JUMP_K, JUMP_K_PER_S = 4.0, 0.05
"""A reading jumps that differs by more than these, K and K/s, from one of at most NEAR_S before. In half a
minute that is 5.5 K; a phone that falls into cold water cools by some 5 K a minute."""

NEAR_S = 90.0

SCATTERS = 3.0
"""Standard deviations of neighbouring readings' differences that a jump is larger, for chips scatter."""

FEWEST, UNKNOWN_K = 10, 1.0
"""Readings within SPAN_S that tell how much they scatter, and the scatter, K, that fewer are allowed."""

STEADY_S = 86400.0
"""A thermometer that jumped is believed again when it has gone on for so long without another jump."""

_STRAY_K_PER_S = 0.2 / 60.0
"""K/s by which the temperature may differ from a reading of before. Of the simulated lives of
benchmarks/truth.py the root mean square is 0.2 K after one minute, 0.8 to 1.1 K after five."""

_UNKNOWN_K = 0.5
"""A lagged temperature that may be off by more is unknown."""

_FIRST_K, _DRIFT_K, _DRIFT_S = 3.0, 1.0, 1800.0
"""How far a sensor may be from the first reading, and how far a temperature may stray between two readings
that lie this long apart or longer."""


@dataclass(frozen=True, slots=True)
class Reading:
    """A reading of some time ago. celsius: degC. age_s: s."""

    celsius: float
    age_s: float

    @property
    def stray_k(self) -> float:
        """The standard uncertainty, K, of the temperature now, for the reading's age."""
        return _STRAY_K_PER_S * self.age_s


@dataclass(frozen=True, slots=True)
class Doubt:
    """That a thermometer's readings jumped. jumped_at: s. t, celsius: s, degC, of its newest reading.

    scatter_k: K, standard deviation of what neighbouring readings differed by. steady_s: s without a jump
    after which it is over.
    """

    jumped_at: float
    t: float
    celsius: float
    scatter_k: float = 0.0
    steady_s: float = STEADY_S

    @property
    def from_first(self) -> bool:
        """Whether the reading that they jumped from was a first one, which is as doubtful as they are."""
        return self.steady_s < STEADY_S

    def after(self, t: float, celsius: float, believed: Reading | None) -> Doubt | None:
        """Return the doubt after a further reading, None where it is over.

        It is where the reading is back at the last one that was believed, by a jump or while nobody looked,
        or has been without a jump for long enough. believed: that one, as old as it is then; None without.
        """
        jumped = bool(jumps(t - self.t, celsius - self.celsius, self.scatter_k))
        back = (
            (jumped or t - self.t > NEAR_S)
            and believed is not None
            and believed.age_s <= FRESH_S
            and abs(celsius - believed.celsius) <= JUMP_K + SCATTERS * self.scatter_k
        )
        if back or t - self.jumped_at >= self.steady_s:
            return None
        return replace(self, jumped_at=t if jumped else self.jumped_at, t=t, celsius=celsius)


@dataclass(frozen=True, slots=True, eq=False)
class Thermometer:
    """Readings that are believed, oldest first, at most one for each cell. t: (n,) s. celsius: (n,) degC.

    doubt: that its readings jumped, None while they are believed. Doubted readings are not kept. They are
    believed again when they are back, within FRESH_S, at the last one that was, or have gone on for STEADY_S
    without another jump. Of a first reading and those that jump from it nobody knows which are right: it is
    not kept either, and they are believed after FRESH_S.
    """

    t: Array = field(default_factory=lambda: frozen(np.empty(0)))
    celsius: Array = field(default_factory=lambda: frozen(np.empty(0)))
    doubt: Doubt | None = None

    def with_readings(self, t: Array, celsius: Array) -> Thermometer:
        """Return the thermometer with readings (n,) more, whatever their order; what is old is forgotten.

        What is kept of the same readings does not depend on how they were cut into calls.
        """
        all_of_them = self._joined(t, celsius)
        if not all_of_them.t.size:
            return all_of_them
        kept = all_of_them.t >= all_of_them.t[-1] - SPAN_S - LATE_S
        return replace(all_of_them, t=frozen(all_of_them.t[kept]), celsius=frozen(all_of_them.celsius[kept]))

    def doubts(self, t: float) -> bool:
        """Tell whether a reading at t (s), a time of late, is doubted."""
        return self.doubt is not None and (not self.t.size or t // CELL_S > self.t[-1] // CELL_S)

    def _joined(self, t: Array, celsius: Array) -> Thermometer:
        """Return the first reading of every cell, these and further ones (n,) taken together."""
        known = _first_of_cells(t, celsius)
        times = np.concatenate((self.t, t[known]))
        values = np.concatenate((self.celsius, celsius[known]))
        if (times[1:] < times[:-1]).any():
            order = np.argsort(times, kind="stable")
            times, values = times[order], values[order]
        first = np.diff(np.floor(times / CELL_S), prepend=-np.inf) > 0
        return self._judged(times[first], values[first])

    def _judged(self, t: Array, celsius: Array) -> Thermometer:
        """Return the thermometer after readings (n,), one for each cell, without those that are doubted."""
        if self.doubt is None and not jumps(np.diff(t), np.diff(celsius)).any():
            return Thermometer(frozen(t), frozen(celsius))
        newest = float(self.t[-1]) if self.t.size else -np.inf
        believed = np.flatnonzero(t <= newest).tolist()
        doubt = self.doubt
        for k in range(len(believed), len(t)):
            now, read = float(t[k]), float(celsius[k])
            if doubt is None:
                doubt = _doubted(t, celsius, believed, k)
                if doubt is not None and doubt.from_first:
                    believed.pop()
            elif now // CELL_S > doubt.t // CELL_S:
                last = believed[-1] if believed else None
                doubt = doubt.after(
                    now, read, None if last is None else Reading(float(celsius[last]), now - float(t[last]))
                )
            if doubt is None:
                believed.append(k)
        return Thermometer(frozen(t[believed]), frozen(celsius[believed]), doubt)

    def latest(self, t: float) -> Reading | None:
        """Return the newest reading at t (s) that is kept, None where it is older than FRESH_S.

        Of each cell the first reading is kept: a phone may have told a newer one within the last CELL_S.
        """
        heard = int(np.searchsorted(self.t, t, side="right"))
        if not heard or t - self.t[heard - 1] > FRESH_S:
            return None
        return Reading(float(self.celsius[heard - 1]), t - float(self.t[heard - 1]))

    def believed(self, t: Array, celsius: Array) -> Array:
        """Return a run of readings (n,) degC at times t (n,) s without those that are doubted.

        For FRESH_S the last one believed stands in for them; after that they are NaN. A jump counts from the
        cell after it on.
        """
        heard = self._joined(t, celsius)
        last = np.searchsorted(heard.t, t, side="right") - 1
        since, held = np.r_[heard.t, -np.inf][last], np.r_[heard.celsius, np.nan][last]
        own = np.floor(since / CELL_S) == np.floor(t / CELL_S)
        return np.where(own | np.isnan(celsius), celsius, np.where(t - since <= FRESH_S, held, np.nan))

    def lagged(self, t: float, celsius: float) -> Array:
        """Return the temperatures of sensors that follow with each of LAGS_S, (k,) degC, NaN where unknown.

        t: s. celsius: degC, the reading then.
        """
        past = (self.t < t) & (self.t >= t - SPAN_S)
        return frozen(_followed(np.r_[self.t[past], t], np.r_[self.celsius[past], celsius]))

    def course(self, t: Array, celsius: Array) -> Array:
        """Return the same for a run of readings (n,) degC at times t (n,) s: (n, k), NaN where unknown.

        From the first reading of a cell on it is the filter's answer to a straight line from there to each
        reading: the same however the readings are cut into calls.
        """
        heard = self._joined(t, celsius)
        if not heard.t.size:
            return frozen(np.full((len(t), len(LAGS_S)), np.nan))
        own = np.searchsorted(np.floor(heard.t / CELL_S), np.floor(t / CELL_S))
        own = np.minimum(own, heard.t.size - 1)
        behind = np.full((heard.t.size, len(LAGS_S)), np.nan)
        for k in np.unique(own):
            begun = float(heard.celsius[k])
            behind[k] = heard.lagged(float(heard.t[k]), begun) - begun
        past = np.maximum(t - heard.t[own], 0.0)[:, None] / np.array(LAGS_S)
        rise = (celsius - heard.celsius[own])[:, None]
        answered = -np.expm1(-past) / np.maximum(past, 1e-12)
        return frozen(celsius[:, None] + behind[own] * np.exp(-past) - rise * answered)


def _first_of_cells(t: Array, celsius: Array) -> NDArray[np.intp]:
    """Return the places of known readings (n,) that may be the first of their cells.

    These are one for each cell if t is in order: later ones are never kept.
    """
    known = np.flatnonzero(np.isfinite(celsius))
    own = t if known.size == t.size else t[known]
    if (own[1:] < own[:-1]).any():
        return known
    cells = np.floor(own / CELL_S)
    return known[np.flatnonzero(np.diff(cells, prepend=-np.inf) > 0)]


def _doubted(t: Array, celsius: Array, believed: list[int], k: int) -> Doubt | None:
    """Return the doubt that begins with reading k of (n,); None where it goes on from those believed."""
    if not believed:
        return None
    last, now, read = believed[-1], float(t[k]), float(celsius[k])
    gap, rise = now - float(t[last]), read - float(celsius[last])
    if not jumps(gap, rise):
        return None
    recent = [i for i in believed[-int(SPAN_S / CELL_S) :] if t[i] >= now - SPAN_S]
    apart = np.abs(np.diff(celsius[recent]))
    scatter = MAD_TO_SD * float(np.median(apart)) if len(recent) >= FEWEST else UNKNOWN_K
    if not jumps(gap, rise, scatter):
        return None
    first = len(believed) == 1 or t[last] - t[believed[-2]] > NEAR_S
    return Doubt(now, now, read, scatter, FRESH_S if first else STEADY_S)


def jumps(gap_s: Array | float, rise_k: Array | float, scatter_k: float = 0.0) -> NDArray[np.bool_]:
    """Tell whether readings differ by more than those of a phone can. gap_s: (n,) s. rise_k: (n,) K.

    scatter_k: K, standard deviation of what neighbouring readings differ by.
    """
    most = JUMP_K + JUMP_K_PER_S * np.abs(gap_s) + SCATTERS * scatter_k
    return np.asarray((np.abs(rise_k) > most) & (np.abs(gap_s) <= NEAR_S))


def felt(celsius: Array, lagged: Array | None, lag_s: float, lags_s: tuple[float, ...] = LAGS_S) -> Array:
    """Return the temperatures (n,) degC of a sensor that follows the thermometer with a lag, s.

    celsius: (n,) readings. lagged: (n, k), for each of lags_s, None where unknown. Where a lagged temperature
    is unknown, it is the reading.
    """
    if lag_s not in lags_s or lagged is None:
        return celsius
    late = np.atleast_2d(lagged)[:, lags_s.index(lag_s)]
    return np.asarray(np.where(np.isfinite(late), late, celsius))


def _followed(t: Array, celsius: Array) -> Array:
    """Return the temperatures of lagging sensors at the last of readings (n,), (k,), NaN where unknown.

    A first-order filter's answer to readings that are joined by straight lines, from the first reading on.
    """
    lags = np.array(LAGS_S)
    left = np.exp((t - t[-1])[:, None] / lags)
    gained, gaps, rises = np.diff(left, axis=0), np.diff(t), np.diff(celsius)
    behind = ((rises / np.maximum(gaps, 1e-9))[:, None] * gained).sum(axis=0) * lags
    stray = 0.5 * np.abs(rises) + _DRIFT_K * np.minimum(gaps / _DRIFT_S, 1.0)
    doubt = _FIRST_K * left[0] + (np.where(gaps <= 3 * CELL_S, 0.0, stray)[:, None] * gained).sum(axis=0)
    return np.asarray(np.where(doubt <= _UNKNOWN_K, celsius[-1] - behind, np.nan))
