"""A further logged quantity of a recording, such as battery voltage or a motor's speed, over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A quantity over time. t: (m,) s, not decreasing; values: (m,)."""

    t: Array
    values: Array

    def at(self, t: Array) -> Array:
        """Return the values at times t (n,), between the logged ones by straight lines."""
        return np.asarray(np.interp(t, self.t, self.values))
