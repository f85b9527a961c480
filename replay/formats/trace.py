"""Recordings: opening one in any known format, reading it through in bounded memory, or whole.

The formats themselves, the parsing and the units live in stillcal.replay.formats; here they are put
together: two files into one run of time, events beside samples, first checks of the units.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from stillcal.calib_core.streams.resample import median_rate_hz
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.checks.units import UnitCheck
from stillcal.replay.formats.claims import Claims, Event, claimed_gravity, read_claims, read_events
from stillcal.replay.formats.columns import ColumnMap, load_map
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.merge import cut, merged
from stillcal.replay.formats.rest_table import read_rest_table
from stillcal.replay.formats.shipped import located
from stillcal.replay.formats.stream import SampleFile
from stillcal.replay.formats.writer import TraceWriter
from stillcal.replay.notebook import html_table

__all__ = [
    "Chunk",
    "Claims",
    "Event",
    "Recording",
    "Trace",
    "TraceError",
    "TraceWriter",
    "open_trace",
    "read_all",
    "read_rest_table",
]


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
    """

    accelerometer: Samples
    gyroscope: Samples | None
    events: list[Event]
    claims: Claims
    notes: list[str]
    name: str = ""

    @property
    def duration(self) -> float:
        """Span of the accelerometer's time stamps, s."""
        t = self.accelerometer.t
        return float(t[-1] - t[0]) if t.size else 0.0

    @property
    def rate_hz(self) -> float:
        """Samples of the accelerometer a second, by the median interval; 0 with less than two samples."""
        return median_rate_hz(self.accelerometer)

    def chunks(self, max_rows: int = 8192) -> Iterator[Chunk]:
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
        """Write the recording: PATH (.csv or .csv.gz), with .events.jsonl and the claims' .json beside it.

        All files are written whole or not at all. Raises ValueError where the name has another ending, and
        TraceError where the folder cannot be written to.
        """
        if not str(path).endswith((".csv", ".csv.gz")):
            raise ValueError(f"{path} is not a name for a recording: let it end in .csv or .csv.gz")
        with TraceWriter(
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

    path: the (accelerometer's) file. claims: what the maker claims. events: all of them, in time order.
    """

    def __init__(self, path: Path, column_map: ColumnMap, files: list[SampleFile], notes: list[str]) -> None:
        self.path = path
        self.column_map = column_map
        self.claims = read_claims(path)
        self.events = read_events(path)
        self._files = files
        self._notes = notes

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
    def size_bytes(self) -> int:
        """Size of the recording's files as stored."""
        return sum(file.path.stat().st_size for file in self._files)

    @property
    def bytes_read(self) -> int:
        """How much of size_bytes the latest reading has read."""
        return sum(file.bytes_read for file in self._files)

    @property
    def notes(self) -> list[str]:
        """What was tolerated or chosen while reading, one line each; complete after reading to the end."""
        return [*self._notes, *(note for file in self._files for note in file.notes)]

    def claimed_gravity(self) -> float | None:
        """Return the local gravity that the maker claims; see claims.claimed_gravity."""
        return claimed_gravity(self.claims, self.events, self.path)

    def __iter__(self) -> Iterator[Chunk]:
        return self.chunks()

    def chunks(self, max_rows: int = 8192) -> Iterator[Chunk]:
        """Yield the recording from its start in time order, at most `max_rows` samples a sensor at a time.

        The two sensors never part: all samples up to a time are out before any later one. Raises
        TraceError at the first row that cannot be used.
        """
        events = list(self.events)
        total = 0
        last: Chunk | None = None
        units = UnitCheck(self.path)
        for accelerometer, gyroscope in merged(self._files, max_rows):
            units.see(accelerometer, gyroscope)
            if last is not None:
                yield last
            total += len(accelerometer)
            end = max(float(s.t[-1]) for s in (accelerometer, gyroscope) if len(s))
            due = sum(event.t <= end for event in events)
            last = Chunk(accelerometer, gyroscope, tuple(events[:due]))
            events = events[due:]
        if last is None or total < 2:
            what = f"the recording holds {'one' if total else 'no'} accelerometer sample"
            raise TraceError(self.path, what, "give a recording of some minutes")
        units.finish()
        yield Chunk(last.accelerometer, last.gyroscope, last.events + tuple(events))


def open_trace(path: Path | str, format: str | Path = "csv", gyro: Path | str | None = None) -> Trace:
    """Open a recording. path: a file, or "sample:NAME" for one that comes with the package.

    format: a known name or a column map's path; gyro: the gyroscope's own file.

    Raises TraceError where a file, a column or the format is missing.
    """
    if str(format) == "rest":
        raise TraceError(path, "a rest table holds no samples", "give a recording of samples")
    path, column_map = located(path), load_map(format)
    claims = read_claims(path)
    own = Path(gyro) if gyro is not None else None
    files, notes = _files(path, column_map, own, claims)
    return Trace(path, column_map, files, notes)


def read_all(path: Path | str, format: str | Path = "csv", gyro: Path | str | None = None) -> Recording:
    """Read a whole recording into memory; arguments and errors as open_trace and Trace.chunks.

    It is called as its file, or as the sample that was asked for.
    """
    trace = open_trace(path, format, gyro)
    chunks = list(trace.chunks())
    gyroscope = Samples.joined(c.gyroscope for c in chunks) if trace.has_gyroscope else None
    accelerometer = Samples.joined(c.accelerometer for c in chunks)
    return Recording(accelerometer, gyroscope, trace.events, trace.claims, trace.notes, Path(path).name)


def _files(
    path: Path, column_map: ColumnMap, gyro: Path | None, claims: Claims
) -> tuple[list[SampleFile], list[str]]:
    """Return the recording's one or two files, and what was chosen."""
    both = [Sensor.ACCELEROMETER] + ([Sensor.GYROSCOPE] if column_map.gyroscope else [])
    rules = column_map.gyroscope.other_file if column_map.gyroscope else ()
    if gyro is not None and column_map.gyroscope is None:
        raise TraceError(gyro, "the format has no gyroscope", "say its columns in a column map")
    if gyro is None and not rules:
        return [SampleFile(path, column_map, both, claims)], []
    first = SampleFile(path, column_map, [Sensor.ACCELEROMETER], claims)
    gyro = gyro or other_file(path, rules)
    if gyro is None:
        return [first], [f"{path.name}: no gyroscope file beside it (name it with --gyro)"]
    return [first, SampleFile(gyro, column_map, [Sensor.GYROSCOPE], claims, first.selected)], []


def other_file(path: Path, rules: tuple[tuple[str, str], ...]) -> Path | None:
    """Return the file beside `path` whose name the first fitting rule gives, None where there is none."""
    for part, replacement in rules:
        candidate = path.with_name(path.name.replace(part, replacement))
        if part in path.name and candidate.is_file():
            return candidate
    return None
