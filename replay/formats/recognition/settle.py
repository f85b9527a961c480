"""A column map for a table of unknown make: what names do not say, the first samples decide.

The unit of acceleration follows from the size of gravity. The unit of rates follows from how fast gravity's
direction turns in body axes (checks/axes.py); where nothing turns, rad/s is assumed beside m/s^2 and deg/s
beside g, and a note says so.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.checks.axes import turnings
from stillcal.replay.formats.checks.units import shown_unit
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.clock import seconds_per_unit
from stillcal.replay.formats.columns import (
    LONG_TIME_UNITS,
    TIME_UNITS,
    Column,
    ColumnMap,
    SensorMap,
    TemperatureMap,
    TimeMap,
    find_columns,
)
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.log import BOTH, LoggedSensor, Part
from stillcal.replay.formats.recognition.names import (
    KNOWN_UNITS,
    SENSOR_WORDS,
    Axes,
    Stamps,
    find_axes,
    find_stamps,
    find_thermometer,
    unread_rates,
)
from stillcal.replay.formats.recognition.unnamed import places_of
from stillcal.replay.formats.stream import SampleFile
from stillcal.replay.formats.tables.cells import is_number
from stillcal.replay.formats.tables.dates import is_date, kind_of_dates
from stillcal.replay.formats.tables.table import EMPTY, Table

_GRAVITY_IN = {"m/s^2": (4.0, 16.0), "g": (0.4, 1.6), "mg": (400.0, 1600.0)}
"""Sizes of the median acceleration for each unit: gravity, with room for bias, scale and motion."""

_LIKE_GRAVITY = 0.05
"""Share by which the median acceleration of a phone that rests now and then differs from gravity at most."""

MOST_REPEATS = 0.5
"""Share of stamps that may repeat the one before: batches share one, but whole seconds are no clock."""

_ROWS_TOGETHER = 100
"""Rows, a second or two of them, over which motion swings back and gravity does not."""

_KEPT = 0.5
"""Size of the median vector over that of the vectors: 1 for gravity at rest, near 0 for motion without it."""

_MOSTLY_FORWARD = 0.9
"""Share of steps that a column of times makes forward at least; a few rows may be out of order."""

_PROBED_ROWS = 20_000
_FASTEST_RAD_S = 70.0
"""rad/s: 4000 deg/s, the widest range of consumer gyroscopes (Bosch BMI270 and its like measure 2000)."""


_STEADIER = 3.0
"""By so much gravity's size varies less than that of rates, where both could be gravity's by their median."""


@dataclass(frozen=True, slots=True)
class _Candidate:
    """Columns of one accelerometer, with those of its gyroscope and those that may be its time.

    rate_stamps: the gyroscope's own, where their names say so; then it is read as a table of its own.
    said: what is to be said of the choice.
    """

    accelerometer: Axes
    gyroscope: Axes | None
    stamps: Sequence[Stamps]
    rate_stamps: Sequence[Stamps] = ()
    said: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class OneSensor:
    """A table of its own that holds one sensor.

    column_map: how it is cut into columns. rate_hz: as the file states it.
    """

    table: Table
    column_map: ColumnMap
    rate_hz: float | None = None


def settled(
    table: Table, column_map: ColumnMap, rate_hz: float | None = None, rates: OneSensor | None = None
) -> list[LoggedSensor]:
    """Return the sensors that a table's column names and first samples show; none where they show none.

    column_map: how the table is cut into columns; its sensors do not matter. rate_hz: as the file states it.
    rates: where the gyroscope is that belongs to an accelerometer without one.
    Raises TraceError where there are axes of an accelerometer that cannot be read.
    """
    candidates = _paired(table.names) if table.names is not None else _counted(table)
    own = OneSensor(table, column_map, rate_hz)
    return _readable([(candidate, own, rates) for candidate in candidates])


def settled_apart(apart: Sequence[OneSensor]) -> list[LoggedSensor]:
    """Return the sensors of tables that hold one each, an accelerometer with the gyroscope of its label.

    The names of their axes differ from table to table. Raises TraceError as `settled` does.
    """
    by_name = {name: one for one in apart for name in one.table.names or ()}
    found = []
    for accelerometer, gyroscope in _pairs(find_axes(list(by_name))):
        own = by_name[str(accelerometer.columns[0])]
        candidate = _Candidate(accelerometer, None, find_stamps(own.table.names or ()))
        found.append((candidate, own, None if gyroscope is None else by_name[str(gyroscope.columns[0])]))
    return _readable(found)


def _readable(candidates: Sequence[tuple[_Candidate, OneSensor, OneSensor | None]]) -> list[LoggedSensor]:
    """Return those of accelerometers that can be read, under different names. Raises TraceError if none can.

    candidates: each with the table that holds it, and that of a gyroscope apart.
    """
    sensors: list[tuple[Axes, LoggedSensor]] = []
    faults: list[TraceError] = []
    for candidate, own, rates in candidates:
        try:
            sensor = _sensor(own.table, own.column_map, candidate, own.rate_hz, rates)
            sensors.append((candidate.accelerometer, sensor))
        except TraceError as fault:
            faults.append(fault)
    if faults and not sensors:
        raise faults[0]
    alike = Counter(sensor.name for _, sensor in sensors)
    return [
        replace(sensor, name="_".join(filter(None, (axes.label, axes.quantity))))
        if alike[sensor.name] > 1
        else sensor
        for axes, sensor in sensors
    ]


def _paired(names: Sequence[str]) -> list[_Candidate]:
    """Return each accelerometer of a table, with its gyroscope and the columns that may be its time."""
    rate_stamps = [s for s in find_stamps(names) if SENSOR_WORDS[Sensor.GYROSCOPE] & set(s.label.split("_"))]
    stamps = [s for s in find_stamps(names) if s not in rate_stamps]
    found = []
    for accelerometer, gyroscope in _pairs(find_axes(names)):
        own = [s for s in stamps if s.label in ("", accelerometer.label)]
        ordered = own + [s for s in stamps if s not in own]
        apart = [s for s in rate_stamps if gyroscope is not None and gyroscope.label in s.label]
        found.append(_Candidate(accelerometer, gyroscope, ordered or rate_stamps, apart if ordered else ()))
    return found


def _pairs(axes: Sequence[Axes]) -> Iterator[tuple[Axes, Axes | None]]:
    """Yield each accelerometer with the gyroscope of its label, or the only one there is.

    Of several with one label, the first accelerometer belongs to the first gyroscope.
    """
    force = [a for a in axes if a.sensor is Sensor.ACCELEROMETER]
    rates = [a for a in axes if a.sensor is Sensor.GYROSCOPE]
    for i, accelerometer in enumerate(force):
        same = [g for g in rates if g.label == accelerometer.label]
        earlier = sum(a.label == accelerometer.label for a in force[:i])
        same = same[earlier:] or same[-1:]
        alike = len(rates) == len(force)
        yield accelerometer, same[0] if same else rates[0] if len(rates) == 1 else rates[i] if alike else None


def _counted(table: Table) -> list[_Candidate]:
    """Return the sensors of a table without names, of which three columns or six are their axes.

    Those are the accelerometer's whose size is gravity's. Raises TraceError where both could be, or other
    columns are there.
    """
    found = places_of(table.opening)
    stamps = [Stamps(place, "", None) for place in found.times]
    axes = [
        Axes(Sensor.ACCELEROMETER, "", (x, y, z), None)
        for x, y, z in zip(found.values[0::3], found.values[1::3], found.values[2::3], strict=False)
    ]
    if len(found.values) not in (3, 6):
        what = f"has no header, and of its {table.width} columns {len(found.values)} may be axes of sensors"
        remedy = "name the columns in a first line, such as time, acc_x, ..., or count them in a column map"
        raise TraceError(table.path, what, remedy)
    first = axes[0]
    if len(axes) == 1:
        return [_Candidate(first, None, stamps)]
    probe, second = _Probe(table), axes[1]
    sizes = [probe.norms(axes) for axes in (first, second)]
    fits = [_gravity_unit(norms) is not None for norms in sizes]
    if all(fits):
        low, high = (np.subtract(*np.quantile(norms, (0.75, 0.25))) / np.median(norms) for norms in sizes)
        fits = [low * _STEADIER < high, high * _STEADIER < low]
    if sum(fits) != 1:
        one, other = (", ".join(map(str, one.columns)) for one in axes)
        what = (
            f"which of columns {one} and {other} (counted from 0) are the acceleration is not clear by size"
        )
        raise TraceError(table.path, what, "name them in a first line, such as time, acc_x, ..., gyr_z")
    force, rates = (first, second) if fits[0] else (second, first)
    if not probe.all_change(rates):
        said = f"passed over, since a gyroscope has noise on all axes: {_listed(rates)}"
        return [_Candidate(force, None, stamps, said=(said,))]
    return [_Candidate(force, replace(rates, sensor=Sensor.GYROSCOPE), stamps)]


def _sensor(
    table: Table, base: ColumnMap, candidate: _Candidate, rate_hz: float | None, rates: OneSensor | None
) -> LoggedSensor:
    probe = _Probe(table)
    accelerometer, gyroscope = candidate.accelerometer, candidate.gyroscope
    if gyroscope is not None and candidate.rate_stamps:
        rates, gyroscope = OneSensor(copy(table), base, rate_hz), None
    time, time_said = _time(table, probe, candidate.stamps, rate_hz)
    force_unit, force_said = _force_unit(table.path, probe, accelerometer)
    chosen: dict[str, Any] = {
        "time": time,
        "accelerometer": SensorMap(columns=accelerometer.columns, unit=force_unit),
        "repeats": "keep",
        "gyroscope": None,
        "temperature": None,
    }
    said = [time_said, f"accelerometer {_listed(accelerometer)} in {force_unit}{force_said}", *candidate.said]
    if gyroscope is not None:
        draft = SensorMap(columns=gyroscope.columns, unit="rad/s")
        part = Part(table, msgspec.structs.replace(base, **chosen | {"gyroscope": draft}), BOTH)
        rate_unit, rate_said = _rate_unit([part], gyroscope, force_unit)
        chosen["gyroscope"] = SensorMap(columns=gyroscope.columns, unit=rate_unit)
        said.append(f"gyroscope {_listed(gyroscope)} in {rate_unit}{rate_said}")
    elif rates is None and (unread := unread_rates(table.names or [])):
        said.append(f"not read, since they name no axes x, y, z: {', '.join(unread[:6])}")
    thermometer = find_thermometer(table.names or [], accelerometer.label)
    if thermometer is not None and probe.plausible_temperature(thermometer):
        chosen["temperature"] = TemperatureMap(column=thermometer[0], unit=thermometer[1])
        said.append(f"temperature {thermometer[0]} in {thermometer[1]}")
    column_map = msgspec.structs.replace(base, **chosen)
    how = "counted from 0" if table.names is None else "recognised by their names"
    note = f"{short_name(table.path)}: columns {how}: {'; '.join(said)}"
    sensors = [Sensor.ACCELEROMETER] + ([] if gyroscope is None else [Sensor.GYROSCOPE])
    parts, notes = [Part(table, column_map, sensors)], [note]
    if gyroscope is None and rates is not None:
        own, told = _rates_apart(rates, parts[0], force_unit, candidate)
        parts, notes = [*parts, own], [*notes, told]
    about = "accelerometer" + ("" if gyroscope is None and rates is None else ", gyroscope")
    return LoggedSensor.of(accelerometer.label or "imu", parts, about, notes)


def _rates_apart(rates: OneSensor, force: Part, force_unit: str, candidate: _Candidate) -> tuple[Part, str]:
    """Return the gyroscope that a table of its own holds, and how to say it. Raises TraceError."""
    table = rates.table
    axes = candidate.gyroscope or _gyroscope_of(candidate.accelerometer, table)
    stamps = candidate.rate_stamps or find_stamps(table.names or ())
    time, time_said = _time(table, _Probe(table), stamps, rates.rate_hz)
    chosen: dict[str, Any] = {
        "time": time,
        "accelerometer": SensorMap(columns=axes.columns, unit="m/s^2"),  # which is not read
        "gyroscope": SensorMap(columns=axes.columns, unit="rad/s"),
        "repeats": "keep",
        "temperature": None,
    }
    column_map = msgspec.structs.replace(rates.column_map, **chosen)
    part = Part(table, column_map, [Sensor.GYROSCOPE])
    unit, unit_said = _rate_unit([force, part], axes, force_unit)
    column_map = msgspec.structs.replace(column_map, gyroscope=SensorMap(columns=axes.columns, unit=unit))
    said = f"{short_name(table.path)}: {time_said}; gyroscope {_listed(axes)} in {unit}{unit_said}"
    return Part(table, column_map, [Sensor.GYROSCOPE]), said


def _gyroscope_of(accelerometer: Axes, table: Table) -> Axes:
    """Return the gyroscope in another table that has the accelerometer's label, or is the only one.

    Raises TraceError where there is none, or none of several has the label.
    """
    rates = [a for a in find_axes(table.names or ()) if a.sensor is Sensor.GYROSCOPE]
    ((_, own),) = _pairs([accelerometer, *rates])
    if own is not None:
        return own
    what, remedy = "no gyroscope found by its names", "name its columns gyr_x, gyr_y, gyr_z"
    if rates:
        what = f"none of its gyroscopes is called as the accelerometer {_listed(accelerometer)}"
        remedy = "call both alike, as left_acc_x and left_gyr_x"
    remedy = f"{remedy}, or give a column map (docs/formats.md)"
    raise TraceError(table.path, what, remedy, table.header_line)


def _listed(axes: Axes) -> str:
    return " ".join(map(str, axes.columns))


class _Probe:
    """The first rows of a table, column by column."""

    def __init__(self, table: Table) -> None:
        self._table = table

    def column(self, name: Column) -> Array:
        """Return the first values of a column, (n,), NaN where a cell is empty."""
        return self._columns([name])[:, 0]

    def norms(self, axes: Axes) -> Array:
        """Return the sizes of the first vectors, (n,)."""
        with np.errstate(over="ignore"):  # a damaged file holds numbers of any size
            norms: Array = np.linalg.norm(self._columns(axes.columns), axis=1)
        return norms[np.isfinite(norms)]

    def whole_numbers(self, axes: Axes) -> bool:
        """Whether all first values of a sensor are whole numbers."""
        values = self._columns(axes.columns)
        return not (values[np.isfinite(values)] % 1).any()

    def _columns(self, names: Sequence[Column]) -> Array:
        places = find_columns(list(names), self._table.names, self._table.width) or []
        block = next(iter(self._table.blocks(places)), None)
        values = np.empty((0, len(names))) if block is None else block.values[:_PROBED_ROWS]
        return np.where(values == EMPTY, np.nan, values)

    def all_change(self, axes: Axes) -> bool:
        """Whether none of a sensor's first values is the same throughout."""
        return bool((np.ptp(self._columns(axes.columns), axis=0) > 0).all())

    def keeps_its_direction(self, axes: Axes) -> bool:
        """Whether vectors agree over some rows, as those do that hold gravity: motion alone swings back."""
        vectors = self._columns(axes.columns)
        vectors = vectors[np.isfinite(vectors).all(axis=1)]
        count = len(vectors) // _ROWS_TOGETHER
        if not count:
            return True
        windows = vectors[: count * _ROWS_TOGETHER].reshape(count, _ROWS_TOGETHER, 3)
        with np.errstate(over="ignore"):
            kept, typical = (
                float(np.median(np.linalg.norm(v, axis=1))) for v in (np.median(windows, axis=1), vectors)
            )
        return not kept < _KEPT * typical

    def repeating_dates(self, name: Column) -> float:
        """Return the share of the first dates of a column that repeat the one before."""
        (place,) = find_columns([name], self._table.names, self._table.width) or [0]
        cells = [row[place] for row in self._table.opening if len(row) > place]
        return sum(a == b for a, b in itertools.pairwise(cells)) / max(len(cells) - 1, 1)

    def adds_up(self, stamps: Stamps) -> bool:
        """Whether a column holds whole seconds and another what is to be added to them, less than one."""
        if stamps.fraction is None or _holds_dates(self._table, stamps.column):
            return False
        column, unit = stamps.fraction
        try:
            seconds, parts = self._columns([stamps.column, column]).T
        except TraceError:
            return False
        whole = np.isfinite(seconds).all() and not (seconds % 1).any() and bool((parts >= 0).all())
        less = bool((parts * TIME_UNITS[unit] < 1).all())
        steps = np.diff(seconds + parts * TIME_UNITS[unit])
        return bool(whole and less and steps.size and np.mean(steps >= 0) >= _MOSTLY_FORWARD)

    def plausible_temperature(self, thermometer: tuple[str, str]) -> bool:
        """Whether a column holds temperatures that a sensor can have."""
        values = self.column(thermometer[0])
        low, high = {"degC": (-60.0, 150.0), "K": (210.0, 430.0), "degF": (-80.0, 300.0)}[thermometer[1]]
        known = values[np.isfinite(values)]
        return bool(known.size and low < np.median(known) < high)


