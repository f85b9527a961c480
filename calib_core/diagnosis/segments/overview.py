"""Statistics of every second of a recording that is read block by block: all that rests are found from.

They grow by a few hundred bytes a second, whatever the sampling rate.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.windows import WINDOW, Windows, windows
from stillcal.calib_core.streams.samples import Samples


@dataclass(frozen=True, slots=True, eq=False)
class Overview:
    """Windows of a whole recording. span: (start, end) s of the accelerometer's stamps.

    force, rate: windows of each sensor on one grid, rate None without a gyroscope. thermometer: (k, 2) s and
    degC, the first reading of each window that has one, None without a thermometer.
    """

    span: tuple[float, float]
    force: Windows
    rate: Windows | None
    thermometer: Array | None

    def __len__(self) -> int:
        return int(self.force.t.size)


class OverviewBuilder:
    """Builds an overview from blocks of both sensors, in time order."""

    def __init__(self) -> None:
        self._force, self._rate = _Stream(), _Stream()
        self._warm: list[Array] = []
        self._start: float | None = None
        self._end = 0.0

    def add(self, accelerometer: Samples, gyroscope: Samples) -> None:
        """Take the next block; either sensor's part may be empty."""
        if len(accelerometer):
            if self._start is None:
                self._start = float(accelerometer.t[0])
            self._end = float(accelerometer.t[-1])
            self._add_temperature(accelerometer)
        self._force.add(accelerometer, self._start)
        self._rate.add(gyroscope, self._start)

    def overview(self) -> Overview:
        """Return the overview of all blocks so far, which hold samples of the accelerometer."""
        assert self._start is not None, "a recording has samples of the accelerometer"
        n = max(1, int((self._end - self._start) / WINDOW))
        rate = self._rate.windows(self._start, n) if self._rate.samples else None
        warm = np.concatenate(self._warm) if self._warm else np.empty((0, 2))
        return Overview(
            (self._start, self._end), self._force.windows(self._start, n), rate, warm if len(warm) else None
        )

    def _add_temperature(self, samples: Samples) -> None:
        if samples.temperature is None:
            return
        known = np.flatnonzero(np.isfinite(samples.temperature))
        second = np.floor(samples.t[known] / WINDOW)
        first = known[np.flatnonzero(np.diff(second, prepend=-np.inf))]
        self._warm.append(np.stack([samples.t[first], samples.temperature[first]], axis=1))


class _Stream:
    """The windows of one sensor. samples: how many there were."""

    def __init__(self) -> None:
        self.samples = 0
        self._done = 0
        self._parts: list[Windows] = []
        self._open: list[Samples] = []

    def add(self, block: Samples, start: float | None) -> None:
        """Take the next block. start: s, where the first window begins; None where it is not known yet."""
        self.samples += len(block)
        if len(block):
            self._open.append(block)
        if start is None or not self._open:
            return
        complete = int((float(self._open[-1].t[-1]) - start) / WINDOW)
        if complete > self._done:
            whole = Samples.joined(self._open)
            begin, end = start + self._done * WINDOW, start + complete * WINDOW
            last = int(np.searchsorted(whole.t, end))
            self._parts.append(_exactly(whole[:last], begin, complete - self._done))
            self._open, self._done = [whole[last:]], complete

    def windows(self, start: float, count: int) -> Windows:
        """Return the first `count` windows; those without samples have count 0."""
        if len(self._parts) > 1:
            self._parts = [_joined(self._parts)]
        parts = list(self._parts)
        if self._done < count:
            rest = Samples.joined(self._open)
            parts.append(_exactly(rest, start + self._done * WINDOW, count - self._done))
        every = parts[0] if len(parts) == 1 else _joined(parts)
        return Windows(*(getattr(every, f.name)[:count] for f in fields(Windows)))


def _joined(parts: list[Windows]) -> Windows:
    """Return windows end to end."""
    return Windows(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Windows)))


def _exactly(samples: Samples, begin: float, count: int) -> Windows:
    """Return `count` windows from `begin` s on."""
    return windows(samples, begin, begin + (count + 0.5) * WINDOW)
