"""What a phone sends, sans-I/O: a simulated or recorded stream that obeys sense, sleep, rate and grants.

Chunks and commands in, messages out. Time is the stream's own; nothing here waits, reads a clock or
knows a serial line (link.py does).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np

from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.calib_core.streams.events import Charging, End, Location, Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.wire.messages import Command, Grant, Message, Rate, Status

PhoneEvent = Charging | Location


class Chunk(Protocol):
    """A stretch of a stream: all samples up to a time come in it or before it, of both sensors.

    The simulated phone's chunks and a recording's are such.
    """

    @property
    def accelerometer(self) -> Samples:
        """The accelerometer's samples, in time order."""

    @property
    def gyroscope(self) -> Samples | None:
        """The gyroscope's samples, in time order; None for a phone without one."""

    @property
    def events(self) -> Sequence[PhoneEvent]:
        """The events, in time order."""


class PhoneStream:
    """A phone whose time goes on as `advance` is called.

    With `credit`, time stands wherever the last grant ended, and at every event, until a further grant:
    a daemon's commands then take effect at the very sample time that it meant. While the sensors sleep,
    their samples are skipped, never sent late; events are sent nevertheless.
    """

    def __init__(self, chunks: Iterable[Chunk], credit: bool = True) -> None:
        self._spans: Iterator[_Span] = (span for chunk in chunks if (span := _Span.of(chunk)) is not None)
        self._credit = credit
        self._granted = -math.inf if credit else math.inf
        self._asleep_until: float | None = None
        self._thin = _Thinning()
        self._span = next(self._spans, None)
        self.t = 0.0 if self._span is None else self._span.start
        self._last = self.t
        self._on_time, self._wakeups = 0.0, 1
        self.dismissed = False

    @property
    def done(self) -> bool:
        """Whether the whole stream has been sent."""
        return self._span is None

    @property
    def waiting(self) -> bool:
        """Whether nothing goes on without a further grant."""
        return not self.done and self.t >= self._granted

    def standing(self) -> list[Message]:
        """Return the present status and time: the phone's answer when asked, repeated while it waits."""
        status = Status(self.t, self._on_time, self._asleep_until is None, self._wakeups)
        end = [End(math.nextafter(self._last, math.inf))] if self.done else []
        return [status, Tick(self.t), *end]

    def obey(self, command: Command) -> None:
        """Take a command; it holds from the present time on. Sleep without end dismisses an ended stream."""
        self.dismissed |= self.done and command == Sleep(math.inf)
        if isinstance(command, Grant) and self._credit:
            self._granted = command.until
        elif isinstance(command, Rate):
            self._thin.hz = command.hz
        elif isinstance(command, Sleep) and command.until > self.t:
            self._asleep_until = command.until
        elif isinstance(command, Sense | Sleep):
            self._switch_on()

    def advance(self, limit: float = math.inf) -> list[Message]:
        """Let time go on, to `limit` (s) at most, and return what is sent meanwhile.

        It stops after a chunk's end, an event, a waking or a grant's end; the last three are told by a
        status and a tick. Nothing is sent and no time passes while `waiting`.
        """
        span, goal = self._span, min(limit, self._granted)
        if span is None or self.t >= goal:
            return []
        messages = self._go(span, min(goal, span.end, span.next_event, self._asleep_until or math.inf))
        woke_up = self._wake_up()
        events = span.take_events(self.t)
        if events and self._credit:
            self._granted = self.t
        messages += events
        self._turn_page(span)
        pause = woke_up or events or self.waiting or self.done
        return [*messages, *self.standing()] if pause else messages

    def _go(self, span: _Span, stop: float) -> list[Message]:
        samples = span.take_samples(stop)
        stop = max(stop, self.t)
        if self._asleep_until is None:
            self._on_time += stop - self.t
            samples = [self._thin(run) for run in samples]
        else:
            samples = []
        self.t = stop
        return [run for run in samples if len(run)]

    def _wake_up(self) -> bool:
        due = self._asleep_until is not None and self.t >= self._asleep_until
        if due:
            self._switch_on()
        return due

    def _switch_on(self) -> None:
        self._wakeups += self._asleep_until is not None
        self._asleep_until = None

    def _turn_page(self, span: _Span) -> None:
        if self.t >= span.end:
            self._last = max(self._last, span.last)
            self._span = next(self._spans, None)


class _Span:
    """A chunk on its way out. start, end: s, what it covers; last: its last sample's stamp."""

    def __init__(self, chunk: Chunk, runs: list[Samples]) -> None:
        stamps = [float(t) for run in runs for t in (run.t[0], run.t[-1])]
        times = stamps + [event.t for event in chunk.events]
        self.start, self.last = min(times), max(stamps, default=-math.inf)
        beyond = math.nextafter(max(times), math.inf)
        self.end = max(beyond, float(getattr(chunk, "t_end", beyond)))
        self._runs, self._events = runs, list(chunk.events)

    @classmethod
    def of(cls, chunk: Chunk) -> _Span | None:
        """Return the chunk's span; None where it holds nothing."""
        runs = [run for run in (chunk.gyroscope, chunk.accelerometer) if run is not None and len(run)]
        return cls(chunk, runs) if runs or chunk.events else None

    @property
    def next_event(self) -> float:
        """Time of the next event, s; inf where there is none."""
        return self._events[0].t if self._events else math.inf

    def take_samples(self, stop: float) -> list[Samples]:
        """Take the samples before `stop` (s), the gyroscope's first: the engine waits for neither then."""
        cuts = [int(np.searchsorted(run.t, stop, side="left")) for run in self._runs]
        taken = [run[:cut] for run, cut in zip(self._runs, cuts, strict=True)]
        self._runs = [run[cut:] for run, cut in zip(self._runs, cuts, strict=True)]
        return taken

    def take_events(self, t: float) -> list[Message]:
        """Take the events up to and at t (s)."""
        due = list(itertools.takewhile(lambda event: event.t <= t, self._events))
        self._events = self._events[len(due) :]
        return [*due]


class _Thinning:
    """Every k-th sample of a sensor, k as near as may be to what the wanted rate means. hz: None for all."""

    def __init__(self) -> None:
        self.hz: float | None = None
        self._period: dict[Sensor, float] = {}
        self._skip: dict[Sensor, int] = {}

    def __call__(self, run: Samples) -> Samples:
        if len(run) > 1 and run.sensor not in self._period:
            self._period[run.sensor] = float(np.median(np.diff(run.t)))
        period = self._period.get(run.sensor, 0.0)
        if self.hz is None or not self.hz > 0.0 or not period > 0.0:
            return run
        every = max(1, round(1.0 / (period * self.hz)))
        skip = self._skip.get(run.sensor, 0) % every
        self._skip[run.sensor] = (skip - len(run)) % every
        return run[skip::every]