def _time(
    table: Table, probe: _Probe, stamps: Sequence[Stamps], rate_hz: float | None
) -> tuple[TimeMap, str]:
    """Return where the stamps come from, and how to say it. Raises TraceError where there are none."""
    unusable = None
    paired = next((s for s in stamps if s.fraction is not None and probe.adds_up(s)), None)
    if paired is not None and paired.fraction is not None:
        (column, unit) = paired.fraction
        said = f"time {paired.column} in s and {column} in {unit}"
        return TimeMap(column=paired.column, unit="s", fraction=column, fraction_unit=unit), said
    stamps = [s for s in stamps if s.fraction is None]
    dated = [Stamps(name, "", None) for name in table.names or () if _holds_dates(table, name)]
    for choice in [*stamps, *dated]:
        found = _in_column(table, probe, choice)
        if isinstance(found, TimeMap):
            return found, f"time {choice.column} in {_kind_of_time(table, probe, choice, found)}"
        unusable = unusable or found
    if rate_hz is not None:
        return TimeMap(rate_hz=rate_hz), f"no time stamps, {rate_hz:.6g} Hz as the file states"
    if unusable is not None:
        raise unusable
    what = "no column of time stamps found"
    raise TraceError(table.path, what, "name one t (s), or give rate_hz in a column map (docs/formats.md)")


