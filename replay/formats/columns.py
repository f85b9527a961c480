"""Column maps: which column of a log is which quantity, in which unit. Written in TOML, checked here.

A map is all that a plain-text log needs to be read; the formats that stillcal knows by name are maps in
config/formats, a user's own is a file like them (docs/formats.md). Nothing here opens a recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import (
    NO_WRITER,
    NotRegularError,
    NoWriterError,
    TooLargeError,
    input_name,
    is_read_once,
    read_input,
)
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.sources import cannot_open

MOST_BYTES = 1 << 24
"""Longest column map that is read."""

Column = str | Annotated[int, msgspec.Meta(ge=0)]
"""A column by its name in the header, or by its place counted from 0."""

Positive = Annotated[float, msgspec.Meta(gt=0)]
Sign = Literal[-1, 1]

_FORCE_UNITS = {
    "m/s^2": 1.0,
    "cm/s^2": 0.01,
    "g": STANDARD,
    "mg": STANDARD / 1000,
    "ug": STANDARD / 1_000_000,
}
_RATE_UNITS = {
    "rad/s": 1.0,
    "mrad/s": 0.001,
    "deg/s": 0.017453292519943295,
    "mdeg/s": 1.7453292519943295e-05,
}
"""SI values of one unit of force and of rate."""

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Seconds in one unit of a time column."""

LONG_TIME_UNITS = {"min": 60.0, "h": 3600.0, "days": 86400.0}
"""Seconds in units that are stated, or seen to be a spreadsheet's days."""


class TimeMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where the stamps come from: a column with a unit, a column of sample numbers, or a fixed rate.

    unit "auto" picks s, ms, us or ns so that the median step is a sensor's (0.5 ms to 0.5 s); "date" reads
    dates with a time as ISO 8601 writes them, as s since 1970, UTC where they do not say. fraction: a column
    of what is added to whole seconds, as where ROS writes `secs` and `nsecs`.
    """

    column: Column | None = None
    unit: Literal["s", "ms", "us", "ns", "min", "h", "days", "samples", "auto", "date"] = "s"
    fraction: Column | None = None
    fraction_unit: Literal["ms", "us", "ns"] = "ns"
    rate_hz: Positive | None = None
    arrival: Column | None = None
    arrival_unit: Literal["s", "ms", "us", "ns"] = "s"

    def __post_init__(self) -> None:
        if (self.column is None or self.unit == "samples") and self.rate_hz is None:
            raise ValueError("rate_hz is needed where there is no time column or its unit is 'samples'")
        if self.fraction is not None and (self.column is None or self.unit != "s"):
            raise ValueError("fraction goes with a column of whole seconds, unit 's'")


class SensorMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Three columns of one sensor, for the phone's x, y and z.

    columns name the log's columns that are x, y, z (an axis swap is another order); signs turn axes
    round. unit "counts" needs counts_per_unit (counts in one m/s^2 or rad/s); zero is taken off first.
    gravity: columns of the same unit that are added, where a log keeps gravity apart from the rest.
    optional: the columns may be missing. other_file: [[part, replacement], ...] of the file's name that
    lead to the sensor's own file. refuse: {file stem: [why, remedy]} of files that cannot serve.
    """

    columns: tuple[Column, Column, Column]
    unit: Literal["m/s^2", "cm/s^2", "g", "mg", "ug", "rad/s", "mrad/s", "deg/s", "mdeg/s", "counts"]
    signs: tuple[Sign, Sign, Sign] = (1, 1, 1)
    counts_per_unit: Positive | None = None
    zero: float = 0.0
    gravity: tuple[Column, Column, Column] | None = None
    optional: bool = False
    other_file: tuple[tuple[str, str], ...] = ()
    refuse: dict[str, tuple[str, str]] = {}

    def __post_init__(self) -> None:
        if (self.unit == "counts") != (self.counts_per_unit is not None):
            raise ValueError("counts_per_unit goes with unit 'counts', and only with it")
        if self.gravity is not None and self.unit not in _FORCE_UNITS:
            raise ValueError(f"gravity is added to an acceleration in {', '.join(_FORCE_UNITS)} only")

    @property
    def read(self) -> tuple[Column, ...]:
        """All columns that the sensor is read from."""
        return (*self.columns, *(self.gravity or ()))

    @property
    def si_per_unit(self) -> float:
        """SI value of one unit of the columns, in m/s^2 or rad/s."""
        if self.counts_per_unit is not None:
            return 1.0 / self.counts_per_unit
        return (_FORCE_UNITS | _RATE_UNITS)[self.unit]


class TemperatureMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The thermometer's column; cells may be empty, the column may be missing."""

    column: Column
    unit: Literal["degC", "K", "degF"] = "degC"

    @property
    def celsius(self) -> tuple[float, float]:
        """Return (factor, offset): degC = factor * value + offset."""
        return {"degC": (1.0, 0.0), "K": (1.0, -273.15), "degF": (5 / 9, -160 / 9)}[self.unit]


class SelectMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Read only the rows whose `columns` hold `values`; without values, those of the first row."""

    columns: tuple[Column, ...]
    values: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if not self.columns or (self.values is not None and len(self.values) != len(self.columns)):
            raise ValueError("select needs columns, and as many values as columns")


class ColumnMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How to read one kind of log.

    delimiter: one character, "space" for runs of blanks, or "auto" (the header's own: comma,
    semicolon or tab). header: names stand in the first line after skip_lines; lines_after_header, of units or
    the like, follow it. decimal: the decimal mark, or "auto": a comma where the first rows' numbers hold it.
    reorder: rows by which a stamp may stand too late and is put back. repeats: what to do with a stamp equal
    to the one before: "drop" the sample, "keep" it, or "refuse" the file.
    """

    time: TimeMap
    accelerometer: SensorMap
    gyroscope: SensorMap | None = None
    temperature: TemperatureMap | None = None
    select: SelectMap | None = None
    description: str = ""
    delimiter: Annotated[str, msgspec.Meta(pattern=r"^([^\w\s.\"+-]|\t|space|auto)$")] = ","
    header: bool = True
    skip_lines: Annotated[int, msgspec.Meta(ge=0)] = 0
    lines_after_header: Annotated[int, msgspec.Meta(ge=0)] = 0
    decimal: Literal[".", ",", "auto"] = "."
    reorder: Annotated[int, msgspec.Meta(ge=0, le=100_000)] = 0
    repeats: Literal["drop", "keep", "refuse"] = "drop"

    def __post_init__(self) -> None:
        if self.accelerometer.unit in _RATE_UNITS:
            raise ValueError(f"accelerometer.unit {self.accelerometer.unit!r} is a unit of rate")
        if self.gyroscope is not None and self.gyroscope.unit in _FORCE_UNITS:
            raise ValueError(f"gyroscope.unit {self.gyroscope.unit!r} is a unit of acceleration")
        if not self.header and any(isinstance(column, str) for column in self._columns()):
            raise ValueError("without a header, columns are numbers counted from 0")

    def sensor(self, sensor: Sensor) -> SensorMap:
        """Return the map of one sensor, which must be there."""
        chosen = self.accelerometer if sensor is Sensor.ACCELEROMETER else self.gyroscope
        if chosen is None:
            raise ValueError("the column map has no gyroscope")
        return chosen

    def _columns(self) -> list[Column]:
        sensors = [self.accelerometer] + ([self.gyroscope] if self.gyroscope else [])
        thermometer = self.temperature.column if self.temperature else None
        single = [self.time.column, self.time.fraction, self.time.arrival, thermometer]
        chosen = self.select.columns if self.select else ()
        return [*(c for s in sensors for c in s.read), *(c for c in single if c is not None), *chosen]


def builtin_formats() -> list[str]:
    """Return the names of the formats that stillcal knows without a file of the user's."""
    maps = resources.files("stillcal.config").joinpath("formats").iterdir()
    return sorted(m.name.removesuffix(".toml") for m in maps if m.name.endswith(".toml"))


def load_map(name: str | Path) -> ColumnMap:
    """Read a column map: a built-in format's name, or the path of a TOML file ("-": standard input).

    Raises TraceError where there is no such format or the map is not valid.
    """
    if str(name) in builtin_formats():
        inside = resources.files("stillcal.config").joinpath("formats", f"{name}.toml")
        return parse_map(inside.read_bytes(), Path(f"{name}.toml"))
    if not is_read_once(name) and not Path(name).exists():
        known = ", ".join(builtin_formats())
        remedy = f"name one of {known}, rest, or the path of a column map (TOML)"
        raise TraceError(name, "no such format", remedy)
    path = Path(input_name(name))
    try:
        return parse_map(read_input(name, MOST_BYTES), path)
    except NoWriterError:
        raise TraceError(path, *NO_WRITER) from None
    except (NotRegularError, TooLargeError) as error:
        raise TraceError(
            path, f"is {error.strerror}", "give a column map as docs/formats.md has it"
        ) from None
    except OSError as error:
        raise cannot_open(path, error) from None


def parse_map(text: bytes, path: Path) -> ColumnMap:
    """Turn TOML into a checked map. Raises TraceError naming the field at fault."""
    try:
        return msgspec.toml.decode(text, type=ColumnMap)
    except msgspec.ValidationError as error:
        raise TraceError(path, f"not a valid column map: {error}", "see docs/formats.md") from None
    except (msgspec.DecodeError, UnicodeDecodeError, ValueError) as error:
        raise TraceError(path, f"not TOML: {error}", "correct the line it names") from None


def find_columns(wanted: Sequence[Column], names: Sequence[str] | None, width: int) -> list[int] | None:
    """Return the places of `wanted` among the header's names (or `width` columns), None if any is missing.

    The mark of a comment before a name (#, %) does not count: headers are read without it.
    """
    places = []
    for column in wanted:
        if isinstance(column, int):
            if column >= width:
                return None
            places.append(column)
        elif names is None or (column not in names and column.lstrip("#% ") not in names):
            return None
        else:
            places.append(list(names).index(column if column in names else column.lstrip("#% ")))
    return places
