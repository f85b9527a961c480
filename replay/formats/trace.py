"""Recordings: opening one in any known format, reading it through in bounded memory, or whole.

The formats themselves, the parsing and the units live in stillcal.replay.formats; here they are put
together: two files into one run of time, events beside samples, first checks of the units.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stillcal.calib_core.streams.beginning import ROWS, Beginning
from stillcal.calib_core.streams.resample import median_rate_hz
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.calib_core.streams.time_series import TimeSeries
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.checks.units import UnitCheck
from stillcal.replay.formats.claims import Claims, Event, claimed_gravity, read_claims, read_events
from stillcal.replay.formats.conversion.by_name import writer_class
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.merge import Cut, Spans, cut, merged
from stillcal.replay.formats.recognition.log import Log
from stillcal.replay.formats.recognition.opened import Format, open_log
from stillcal.replay.formats.sources import Source
from stillcal.replay.formats.stream import SampleFile
from stillcal.replay.notebook import html_table


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """A stretch of a recording: samples of both sensors (empty runs where there are none) and events."""

    accelerometer: Samples
    gyroscope: Samples
    events: tuple[Event, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A whole recording in memory, SI units, body axes as on Android (x right, y up, z out of the screen).

    accelerometer: `Samples` with t (n,) s and xyz (n, 3) m/s^2, specific force, so that a phone at rest reads
    +g on the axis that points up. gyroscope: the same in rad/s with time stamps of its own, None where the
    recording has none. events: charging and location, in time order. claims: what the maker claims of the
    phone. notes: what was tolerated or chosen while reading, a line each. name: what it is called in results.
    covariates: further logged columns by name (`covariates.read_covariates`), which a bias may follow.
    delivered_twice: how many samples of the accelerometer came twice, of which each is here once. begun: the
    beginning of the recording that this is a part of; None where it is the whole.
    """

    accelerometer: Samples
    gyroscope: Samples | None
    events: list[Event]
    claims: Claims
    notes: list[str]
    name: str = ""
    covariates: Mapping[str, TimeSeries] = field(default_factory=dict)
    delivered_twice: int = 0
    begun: Beginning | None = None

    @property
    def beginning(self) -> Beginning:
        """The beginning of the recording, also where this is a part of it."""
        if self.begun is not None:
            return self.begun
        first = next(self.chunks(ROWS), None)
        return Beginning.of(() if first is None else (first.accelerometer, first.gyroscope))

    @property
    def duration(self) -> float:
        """Span of the accelerometer's time stamps, s."""
        t = self.accelerometer.t
        return float(t[-1] - t[0]) if t.size else 0.0

    @property
    def rate_hz(self) -> float:
        """Samples of the accelerometer a second, by the median interval; 0 with less than two samples."""
        return median_rate_hz(self.accelerometer)

    def chunks(self, max_rows: int = 16384) -> Iterator[Chunk]:
        """Yield the recording in time order, at most `max_rows` samples a sensor at a time, as Trace does."""
        events = list(self.events)
        gyroscope = self.gyroscope or Samples.empty(Sensor.GYROSCOPE)
        for accel, gyro in cut({s.sensor: s for s in (self.accelerometer, gyroscope)}, max_rows):
            end = max(float(s.t[-1]) for s in (accel, gyro) if len(s))
            due = sum(event.t <= end for event in events)
            yield Chunk(accel, gyro, tuple(events[:due]))
            events = events[due:]
        if events:
            empty = (Samples.empty(Sensor.ACCELEROMETER), Samples.empty(Sensor.GYROSCOPE))
            yield Chunk(*empty, tuple(events))

    def claimed_gravity(self) -> float | None:
        """Return the local gravity that the maker claims; see claims.claimed_gravity."""
        return claimed_gravity(self.claims, self.events, Path(self.name))

    def save(self, path: Path | str) -> None:
        """Write the recording to PATH (.csv, .csv.gz or .parquet), its events and claims beside it.

        All files are written whole or not at all. Raises ValueError where the name has another ending, and
        TraceError where the folder cannot be written to.
        """
        with writer_class(path)(
            path,
            gyroscope=self.gyroscope is not None,
            temperature=self.accelerometer.temperature is not None,
            arrival=self.accelerometer.t_arrival is not None,
            claims=self.claims,
        ) as writer:
            for chunk in self.chunks():
                writer.write(chunk.accelerometer, chunk.gyroscope, chunk.events)

    def __repr__(self) -> str:
        return f"Recording({', '.join(f'{name}: {value}' for name, value in self._rows())})"

    def _repr_html_(self) -> str:
        return html_table(self._rows())

    def _rows(self) -> list[tuple[str, str]]:
        sensors = [f"{len(self.accelerometer):,} samples of the accelerometer"]
        if self.gyroscope is not None:
            sensors.append(f"{len(self.gyroscope):,} of the gyroscope")
        return [
            ("recording", self.name or "unnamed"),
            ("length", f"{self.duration:.1f} s at {self.rate_hz:.4g} Hz"),
            ("samples", ", ".join(sensors)),
        ]