def _kind_of_time(table: Table, probe: _Probe, choice: Stamps, found: TimeMap) -> str:
    """Return what is said of the times in a column: the rate too where only their steps show the unit."""
    if found.unit == "date":
        return kind_of_dates(_first_cell(table, choice.column))
    if choice.unit is not None:
        return found.unit
    step = _step(probe.column(choice.column)) * (TIME_UNITS | LONG_TIME_UNITS)[found.unit]
    return f"{found.unit} (by its steps, {1 / step:.3g} Hz)"


def _in_column(table: Table, probe: _Probe, choice: Stamps) -> TimeMap | TraceError | None:
    """Return the time in a column; what is wrong with it where it cannot be used, None where it is none.

    Raises TraceError where it holds times, and the file is damaged further on.
    """
    column = choice.column
    if _holds_dates(table, column):
        repeating = probe.repeating_dates(column)
        return _too_coarse(table, column, repeating) or TimeMap(column=column, unit="date")
    try:
        values = probe.column(column)
    except TraceError as error:
        if is_number(_first_cell(table, column)):
            raise
        remedy = "give the time as a number of s, ms, us or ns, or as a date such as 2026-03-01 10:00:00.02"
        return TraceError(table.path, error.what, remedy, error.row)
    unit = _time_unit(choice, values)
    if unit is not None:
        return _too_coarse(table, column, _repeating(values)) or TimeMap(column=column, unit=unit)
    if choice.unit is not None or not _goes_forward(values):
        return None
    what = f"column {column!r} goes in steps of {_step(values):.4g}, which shows no unit of time"
    remedy = "say the unit in its name (time_s, time_ms, time_us), or in a column map (docs/formats.md)"
    return TraceError(table.path, what, remedy)


