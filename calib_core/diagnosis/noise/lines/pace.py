"""The pace of a heart or of steps that a line is an overtone of."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import Index
from stillcal.calib_core.diagnosis.noise.lines.steady_segments import Stretches

PACES = (0.6, 3.0)
"""Hz of hearts and steps."""

CONTRAST = 5.0
"""Times the usual power that a lower overtone has at least."""

REACH = 20
"""Frequencies on either side that tell the usual power."""


def pace_of(seen: Stretches, rows: Index, at: Array | float) -> float | None:
    """Return the pace of a heart or of steps, in frequencies, that a line is an overtone of; None without.

    Its lower neighbours stand at multiples of one pace, and go with it. at: the line's place in all of these
    stretches, or (n,) in each.
    """
    if not rows.size:
        return None
    places = np.broadcast_to(np.asarray(at, dtype=np.float64), rows.shape)
    middle, step = float(np.median(places)), float(seen.f[1])
    line = float(_about(seen, rows, places, 1).max())
    for n in range(2, int(middle * step / PACES[0]) + 1):
        if not PACES[0] <= middle / n * step <= PACES[1]:
            continue
        lower = [places * (n - k) / n for k in (1, 2) if n > k]
        tops = [float(_about(seen, rows, j, 2).max()) for j in lower]
        usual = [float(np.median(_about(seen, rows, j, REACH, 1))) for j in lower]
        if all(p > 0.5 * line and p > CONTRAST * u for p, u in zip(tops, usual, strict=True)):
            return middle / n
    return None


def _about(seen: Stretches, rows: Index, places: Array, reach: int, first: int = 0) -> Array:
    """Return the power of all axes about places (n,), those of all stretches put on each other.

    first: the lowest frequency that counts.
    """
    near = np.rint(places).astype(np.int64)
    low = max(-reach, first - int(near.min()))
    high = min(reach, seen.f.size - 1 - int(near.max()))
    at = near[:, None] + np.arange(low, high + 1)
    return np.asarray(seen.power[rows[:, None], at].sum(axis=(0, 2)))