class Trace:
    """A recording opened for reading, any number of times over; holds no more than some blocks of it.

    path: the (accelerometer's) file. kind: its format. sensor: which of the log's is read. claims: what the
    maker claims. events: all of them, in time order.
    """

    def __init__(self, log: Log, sensor: str | None = None, cut: Cut | None = None) -> None:
        chosen, said = log.choose(sensor)
        self.path = log.path
        self.kind = log.kind
        self.sensor = chosen.name
        beside = None if log.beside is None else read_claims(log.beside)
        self.claims = log.claims if beside is None or beside == Claims() else beside
        self.events = [] if log.beside is None else read_events(log.beside)
        self._files = chosen.files(self.claims)
        self._notes = [*log.notes, *said, *chosen.notes]
        self._cut = cut or Cut()
        self._alone: list[str] = []

    @property
    def has_gyroscope(self) -> bool:
        """Whether the recording has gyroscope samples."""
        return any(Sensor.GYROSCOPE in file.sensors for file in self._files)

    @property
    def has_temperature(self) -> bool:
        """Whether the recording has a column of temperatures (some of its samples may still have none)."""
        return any(file.has_temperature for file in self._files)

    @property
    def has_arrival(self) -> bool:
        """Whether the recording has a column of arrival times."""
        return any(file.has_arrival for file in self._files)

    @property
    def files(self) -> list[SampleFile]:
        """The tables that the samples are read from, the accelerometer's first."""
        return list(self._files)

    @property
    def beginning(self) -> Beginning:
        """The beginning of the recording, whatever part of it is read. Raises TraceError on an empty one."""
        for pair in merged(self._files, ROWS):
            return Beginning.of(pair)
        raise TraceError(
            self.path, "the recording holds no accelerometer sample", "give a recording of some minutes"
        )

    @property
    def size_bytes(self) -> int:
        """Size of the recording's files as stored."""
        return sum(file.size_bytes for file in self._files)

    @property
    def bytes_read(self) -> int:
        """How much of size_bytes the latest reading has read."""
        return sum(file.bytes_read for file in self._files)

    @property
    def notes(self) -> list[str]:
        """What was tolerated or chosen while reading, one line each; complete after reading to the end."""
        return [*self._notes, *(note for file in self._files for note in file.notes), *self._alone]

    def claimed_gravity(self) -> float | None:
        """Return the local gravity that the maker claims; see claims.claimed_gravity."""
        return claimed_gravity(self.claims, self.events, self.path)

    def __iter__(self) -> Iterator[Chunk]:
        return self.chunks()

    def chunks(self, max_rows: int = 16384) -> Iterator[Chunk]:
        """Yield the recording from its start in time order, at most `max_rows` samples a sensor at a time.

        The two sensors never part: all samples up to a time are out before any later one. Raises
        TraceError at the first row that cannot be used.
        """
        events = list(self.events)
        total = 0
        last: Chunk | None = None
        units, spans = UnitCheck(self.path), Spans()
        for accelerometer, gyroscope in self._cut.applied(merged(self._files, max_rows)):
            units.see(accelerometer, gyroscope)
            spans.see(accelerometer, gyroscope)
            if last is not None:
                yield last
            if last is None:
                events = self._cut.started(events, accelerometer, gyroscope)
            total += len(accelerometer)
            end = max(float(s.t[-1]) for s in (accelerometer, gyroscope) if len(s))
            due = sum(event.t <= end for event in events)
            last = Chunk(accelerometer, gyroscope, tuple(events[:due]))
            events = events[due:]
        if last is None or total < 2:
            where = self._cut.said or "the recording holds"
            what = f"{where} {'one' if total else 'no'} accelerometer sample"
            raise TraceError(self.path, what, "give a recording of some minutes")
        units.finish()
        self._alone = [f"{short_name(self.path)}: {line}" for line in spans.said()]
        late = () if self._cut.stop is not None else tuple(events)
        yield Chunk(last.accelerometer, last.gyroscope, last.events + late)

    def recording(self, name: str, progress: Callable[[float], None] = lambda _share: None) -> Recording:
        """Read all of it into memory. progress: is called with the share that is read. Raises TraceError."""
        begun, chunks = self.beginning, []
        for chunk in self.chunks():
            chunks.append(chunk)
            progress(self.bytes_read / max(self.size_bytes, 1))
        gyroscope = whole([c.gyroscope for c in chunks]) if self.has_gyroscope else None
        accelerometer = whole([c.accelerometer for c in chunks])
        events = [event for chunk in chunks for event in chunk.events]
        twice = self.delivered_twice(accelerometer)
        return Recording(
            accelerometer,
            gyroscope,
            events,
            self.claims,
            self.notes,
            name,
            delivered_twice=twice,
            begun=begun,
        )

    def delivered_twice(self, accelerometer: Samples) -> int:
        """Return how many rows were left out, from the first to the last sample, as they came twice."""
        files = [f for f in self._files if Sensor.ACCELEROMETER in f.sensors]
        stamps = np.concatenate([np.empty(0), *(f.delivered_twice for f in files)])
        if not len(accelerometer):
            return 0
        return int(((stamps >= accelerometer.t[0]) & (stamps <= accelerometer.t[-1])).sum())

    def name_of(self, asked: Path | str) -> str:
        """Return what the recording is called in results: as its file, or as the sample asked for."""
        return short_name(asked)