def _too_coarse(table: Table, column: Column, repeating: float) -> TraceError | None:
    """Return the error where a share of stamps that repeat the one before is too large for a clock."""
    if repeating <= MOST_REPEATS:
        return None
    what = f"{repeating:.0%} of the stamps in column {column!r} repeat the one before"
    return TraceError(table.path, what, "give one column of times that differ from sample to sample")


def _holds_dates(table: Table, column: Column) -> bool:
    """Whether a column of a text table begins with a date."""
    return is_date(_first_cell(table, column))


def _first_cell(table: Table, column: Column) -> bytes:
    """Return the first cell of a column of a text table, nothing where the table is none of text."""
    (place,) = find_columns([column], table.names, table.width) or [0]
    return table.first_row[place].encode() if len(table.first_row) > place else b""


def _time_unit(choice: Stamps, values: Array) -> Any:
    """Return the unit of a column of stamps, None where its values are none."""
    known = values[np.isfinite(values)]
    if not _goes_forward(values):
        return None
    seconds = seconds_per_unit("auto" if choice.unit is None else choice.unit, known, None)
    if (
        "fine" in choice.label and seconds != 1e-6
    ):  # Xsens' SampleTimeFine: us in some devices, 0.1 ms in others
        return None
    return {length: unit for unit, length in (TIME_UNITS | LONG_TIME_UNITS).items()}.get(seconds or 0.0)


