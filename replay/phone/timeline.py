"""Quantities that change in steps, and their first-order lags: both are pure functions of time.

Charging, screen use and the room's temperature come in steps; heat follows them as first-order lags,
solved exactly from step to step so that any time can be asked for in any order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stillcal.calib_core.arrays import Array, frozen


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """A value that is constant between steps. t: (k,) s, rising; value: (k,), value[i] from t[i] on."""

    t: Array
    value: Array

    @classmethod
    def of(cls, t: ArrayLike, value: ArrayLike) -> Steps:
        """Return steps from times and values that are array-like."""
        return cls(frozen(t), frozen(value))

    def at(self, t: Array) -> Array:
        """Return the value at times (n,) s; before the first step it is the first value."""
        return self.value[np.maximum(np.searchsorted(self.t, t, side="right") - 1, 0)]

    def lagged(self, tau: float, initial: float | None = None) -> Lag:
        """Return the first-order response with time constant `tau` s, settled at start unless told."""
        first = float(self.value[0]) if initial is None else initial
        level = np.empty_like(self.value)
        level[0] = first
        decay = np.exp(-np.diff(self.t) / tau)
        for i, keep in enumerate(decay):
            level[i + 1] = self.value[i] + (level[i] - self.value[i]) * keep
        return Lag(self, frozen(level), tau)


@dataclass(frozen=True, slots=True, eq=False)
class Lag:
    """First-order response to steps. level: (k,) the response at each step's time; tau: s."""

    steps: Steps
    level: Array
    tau: float

    def at(self, t: Array) -> Array:
        """Return the response at times (n,) s."""
        i = np.maximum(np.searchsorted(self.steps.t, t, side="right") - 1, 0)
        target = self.steps.value[i]
        since = np.maximum(t - self.steps.t[i], 0.0)
        answer: Array = target + (self.level[i] - target) * np.exp(-since / self.tau)
        return answer
