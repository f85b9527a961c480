"""A long recording in bounded memory: every second's statistics, and as many samples as a diagnosis needs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.segments.kept_samples import chosen, of_samples
from stillcal.calib_core.diagnosis.segments.overview import Overview, OverviewBuilder
from stillcal.calib_core.errors import UserError
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.system.memory import release_free_pages
from stillcal.replay.formats.claims import Event
from stillcal.replay.formats.trace import Recording, Trace, whole

Flags = NDArray[np.bool_]

WHOLE = 1_000_000
"""Samples of a sensor up to which a recording is held whole: 5.6 h at 50 Hz. One takes 32 bytes and more; the
diagnosis needs several times as much while it works."""

KEPT = 600_000
"""Samples of a sensor that are kept of a longer one: 3.3 h at 50 Hz."""

DAY_S = 86400.0
LONGEST_DAYS = 60.0
"""Span of the longest recording that is diagnosed: every second takes memory, with samples or without."""

BLOCK = 1 << 16
"""Samples of a sensor that are read at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class LongRecording(Recording):
    """A recording of which only some samples are held. overview: all of it, second by second.

    kept: (n,) which of the overview's windows have their samples.
    """

    overview: Overview | None = None
    kept: Flags | None = None


def overview_of(recording: Recording) -> Overview | None:
    """Return every second of a recording of which only some samples are held; None where all are."""
    return recording.overview if isinstance(recording, LongRecording) else None


class Condenser:
    """Takes a recording block by block and keeps what a diagnosis needs of it.

    keep: which windows to keep, where that is known beforehand; None: they are chosen. name: what errors call
    the recording.
    """

    def __init__(
        self, whole: int = WHOLE, kept: int = KEPT, keep: Flags | None = None, name: str = "the recording"
    ) -> None:
        self._whole, self._kept, self._name = whole, kept, name
        self._span = (np.inf, -np.inf)
        self._builder = OverviewBuilder()
        self._held: dict[Sensor, list[Samples]] = {Sensor.ACCELEROMETER: [], Sensor.GYROSCOPE: []}
        self._given = keep
        self._have: Flags | None = keep
        self._seen = 0

    def add(self, accelerometer: Samples, gyroscope: Samples) -> None:
        """Take the next block. Raises UserError where the recording is too long."""
        self._span = _longer(self._span, (accelerometer, gyroscope), self._name)
        self._builder.add(accelerometer, gyroscope)
        for block in (accelerometer, gyroscope):
            if len(block):
                self._held[block.sensor].append(block)
        if self._held_now() > self._whole:
            self._thin(self._builder.overview())
            # Where more must be kept than was asked for, it is not tried again at every block.
            self._whole = max(self._whole, 2 * self._held_now())

    def _held_now(self) -> int:
        """Return how many samples of a sensor are held."""
        return max(sum(map(len, blocks)) for blocks in self._held.values())

    def recording(self, about: Recording) -> Recording:
        """Return what was taken. about: a recording with everything but the samples."""
        overview = None
        if self._have is not None:
            overview = self._builder.overview()
            self._thin(overview)
        accel, gyro = (whole(self._held[s] or [Samples.empty(s)]) for s in Sensor)
        held = gyro if about.gyroscope is not None else None
        if overview is None:
            return replace(about, accelerometer=accel, gyroscope=held)
        samples = {"accelerometer": accel, "gyroscope": held, "overview": overview, "kept": self._have}
        return LongRecording(**{f.name: getattr(about, f.name) for f in fields(Recording)} | samples)

    def _thin(self, overview: Overview) -> None:
        """Leave out the samples of windows that are not to be kept."""
        n = len(overview)
        if self._given is None:
            have = np.ones(n, dtype=np.bool_)
            if self._have is not None:
                have[: self._seen] = self._have[: self._seen]
            usual = float(np.median(overview.force.count[overview.force.count > 0.0]))
            self._have = chosen(overview, have, self._kept / usual) & have
        keep = self._have
        assert keep is not None, "chosen or given"
        for blocks in self._held.values():
            blocks[:] = [part for b in blocks if len(part := _part(b, of_samples(b.t, overview.span, keep)))]
        self._seen = n


def _longer(span: tuple[float, float], more: Iterable[Samples | None], name: str) -> tuple[float, float]:
    """Return a span, s, that holds some samples too. Raises UserError where it is too long."""
    held = [s.t for s in more if s]
    start, end = min([span[0], *(t[0] for t in held)]), max([span[1], *(t[-1] for t in held)])
    if end - start > LONGEST_DAYS * DAY_S:
        days = (end - start) / DAY_S
        raise UserError(
            f"{name}: its time stamps span {days:.4g} days, and at most {LONGEST_DAYS:.0f} are"
            " diagnosed at once; choose a part with --from and --to"
        )
    return float(start), float(end)


def _part(samples: Samples, rows: Flags) -> Samples:
    """Return the chosen rows (n,) of a run."""
    if rows.all():
        return samples

    def column(values: Array | None) -> Array | None:
        return None if values is None else frozen(values[rows])

    return Samples(
        samples.sensor,
        frozen(samples.t[rows]),
        frozen(samples.xyz[rows]),
        column(samples.temperature),
        column(samples.t_arrival),
    )


def read_condensed(trace: Trace, path: Path, progress: Callable[[float], None] | None = None) -> Recording:
    """Read a recording for its diagnosis; a long one is never held whole.

    Raises the errors of Trace.chunks, UserError where it is longer than LONGEST_DAYS.
    path: as it was asked for; the recording is called so. progress: is called with the share that is read.
    """
    condenser, begun = Condenser(name=trace.name_of(path)), trace.beginning
    events: list[Event] = []
    for chunk in trace.chunks(BLOCK):
        condenser.add(chunk.accelerometer, chunk.gyroscope)
        events += chunk.events
        if progress is not None:
            progress(trace.bytes_read / max(trace.size_bytes, 1))
    none = Samples.empty(Sensor.ACCELEROMETER)
    gyroscope = Samples.empty(Sensor.GYROSCOPE) if trace.has_gyroscope else None
    about = Recording(none, gyroscope, events, trace.claims, trace.notes, trace.name_of(path), begun=begun)
    recording = condenser.recording(about)
    recording = replace(recording, delivered_twice=trace.delivered_twice(recording.accelerometer))
    if (arrow := sys.modules.get("pyarrow")) is not None:  # keeps what its reader has freed for the next one
        arrow.default_memory_pool().release_unused()
    release_free_pages()
    return recording


def condensed(recording: Recording) -> Recording:
    """Return a recording in memory as its diagnosis needs it: itself, unless it is long.

    Raises UserError where it is longer than LONGEST_DAYS.
    """
    _longer((np.inf, -np.inf), (recording.accelerometer, recording.gyroscope), recording.name)
    sizes = [len(s) for s in (recording.accelerometer, recording.gyroscope) if s is not None]
    if isinstance(recording, LongRecording) or max(sizes) <= WHOLE:
        return recording
    condenser = Condenser(name=recording.name)
    for chunk in recording.chunks(BLOCK):
        condenser.add(chunk.accelerometer, chunk.gyroscope)
    return condenser.recording(replace(recording, begun=recording.beginning))