def _goes_forward(values: Array) -> bool:
    """Whether a column of numbers, (n,), NaN where a cell is empty, goes forward as times do."""
    known = values[np.isfinite(values)]
    return bool(known.size > 1 and known[-1] > known[0] and np.mean(np.diff(known) >= 0) >= _MOSTLY_FORWARD)


def _step(values: Array) -> float:
    """Return the median step forward of a column of numbers."""
    steps = np.diff(values[np.isfinite(values)])
    return float(np.median(steps[steps > 0]))


def _repeating(stamps: Array) -> float:
    """Return the share of stamps that repeat the one before."""
    return float(np.mean(np.diff(stamps) == 0)) if stamps.size > 1 else 0.0


def _force_unit(path: Path, probe: _Probe, axes: Axes) -> tuple[Any, str]:
    """Return the unit of acceleration and where it comes from. Raises TraceError without gravity."""
    if axes.unit is not None:
        return _known(path, axes), ""
    norms = probe.norms(axes)
    unit = _gravity_unit(norms)
    if unit is not None and not probe.keeps_its_direction(axes):
        what = f"{_listed(axes)} swing about zero: gravity was taken out"
        raise TraceError(path, what, "give the accelerometer with gravity")
    if unit is not None:
        whole = unit == "mg" and probe.whole_numbers(axes)
        counts = "; whole numbers: if they are raw counts, say the value of one in a column map"
        return unit, f" (by the size of gravity{counts if whole else ''})"
    typical = float(np.median(norms)) if norms.size else 0.0
    what = f"{_listed(axes)} are about {typical:.4g} in size, which is gravity in no unit"
    remedy = "give the accelerometer with gravity; of raw counts say the value of one in a column map"
    raise TraceError(path, what, remedy)