def open_trace(
    path: Path | str | Source,
    format: Format = None,
    gyro: Path | str | None = None,
    *,
    sensor: str | None = None,
    start: float | None = None,
    stop: float | None = None,
) -> Trace:
    """Open a recording.

    path: a file or folder, "sample:NAME" for one that comes with the package, "-", or a pipe's bytes.
    format: a known name, a column map or the path of one; None: recognised by content. gyro: the gyroscope's
    own file. sensor: which one of a log with several; None: the first. start, stop: only what lies between, s
    after the first sample.

    Raises TraceError where a file, a column, the format or the sensor is missing.
    """
    log = open_log(path, format, Path(gyro) if gyro is not None else None)
    return Trace(log, sensor, Cut(start, stop))


def read_all(
    path: Path | str,
    format: str | Path | None = None,
    gyro: Path | str | None = None,
    *,
    sensor: str | None = None,
    start: float | None = None,
    stop: float | None = None,
) -> Recording:
    """Read a whole recording into memory; arguments and errors as open_trace and Trace.chunks.

    It is called as its file, or as the sample that was asked for.
    """
    trace = open_trace(path, format, gyro, sensor=sensor, start=start, stop=stop)
    return trace.recording(trace.name_of(path))


def whole(runs: Sequence[Samples]) -> Samples:
    """Join runs of one sensor; an empty one, which has no temperatures, takes none of the others away."""
    return Samples.joined([run for run in runs if len(run)] or list(runs[:1]))
