"""The charger as a stand-in for a thermometer: what it has told of late, and how warm it has made the phone.

A phone on the charger warms up, and cools down again. Without a thermometer that much of its temperature is
known: the stand-in reads 0 K off the charger and FULL_K on it, and a sensor follows it with a lag, as it
follows a thermometer (thermometer.py). How much a bias changes over FULL_K, the rests decide.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.events import Charging
from stillcal.calib_core.temperature.thermometer import felt

CHARGER_LAGS_S = (300.0, 600.0, 1200.0, 2400.0)
"""Lags that are tried, s: a phone's case takes this long to warm up, a chip alone takes less."""

FULL_K = 10.0
"""K, what the stand-in reads on the charger: phones warm up by some 4 to 12 K there."""

SPAN_S = 8 * CHARGER_LAGS_S[-1]
"""Changes older than this count for nothing."""

MOST_CHANGES = 64
"""Changes that are kept: a loose plug that switches more often leaves the warmth unknown for a while."""

_UNKNOWN = 0.05
"""Share of FULL_K: a lagged reading that may be off by more is unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class Charger:
    """Changes of the charger, oldest first. t: (n,) s. on: (n,) 1 for plugged in, 0 for unplugged."""

    t: Array = field(default_factory=lambda: frozen(np.empty(0)))
    on: Array = field(default_factory=lambda: frozen(np.empty(0)))

    def with_events(self, events: Iterable[Any]) -> Charger:
        """Return the charger with events more, in time order; those of other kinds change nothing."""
        t, on = self.t.tolist(), self.on.tolist()
        for event in events:
            if isinstance(event, Charging) and (not on or on[-1] != event.on):
                t.append(max([event.t, *t[-1:]]))
                on.append(float(event.on))
        return Charger(frozen(np.array(t)), frozen(np.array(on)))

    def of_late(self) -> Charger:
        """Return the charger without the changes that count for nothing after the newest."""
        if not self.t.size:
            return self
        first = int(np.searchsorted(self.t, self.t[-1] - SPAN_S, side="right")) - 1
        first = max(first, self.t.size - MOST_CHANGES, 0)
        return Charger(self.t[first:], self.on[first:])

    def course(self, t: Array) -> Array:
        """Return the stand-in's readings at times t (n,) s, and those of sensors that follow it late.

        The result is (n, 1 + k) in K, the reading first, then one for each of CHARGER_LAGS_S; NaN where
        unknown. It is the exact answer of first-order filters to a reading that steps at every change. What
        was before the first change is unknown, and counts for less and less after it.
        """
        lags = np.array(CHARGER_LAGS_S)
        if not self.t.size:
            return frozen(np.full((len(t), 1 + lags.size), np.nan))
        level = np.full((self.t.size, lags.size), 0.5)
        left = np.exp(-np.diff(self.t)[:, None] / lags)
        for k in range(1, self.t.size):
            level[k] = self.on[k - 1] + (level[k - 1] - self.on[k - 1]) * left[k - 1]
        own = np.searchsorted(self.t, t, side="right") - 1
        since, now = np.maximum(t - self.t[own], 0.0), self.on[own]
        late = now[:, None] + (level[own] - now[:, None]) * np.exp(-since[:, None] / lags)
        doubt = 0.5 * np.exp(-np.maximum(t - self.t[0], 0.0)[:, None] / lags)
        late = np.where(doubt <= _UNKNOWN, late, np.nan)
        return frozen(FULL_K * np.column_stack((np.where(own < 0, np.nan, now), late)))

    def at(self, t: float) -> Array:
        """Return the same at one time, s: (1 + k,) K."""
        return frozen(self.course(np.array([t]))[0])


def followed(charged: Array, lag_s: float) -> Array:
    """Return the readings (n,) K of a sensor that follows the stand-in with a lag, s.

    charged: (n, 1 + k) K, as `Charger.course` has it. A lag that is none of CHARGER_LAGS_S, which another
    version may have learnt, gives NaN.
    """
    charged = np.atleast_2d(charged)
    if lag_s not in (0.0, *CHARGER_LAGS_S):
        return np.full(len(charged), np.nan)
    return felt(charged[:, 0], charged[:, 1:], lag_s, CHARGER_LAGS_S)
