"""Taking electronic noise off a stream: rolling mean, and the rolling median that it is compared with.

Grammenos et al. 2018, 4.6, Tables 1 and 2. Streaming, with the state explicit. Nothing about rests here.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from stillcal.calib_core.arrays import Array, frozen

# Table 2, read as half-open ranges of the rate in Hz: its gap between 20 and 21 Hz goes to the shorter window
# (less delay), 80 Hz, which stands in two rows, to the longer one (less noise), and 120 Hz to 10 steps as
# printed ("> 120 Hz": 20 steps). Below its 1 Hz the shortest window holds on.
_TABLE_2 = ((21.0, 3), (80.0, 5), (np.nextafter(120.0, 121.0), 10))
_LONGEST = 20


def window_for_rate(rate_hz: float) -> int:
    """Return the number of samples to average at a sampling rate (Table 2): 3, 5, 10 or 20.

    3 below 21 Hz, 5 below 80 Hz, 10 up to 120 Hz, 20 above. Raises ValueError unless the rate is above 0.
    """
    if not rate_hz > 0:
        raise ValueError(f"rate_hz = {rate_hz}: must be above 0")
    return next((steps for below, steps in _TABLE_2 if rate_hz < below), _LONGEST)


@dataclass(frozen=True, slots=True, eq=False)
class RollingState:
    """What a rolling mean remembers: the last samples, at most window - 1 of them, shape (n, channels)."""

    tail: Array = field(default_factory=lambda: frozen(np.empty(0)))


class RollingMean:
    """Causal mean of the last `window` samples; of as many as there are at the start of a stream.

    Each output is summed afresh from its own samples, newest first, so no rounding error builds up over
    months and a stream cut anywhere gives the same output to the last bit. The delay is (window - 1) / 2
    samples.
    """

    def __init__(self, window: int, state: RollingState | None = None) -> None:
        if window < 1:
            raise ValueError(f"window = {window}: must be at least 1")
        self.window = window
        self._tail = RollingState().tail if state is None else state.tail

    @property
    def state(self) -> RollingState:
        """All that is remembered; a RollingMean built from it goes on bit for bit."""
        return RollingState(self._tail)

    def feed(self, xyz: Array) -> Array:
        """Return the rolling mean at each of the samples. xyz: (n, channels); result of the same shape."""
        tail = self._tail.reshape(-1, xyz.shape[1])
        whole = np.concatenate((tail, xyz))
        total = np.zeros(xyz.shape)
        for back in range(min(self.window, whole.shape[0])):
            missing = max(back - tail.shape[0], 0)
            total[missing:] += whole[tail.shape[0] + missing - back : whole.shape[0] - back]
        at = np.arange(tail.shape[0] + 1, whole.shape[0] + 1)
        self._tail = frozen(whole[max(whole.shape[0] - self.window + 1, 0) :].copy())
        return np.asarray(total / np.minimum(at, self.window)[:, None])


def rolling_median(xyz: Array, window: int) -> Array:
    """Return the median of the last `window` samples. xyz: (n, channels); result (n - window + 1, channels).

    Whole windows only; for comparison (Table 1). Raises ValueError unless 1 <= window <= n.
    """
    if not 1 <= window <= xyz.shape[0]:
        raise ValueError(f"window = {window}: must lie between 1 and the {xyz.shape[0]} samples given")
    return np.asarray(np.median(sliding_window_view(xyz, window, axis=0), axis=-1))
