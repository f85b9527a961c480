"""When to probe and for how long: the random part of Algorithm 1, as pure functions of (seed, counter).

Counter-based draws need no hidden generator: a detector restored from its state draws the same times.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from stillcal.calib_core.static.settings import DetectorSettings

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