def _known(path: Path, axes: Axes) -> str | None:
    """Return the unit that names state. Raises TraceError where it is none that is known."""
    if axes.unit in KNOWN_UNITS:
        return axes.unit
    what = f"{_listed(axes)} are in {axes.unit}, which is no unit that is known"
    remedy = (
        'say in a column map how many make one SI unit: unit = "counts", counts_per_unit (docs/formats.md)'
    )
    raise TraceError(path, what, remedy)


def measures_gravity(table: Table, axes: Axes) -> bool:
    """Whether columns of an unknown kind are an accelerometer's: of gravity's size, as positions rarely are.

    Rows of several sensors in turn are not: many are smaller or larger by far. Raises TraceError where they
    hold no numbers.
    """
    norms = _Probe(table).norms(axes)
    low, typical, high = np.quantile(norms, (0.1, 0.5, 0.9)) if norms.size else (0.0, 0.0, 0.0)
    like = any(abs(typical / one - 1) < _LIKE_GRAVITY for one in (STANDARD, 1.0, 1000.0))
    return bool(like and low > typical / 2 and high < 2 * typical)


def _gravity_unit(norms: Array) -> str | None:
    """Return the unit in which sizes (n,) are gravity's, None where they are in none."""
    typical = float(np.median(norms)) if norms.size else 0.0
    return next((unit for unit, (low, high) in _GRAVITY_IN.items() if low < typical < high), None)


