"""A recording written while it lasts: blocks of either sensor come in, files of bounded length go out.

Both sensors' samples of one time share a row, so a block waits until the other sensor has come as far.
"""

from __future__ import annotations

import math
from collections import deque
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.streams.events import Charging, Location
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.claims import Claims, Event, beside
from stillcal.replay.formats.writer import TraceWriter

PATIENCE_S = 60.0
"""How long one sensor's samples wait for the other's, s; later ones are left out, or time would run back."""

GATHER_S = 1.0
"""Samples are written when so much has gathered, s."""

BEGIN_S = 5.0
"""The first samples of a file gather so long, s: without gyroscope until then, it has no columns of one."""


@dataclass(slots=True)
class Part:
    """One file of a recording. samples: of both sensors."""

    path: Path
    t_start: float
    t_end: float = -math.inf
    samples: int = 0

    def words(self) -> str:
        """Return what the file holds, for a person."""
        minutes = max(self.t_end - self.t_start, 0.0) / 60.0
        return f"{self.path}: {minutes:.1f} minutes, {self.samples:,} samples"


class Parts:
    """The names of a recording's files, NAME.csv, NAME.2.csv, ...; the oldest are deleted above `keep`."""

    def __init__(self, first: Path, keep: int) -> None:
        self._first, self._keep, self._number = first, keep, 0
        self.written: deque[Part] = deque()

    def next_path(self) -> Path:
        """Return the next name at which no file stands."""
        while True:
            self._number += 1
            path = self._path(self._number)
            if not path.exists():
                return path

    def add(self, part: Part) -> None:
        """Enter a part that is complete, and delete what is too much."""
        self.written.append(part)
        while len(self.written) > self._keep:
            old = self.written.popleft().path
            for path in (old, beside(old, ".events.jsonl"), beside(old, ".json")):
                path.unlink(missing_ok=True)

    def _path(self, number: int) -> Path:
        if number == 1:
            return self._first
        name, dot, ending = self._first.name.partition(".csv")
        return self._first.with_name(f"{name}.{number}{dot}{ending}")


class LiveRecording:
    """Takes the blocks of a daemon's stream and writes them. rotate_s: length of a file, s."""

    def __init__(self, parts: Parts, rotate_s: float) -> None:
        self._parts, self._rotate_s = parts, rotate_s
        self._claims: Claims | None = None
        self._waiting: dict[Sensor, Samples] = {}
        self._events: list[Event] = []
        self._context = ExitStack()
        self._writer: TraceWriter | None = None
        self._part: Part | None = None
        self._latest_events: dict[type, Event] = {}
        self._until = -math.inf

    @property
    def filled(self) -> bool:
        """Whether the disk is full: what was taken can still be completed, but no more."""
        return self._writer is not None and self._writer.filled

    def take(self, block: dict[str, Any]) -> None:
        """Take a block as the socket's Record sends it. Raises TraceError where it cannot be written."""
        if block.get("claims"):
            self._claims = msgspec.convert(msgspec.json.decode(block["claims"]), Claims)
        if block.get("t_s") is not None:
            self._take_event(block)
        if block.get("samples"):
            samples = _samples(block).between(self._until, math.inf)
            held = self._waiting.get(samples.sensor)
            self._waiting[samples.sensor] = samples if held is None else Samples.joined([held, samples])
            self._write_until(self._horizon(), at_least_s=GATHER_S if self._writer else BEGIN_S)

    def close(self) -> list[Part]:
        """Write what waits, complete the last file, and return the files that are kept, oldest first."""
        self._write_until(math.inf, at_least_s=0.0)
        self._complete()
        return list(self._parts.written)

    def discard(self) -> None:
        """Leave the file that is not complete; earlier ones stay."""
        failed = RuntimeError("the recording was given up")
        self._context.__exit__(RuntimeError, failed, None)
        self._writer = self._part = None

    def _take_event(self, block: dict[str, Any]) -> None:
        if block.get("charging") is not None:
            event: Event = Charging(block["t_s"], block["charging"])
        else:
            latitude, longitude, *altitude = block["location"]
            event = Location(block["t_s"], latitude, longitude, altitude[0] if altitude else None)
        self._events.append(event)
        self._latest_events[type(event)] = event

    def _horizon(self) -> float:
        """Return the time (s) before which no sample of either sensor is to come."""
        ends = [float(samples.t[-1]) for samples in self._waiting.values() if len(samples)]
        both = len(ends) == len(Sensor)
        return max(min(ends) if both else -math.inf, max(ends) - PATIENCE_S)

    def _write_until(self, horizon: float, at_least_s: float) -> None:
        """Write the samples before `horizon`, s, where they span at least so long."""
        begins = [float(samples.t[0]) for samples in self._waiting.values() if len(samples)]
        if not begins or horizon - min(begins) < at_least_s:
            return
        self._until = horizon
        ready = {sensor: samples.between(-math.inf, horizon) for sensor, samples in self._waiting.items()}
        self._waiting = {sensor: samples[len(ready[sensor]) :] for sensor, samples in self._waiting.items()}
        start = min(begins)
        if self._part is not None and start - self._part.t_start >= self._rotate_s:
            self._complete()
        if self._part is None:
            self._open(start, gyroscope=bool(len(ready.get(Sensor.GYROSCOPE, ()))))
        self._append(ready)

    def _append(self, ready: dict[Sensor, Samples]) -> None:
        assert self._writer is not None and self._part is not None
        accelerometer = ready.get(Sensor.ACCELEROMETER, Samples.empty(Sensor.ACCELEROMETER))
        self._writer.write(accelerometer, ready.get(Sensor.GYROSCOPE), self._events)
        self._events = []
        for samples in ready.values():
            if len(samples):
                self._part.samples += len(samples)
                self._part.t_end = max(self._part.t_end, float(samples.t[-1]))

    def _open(self, t: float, *, gyroscope: bool) -> None:
        """Begin a file at t (s); what events said last holds there too."""
        path = self._parts.next_path()
        self._part = Part(path, t)
        writer = TraceWriter(path, gyroscope=gyroscope, temperature=True, claims=self._claims, sparing=True)
        self._writer = self._context.enter_context(writer)
        repeated = [msgspec.structs.replace(e, t=t) for e in self._latest_events.values() if e.t < t]
        self._events = [*repeated, *(e for e in self._events if e.t >= t)]

    def _complete(self) -> None:
        if self._part is not None:
            self._context.close()
            self._parts.add(self._part)
        self._writer = self._part = None
        self._context = ExitStack()


def _samples(block: dict[str, Any]) -> Samples:
    rows = np.asarray(block["samples"], dtype=np.float64).reshape(-1, 4)
    celsius = block.get("temperature_c")
    temperature = frozen(np.full(len(rows), np.nan) if celsius is None else np.asarray(celsius, np.float64))
    return Samples(Sensor(block["sensor"]), frozen(rows[:, 0]), frozen(rows[:, 1:]), temperature)
