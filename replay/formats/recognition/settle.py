"""A column map for a table of unknown make: what names do not say, the first samples decide.

The unit of acceleration follows from the size of gravity. The unit of rates follows from how fast gravity's
direction turns in body axes (checks/axes.py); where nothing turns, rad/s is assumed beside m/s^2 and deg/s
beside g, and a note says so.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.columns import (
    ColumnMap,
    SensorMap,
    TemperatureMap,
)
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.log import BOTH, LoggedSensor, Part
from stillcal.replay.formats.recognition.names.axes import Axes, find_axes
from stillcal.replay.formats.recognition.names.kinds import unread_rates
from stillcal.replay.formats.recognition.names.stamps import Stamps, find_stamps, find_thermometer
from stillcal.replay.formats.recognition.names.vocabulary import SENSOR_WORDS
from stillcal.replay.formats.recognition.settling.probe import Probe
from stillcal.replay.formats.recognition.settling.time_column import time_of
from stillcal.replay.formats.recognition.settling.units import (
    Unit,
    is_gravity,
    unit_of_force,
    unit_of_rates,
)
from stillcal.replay.formats.recognition.unnamed import places_of
from stillcal.replay.formats.tables.table import Table

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
    """Return those of accelerometers that can be read, under different names; raw counts last.

    Raises TraceError if none can.

    candidates: each with the table that holds it, and that of a gyroscope apart.
    """
    sensors: list[tuple[str, Axes, LoggedSensor]] = []
    faults: list[TraceError] = []
    for candidate, own, rates in candidates:
        try:
            unit, sensor = _sensor(own.table, own.column_map, candidate, own.rate_hz, rates)
            sensors.append((unit, candidate.accelerometer, sensor))
        except TraceError as fault:
            faults.append(fault)
    if faults and not sensors:
        raise faults[0]
    sensors.sort(key=lambda found: found[0] == "counts")
    alike = Counter(sensor.name for *_, sensor in sensors)
    return [
        replace(sensor, name="_".join(filter(None, (axes.label, axes.quantity))))
        if alike[sensor.name] > 1
        else sensor
        for _, axes, sensor in sensors
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
    probe, second = Probe(table), axes[1]
    sizes = [probe.norms(axes) for axes in (first, second)]
    fits = [is_gravity(probe, axes) for axes in (first, second)]
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
        said = f"passed over, since a gyroscope has noise on all axes: {rates.listed()}"
        return [_Candidate(force, None, stamps, said=(said,))]
    return [_Candidate(force, replace(rates, sensor=Sensor.GYROSCOPE), stamps)]


def _sensor(
    table: Table, base: ColumnMap, candidate: _Candidate, rate_hz: float | None, rates: OneSensor | None
) -> tuple[str, LoggedSensor]:
    """Return the sensor of an accelerometer, and the unit of its columns. Raises TraceError."""
    probe = Probe(table)
    accelerometer, gyroscope = candidate.accelerometer, candidate.gyroscope
    if gyroscope is not None and candidate.rate_stamps:
        rates, gyroscope = OneSensor(copy(table), base, rate_hz), None
    time, time_said = time_of(table, probe, candidate.stamps, rate_hz)
    force = unit_of_force(table.path, probe, accelerometer)
    chosen: dict[str, Any] = {
        "time": time,
        "accelerometer": force.of(accelerometer),
        "repeats": "keep",
        "gyroscope": None,
        "temperature": None,
    }
    said = [time_said, f"accelerometer {accelerometer.listed()} in {force.name}{force.said}", *candidate.said]
    if gyroscope is not None:
        draft = SensorMap(columns=gyroscope.columns, unit="rad/s")
        part = Part(table, msgspec.structs.replace(base, **chosen | {"gyroscope": draft}), BOTH)
        rate = unit_of_rates([part], gyroscope, force)
        chosen["gyroscope"] = rate and rate.of(gyroscope)
        said.append(_said_of(gyroscope, rate))
    elif rates is None and (unread := unread_rates(table.names or [])):
        said.append(f"not read, since they name no axes x, y, z: {', '.join(unread[:6])}")
    thermometer = find_thermometer(table.names or [], accelerometer.label)
    if thermometer is not None and probe.plausible_temperature(thermometer):
        chosen["temperature"] = TemperatureMap(column=thermometer[0], unit=thermometer[1])
        said.append(f"temperature {thermometer[0]} in {thermometer[1]}")
    column_map = msgspec.structs.replace(base, **chosen)
    how = "counted from 0" if table.names is None else "recognised by their names"
    note = f"{short_name(table.path)}: columns {how}: {'; '.join(said)}"
    sensors = [Sensor.ACCELEROMETER] + ([] if chosen["gyroscope"] is None else [Sensor.GYROSCOPE])
    parts, notes = [Part(table, column_map, sensors)], [note]
    if gyroscope is None and rates is not None:
        own, told = _rates_apart(rates, parts[0], force, candidate)
        parts, notes = [*parts, *own], [*notes, told]
    about = "accelerometer" + ("" if gyroscope is None and rates is None else ", gyroscope")
    return force.name, LoggedSensor.of(accelerometer.label or "imu", parts, about, notes)


def _said_of(gyroscope: Axes, rate: Unit | None) -> str:
    """Say in which unit a gyroscope's columns are read; None: in none."""
    if rate is None:
        why = "raw counts, and turns do not show the value of one (say it in a column map)"
        return f"gyroscope {gyroscope.listed()} not read: {why}"
    return f"gyroscope {gyroscope.listed()} in {rate.name}{rate.said}"


def _rates_apart(
    rates: OneSensor, force: Part, force_unit: Unit, candidate: _Candidate
) -> tuple[list[Part], str]:
    """Return the gyroscope that a table of its own holds, and how to say it. Raises TraceError.

    There is none where its unit is not known.
    """
    table = rates.table
    axes = candidate.gyroscope or _gyroscope_of(candidate.accelerometer, table)
    stamps = candidate.rate_stamps or find_stamps(table.names or ())
    time, time_said = time_of(table, Probe(table), stamps, rates.rate_hz)
    chosen: dict[str, Any] = {
        "time": time,
        "accelerometer": SensorMap(columns=axes.columns, unit="m/s^2"),  # which is not read
        "gyroscope": SensorMap(columns=axes.columns, unit="rad/s"),
        "repeats": "keep",
        "temperature": None,
    }
    column_map = msgspec.structs.replace(rates.column_map, **chosen)
    part = Part(table, column_map, [Sensor.GYROSCOPE])
    unit = unit_of_rates([force, part], axes, force_unit)
    said = f"{short_name(table.path)}: {time_said}; {_said_of(axes, unit)}"
    if unit is None:
        return [], said
    column_map = msgspec.structs.replace(column_map, gyroscope=unit.of(axes))
    return [Part(table, column_map, [Sensor.GYROSCOPE])], said


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
        what = f"none of its gyroscopes is called as the accelerometer {accelerometer.listed()}"
        remedy = "call both alike, as left_acc_x and left_gyr_x"
    remedy = f"{remedy}, or give a column map (docs/formats.md)"
    raise TraceError(table.path, what, remedy, table.header_line)
