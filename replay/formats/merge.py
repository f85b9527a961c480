"""Two streams of samples side by side in time, so that neither runs far ahead of the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations

import msgspec
import numpy as np

from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.claims import Event
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.stream import Run, SampleFile

Pair = tuple[Samples, Samples]

ALONE_S = 10.0
"""s: how long one sensor is on without the other before it is said. Phones start both within a second."""


def merged(files: Sequence[SampleFile], max_rows: int) -> Iterator[Pair]:
    """Yield (accelerometer, gyroscope) runs of at most `max_rows` samples each, in time order.

    A run holds all samples of both sensors up to its end. One file: its own blocks; two: each is read
    on only while the other is ahead. Neither run is longer than `max_rows`, unless stamps repeat.
    """
    runs = files[0].runs() if len(files) == 1 else _two(files[0], files[1])
    for run in runs:
        yield from cut(run, max_rows)


def _of(run: Run, sensor: Sensor) -> Samples:
    return run.get(sensor) or Samples.empty(sensor)


def cut(run: Run, max_rows: int) -> Iterator[Pair]:
    """Yield a run as (accelerometer, gyroscope) runs of at most `max_rows` samples each, in time order."""
    accelerometer, gyroscope = _of(run, Sensor.ACCELEROMETER), _of(run, Sensor.GYROSCOPE)
    while len(accelerometer) or len(gyroscope):
        ends = [float(s.t[max_rows - 1]) for s in (accelerometer, gyroscope) if len(s) > max_rows]
        a, g = (_upto(s, min(ends, default=np.inf)) for s in (accelerometer, gyroscope))
        yield accelerometer[:a], gyroscope[:g]
        accelerometer, gyroscope = accelerometer[a:], gyroscope[g:]


def _upto(samples: Samples, end: float) -> int:
    return int(np.searchsorted(samples.t, end, side="right"))


@dataclass(frozen=True, slots=True)
class Cut:
    """A part of a recording. start, stop: s after its first sample, None for its start and its end."""

    start: float | None = None
    stop: float | None = None

    @property
    def said(self) -> str:
        """How to begin a sentence about what the part holds; empty where it is the whole."""
        if self.start is None and self.stop is None:
            return ""
        end = "the end" if self.stop is None else f"{self.stop:g} s"
        return f"from {self.start or 0:g} s to {end} there is"

    def started(self, events: list[Event], accelerometer: Samples, gyroscope: Samples) -> list[Event]:
        """Return the events with those before the part moved to its start: what they say still holds.

        accelerometer, gyroscope: the first samples of the part.
        """
        if self.start is None:
            return events
        first = min(float(s.t[0]) for s in (accelerometer, gyroscope) if len(s))
        return [msgspec.structs.replace(event, t=max(event.t, first)) for event in events]

    def applied(self, pairs: Iterator[Pair]) -> Iterator[Pair]:
        """Yield what of the runs lies in the part; nothing beyond its end is read."""
        if not self.said:
            yield from pairs
            return
        first = None
        for pair in pairs:
            if first is None:
                first = min(float(s.t[0]) for s in pair if len(s))
            low, high = first + (self.start or 0.0), first + (np.inf if self.stop is None else self.stop)
            accelerometer, gyroscope = (
                s[int(np.searchsorted(s.t, low, side="left")) : _upto(s, high)] for s in pair
            )
            if len(accelerometer) or len(gyroscope):
                yield accelerometer, gyroscope
            if any(len(s) and s.t[-1] > high for s in pair):
                return


class Spans:
    """When the two sensors were on, as runs are seen in time order."""

    def __init__(self) -> None:
        self._ends: dict[Sensor, tuple[float, float]] = {}
        self._gaps: dict[Sensor, list[tuple[float, float]]] = {}

    def see(self, *run: Samples) -> None:
        """Take in a run of both sensors."""
        for samples in run:
            if len(samples):
                first, last = self._ends.get(samples.sensor, (float(samples.t[0]), float(samples.t[0])))
                self._ends[samples.sensor] = first, float(samples.t[-1])
                t = np.concatenate([[last], samples.t])
                gaps = np.flatnonzero(np.diff(t) > ALONE_S)
                self._gaps.setdefault(samples.sensor, []).extend(zip(t[gaps], t[gaps + 1], strict=True))

    def said(self) -> Iterator[str]:
        """Say of each sensor for how long the other one was on without it, where that is long."""
        if len(self._ends) < 2:
            return
        begin = min(first for first, _ in self._ends.values())
        end = max(last for _, last in self._ends.values())
        for sensor, (first, last) in self._ends.items():
            if first - begin + end - last > ALONE_S:
                span = f"{first - begin:.1f} to {last - begin:.1f} s"
                yield f"the {sensor} has samples from {span} only, of {end - begin:.1f} s"
        for sensor, other in permutations(self._ends):
            holes = [(a - begin, b - begin) for a, b in self._alone(sensor, other)]
            if holes:
                a, b = max(holes, key=lambda hole: hole[1] - hole[0])
                total = sum(b - a for a, b in holes)
                more = f" (the longest of {len(holes)} holes, {total:.1f} s together)" if holes[1:] else ""
                yield f"the {sensor} has no samples from {a:.1f} to {b:.1f} s, where the {other} has{more}"

    def _alone(self, sensor: Sensor, other: Sensor) -> Iterator[tuple[float, float]]:
        """Yield when a sensor has no samples between two of its own where the other has, for long."""
        first, last = self._ends[other]
        missing = np.array(self._gaps[other]).reshape(-1, 2)
        for a, b in self._gaps[sensor]:
            since, until = max(a, first), min(b, last)
            both = missing[(missing[:, 1] > since) & (missing[:, 0] < until)]
            for start, stop in (*both.tolist(), (until, until)):
                if start - since > ALONE_S:
                    yield since, start
                since = max(since, stop)


class _Side:
    """One stream, with the samples that are read and not yet passed on."""

    def __init__(self, file: SampleFile, sensor: Sensor) -> None:
        self.sensor = sensor
        self.ended = False
        self.path = file.path
        self.first = np.inf
        self.last = -np.inf
        self._runs = file.runs()
        self.samples = Samples.empty(sensor)

    @property
    def end(self) -> float:
        """Time up to which this side is read, s; infinite once its file has ended."""
        if self.ended:
            return np.inf
        return float(self.samples.t[-1]) if len(self.samples) else -np.inf

    @property
    def span(self) -> str:
        """From when to when its samples are, as far as it is read, in words."""
        return f"{self.first:.6g} s to {self.last:.6g} s" if self.ended else f"from {self.first:.6g} s on"

    def read_on(self) -> None:
        """Read one more block."""
        run = next(self._runs, None)
        if run is None:
            self.ended = True
        else:
            self.samples = _joined(self.samples, _of(run, self.sensor))
        if len(self.samples):
            self.first = min(self.first, float(self.samples.t[0]))
            self.last = float(self.samples.t[-1])

    def take_until(self, end: float) -> Samples:
        """Pass on what is no later than `end`."""
        n = _upto(self.samples, end)
        passed, self.samples = self.samples[:n], self.samples[n:]
        return passed


def _joined(first: Samples, second: Samples) -> Samples:
    return Samples.joined([s for s in (first, second) if len(s)] or [second])


def _two(accelerometer: SampleFile, gyroscope: SampleFile) -> Iterator[Run]:
    sides = (_Side(accelerometer, Sensor.ACCELEROMETER), _Side(gyroscope, Sensor.GYROSCOPE))
    while not all(side.ended for side in sides):
        behind = min(sides, key=lambda side: side.end)
        behind.read_on()
        if any(side.ended for side in sides):
            _refuse_apart(*sides)
        end = min(side.end for side in sides)
        yield {side.sensor: side.take_until(end) for side in sides}


def _refuse_apart(accelerometer: _Side, gyroscope: _Side) -> None:
    """Raise TraceError where one file ended before the other begins: two recordings, or two clocks.

    Nothing of the later one has been passed on then.
    """
    if gyroscope.last < accelerometer.first < np.inf or accelerometer.last < gyroscope.first < np.inf:
        spans, own = gyroscope.span, accelerometer.span
        apart = "" if gyroscope.path == accelerometer.path else f" in {short_name(accelerometer.path)}"
        whose = f"those of the accelerometer{apart}"
        what = f"the gyroscope's times, {spans}, do not overlap {whose}, {own}"
        raise TraceError(gyroscope.path, what, "give both sensors of one recording on one clock")
