"""A further logged quantity of a recording, such as battery voltage or a motor's speed, over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class TimeSeries:
    """A quantity over time. t: (m,) s, not decreasing; values: (m,)."""

    t: Array
    values: Array

    def at(self, t: Array) -> Array:
        """Return the values at times t (n,), between the logged ones by straight lines."""
        return np.asarray(np.interp(t, self.t, self.values))

    def mean(self, t: Array, duration: Array) -> Array:
        """Return the means (n,) over stretches about t of lengths `duration` (n,), s; 0 is an instant."""
        if self.t.size < 2:
            return self.at(t)
        steps = np.diff(self.t) * (self.values[1:] + self.values[:-1]) / 2.0
        sums = np.concatenate([[0.0], np.cumsum(steps)])
        half = np.maximum(duration, 0.0) / 2.0
        length = np.maximum(2.0 * half, 1e-300)
        whole = (self._sum(t + half, sums) - self._sum(t - half, sums)) / length
        return np.asarray(np.where(half > 0.0, whole, self.at(t)))

    def _sum(self, t: Array, sums: Array) -> Array:
        """Return the integral from the first logged time to t (n,). sums: (m,), that to the logged ones."""
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, self.t.size - 1)
        return np.asarray(sums[k] + (t - self.t[k]) * (self.values[k] + self.at(t)) / 2.0)