def _rate_unit(parts: Sequence[Part], axes: Axes, force_unit: str) -> tuple[Any, str]:
    """Return the unit of rates, and where it comes from. parts: both sensors, the rates read as rad/s."""
    if axes.unit is not None:
        return _known(parts[-1].table.path, axes), ""
    unit, said = rate_unit_shown(parts)
    if unit is not None:
        return unit, f" ({said})"
    unit = "rad/s" if force_unit == "m/s^2" else "deg/s"
    return unit, f" (assumed, as usual beside {force_unit}; a column map can say otherwise)"


def rate_unit_shown(parts: Sequence[Part], fewest: int = 1) -> tuple[Any, str]:
    """Return the unit that the first rates show themselves to have, None where they show none, and how.

    parts: both sensors, the rates read as rad/s. fewest: spans of some seconds that must show it.
    """
    first: dict[Sensor, Samples] = {}
    for part in parts:
        for sensor, samples in _first_run(SampleFile(part.table, part.column_map, part.sensors, Claims())):
            first[sensor] = samples
    accelerometer, gyroscope = (
        first.get(s, Samples.empty(s)) for s in (Sensor.ACCELEROMETER, Sensor.GYROSCOPE)
    )
    fastest = float(np.abs(gyroscope.xyz).max()) if len(gyroscope) else 0.0
    if fastest > np.degrees(_FASTEST_RAD_S):
        return "mdeg/s", "too fast for deg/s"
    votes = Counter(map(shown_unit, turnings(accelerometer, gyroscope)))
    if max(votes["deg/s"], votes["as stated"]) >= fewest and votes["deg/s"] != votes["as stated"]:
        unit = "deg/s" if votes["deg/s"] > votes["as stated"] else "rad/s"
        return unit, "as gravity's direction turns"
    return ("deg/s", "too fast for rad/s") if fastest > _FASTEST_RAD_S else (None, "")


def _first_run(file: SampleFile) -> list[tuple[Sensor, Samples]]:
    """Return the first samples of each sensor of a file."""
    runs: dict[Sensor, list[Samples]] = {sensor: [] for sensor in file.sensors}
    count = 0
    for run in file.runs():
        for sensor, samples in run.items():
            runs[sensor].append(samples)
            count = max(count, sum(map(len, runs[sensor])))
        if count >= _PROBED_ROWS:
            break
    return [(sensor, Samples.joined(found)[:_PROBED_ROWS]) for sensor, found in runs.items() if found]
