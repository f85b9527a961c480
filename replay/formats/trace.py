"""Recordings: opening one in any known format, reading it through in bounded memory, or whole.

The formats themselves, the parsing and the units live in stillcal.replay.formats; here they are put
together: two files into one run of time, events beside samples, first checks of the units.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from stillcal.calib_core.gravity import STANDARD, LocationError, given
from stillcal.calib_core.streams.events import Location
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.claims import Claims, Event, beside, read_claims, read_events
from stillcal.replay.formats.columns import ColumnMap, load_map
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.merge import merged
from stillcal.replay.formats.rest_table import read_rest_table
from stillcal.replay.formats.stream import SampleFile
from stillcal.replay.formats.unit_check import UnitCheck
from stillcal.replay.formats.writer import TraceWriter

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
    """A whole recording in memory. gyroscope: None where the recording has none."""

    accelerometer: Samples
    gyroscope: Samples | None
    events: list[Event]
    claims: Claims
    notes: list[str]


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
        """Return the local gravity that the maker claims, unless the recording says where it was taken.

        The standard value is what people write who do not know. Raises TraceError where it is no gravity
        of the earth's.
        """
        claimed = self.claims.gravity
        located = any(isinstance(event, Location) for event in self.events)
        if claimed is None or located or claimed == STANDARD:
            return None
        try:
            return given(claimed).value
        except LocationError as error:
            raise TraceError(beside(self.path, ".json"), str(error), "correct it or leave it out") from error

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
    """Open a recording. format: a known name or a column map's path; gyro: the gyroscope's own file.

    Raises TraceError where a file, a column or the format is missing.
    """
    if str(format) == "rest":
        raise TraceError(path, "a rest table holds no samples", "give a recording of samples")
    path, column_map = Path(path), load_map(format)
    claims = read_claims(path)
    own = Path(gyro) if gyro is not None else None
    files, notes = _files(path, column_map, own, claims)
    return Trace(path, column_map, files, notes)


def read_all(path: Path | str, format: str | Path = "csv", gyro: Path | str | None = None) -> Recording:
    """Read a whole recording into memory; arguments and errors as open_trace and Trace.chunks."""
    trace = open_trace(path, format, gyro)
    chunks = list(trace.chunks())
    gyroscope = Samples.joined(c.gyroscope for c in chunks) if trace.has_gyroscope else None
    accelerometer = Samples.joined(c.accelerometer for c in chunks)
    return Recording(accelerometer, gyroscope, trace.events, trace.claims, trace.notes)


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
