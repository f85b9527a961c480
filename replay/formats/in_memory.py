"""A recording from what is in memory: arrays, or a table of columns such as a pandas data frame.

A table has the columns of the CSV format (docs/formats.md), a NaN standing for an empty cell. What is refused
in a file is refused here too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Samples, Sensor, warmed
from stillcal.replay.formats.checks.units import UnitCheck
from stillcal.replay.formats.claims import Claims, Event, plausible_event
from stillcal.replay.formats.columns import load_map
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.merge import Cut
from stillcal.replay.formats.recognition.log import Log, LoggedSensor, Part
from stillcal.replay.formats.recognition.names.kinds import is_own
from stillcal.replay.formats.recognition.settle import settled
from stillcal.replay.formats.stream import filled_forward
from stillcal.replay.formats.tables.dates import dates_in_seconds, is_date
from stillcal.replay.formats.tables.numbers import in_arrays
from stillcal.replay.formats.tables.table import EMPTY
from stillcal.replay.formats.trace import Recording, Trace, whole

AXES = {Sensor.ACCELEROMETER: ("ax", "ay", "az"), Sensor.GYROSCOPE: ("gx", "gy", "gz")}
_OWN_COLUMNS = {"t", "temperature", "t_arrival", *AXES[Sensor.ACCELEROMETER], *AXES[Sensor.GYROSCOPE]}


def is_table(table: Any) -> bool:
    """Whether something has named columns: a data frame, an Arrow table, a mapping or a structured array."""
    return _keys(table) is not None


def _keys(table: Any) -> list[Any] | None:
    """Return what a table's columns are called, as it is asked for them; None where it is no table."""
    if isinstance(table, Mapping):
        return list(table)
    names = getattr(table, "column_names", None)  # Arrow, whose `columns` are the values
    if names is None:
        names = getattr(table, "columns", None)
    if names is None:
        names = getattr(getattr(table, "dtype", None), "names", None)
    return None if names is None else list(names)


def of_table(
    table: Any, name: str, events: Iterable[Any], claims: Any, sensor: str | None = None
) -> Recording:
    """Return the recording that a table of columns holds, by the rules for one in a file.

    sensor: which one of several is read, as of a file. Raises TraceError where it cannot be used.
    """
    numbers: dict[str, Array] = {}
    columns = dict(_columns(table))
    for column, values in columns.items():
        with suppress(TypeError, ValueError):  # texts
            numbers[column] = np.asarray(values, dtype=np.float64)
    for column in _OWN_COLUMNS & columns.keys() - numbers.keys():
        raise TraceError(name, f"{column} holds what is not a number", "give numbers, NaN for none")
    lengths = {column: values.size for column, values in numbers.items() if values.ndim == 1}
    if len(set(lengths.values())) > 1:
        (first, n), (other, m) = (
            min(lengths.items(), key=itemgetter(1)),
            max(lengths.items(), key=itemgetter(1)),
        )
        what = f"column {first!r} has {n} rows and {other!r} {m}"
        raise TraceError(name, what, "give columns of one length, or the arrays by keyword")
    cells = in_arrays(Path(name), {column: numbers[column] for column in lengths}, 0)
    own = load_map("csv")
    if is_own(list(numbers)):
        held = [s for s, axes in AXES.items() if any(axis in numbers for axis in axes)]
        sensors = [LoggedSensor.of("imu", [Part(cells, own, held)])]
    else:
        sensors = settled(cells, own)
    if not sensors:
        listed = ", ".join(list(columns)[:12]) or "it has none"
        what = f"no accelerometer found in its columns ({listed})"
        raise TraceError(name, what, "name them t, ax, ay, az (s, m/s^2) and gx, gy, gz (rad/s)")
    found = Trace(Log(Path(name), "table", sensors), sensor).recording(name)
    ordered, maker = _told(events, claims, name)
    return replace(found, events=ordered, claims=maker)


def _columns(table: Any) -> Iterator[tuple[str, Any]]:
    """Yield a table's columns by name, times in s; arrays of three columns as `acc[0]` to `acc[2]`.

    The index of a data frame is a column too, where it has a name or holds times.
    """
    index = None if isinstance(table, Mapping) else getattr(table, "index", None)
    kind = getattr(getattr(index, "dtype", None), "kind", "")
    if kind and (getattr(index, "name", None) is not None or kind in "mM"):
        yield str(getattr(index, "name", None) or "time"), _in_seconds(index)
    for key in _keys(table) or []:
        named = "_".join(map(str, key)) if isinstance(key, tuple) else str(key)
        values = _in_seconds(table[key])
        if getattr(values, "ndim", 1) == 2:
            yield from ((f"{named}[{i}]", column) for i, column in enumerate(np.asarray(values).T))
        else:
            yield named, values


def _in_seconds(values: Any) -> Any:
    """Return dates as s since 1970, spans of time in s, and anything else as it is."""
    kind = getattr(getattr(values, "dtype", None), "kind", "")
    if kind in ("m", "M"):
        stamps = np.asarray(values, dtype=f"{'datetime' if kind == 'M' else 'timedelta'}64[ns]")
        return np.where(np.isnat(stamps), np.nan, stamps.astype(np.int64) / 1e9)
    texts = not kind or kind in "OU"
    if texts and np.ndim(values) == 1 and all(isinstance(v, str) and is_date(v.encode()) for v in values):
        return dates_in_seconds([v.encode() for v in values])
    return values


def part_of(recording: Recording, start: float | None, stop: float | None) -> Recording:
    """Return what of a recording lies between two times, s after its first sample. Raises TraceError."""
    cut = Cut(start, stop)
    pairs = list(cut.applied((c.accelerometer, c.gyroscope) for c in recording.chunks()))
    accelerometer = whole([a for a, _ in pairs]) if pairs else recording.accelerometer[:0]
    if len(accelerometer) < 2:
        what = f"{cut.said} {len(accelerometer)} samples of the accelerometer"
        raise TraceError(recording.name, what, "give a longer part")
    gyroscope = None if recording.gyroscope is None else whole([g for _, g in pairs])
    events = cut.started(recording.events, *pairs[0])
    end = max(float(s.t[-1]) for s in pairs[-1] if len(s))
    kept = events if stop is None else [event for event in events if event.t <= end]
    return replace(
        recording,
        accelerometer=accelerometer,
        gyroscope=gyroscope,
        events=kept,
        begun=recording.beginning,
    )


def of_arrays(
    *,
    t: ArrayLike,
    accelerometer: ArrayLike,
    gyroscope: ArrayLike | None,
    gyroscope_t: ArrayLike | None,
    temperature: ArrayLike | None,
    t_arrival: ArrayLike | None,
    name: str,
    events: Iterable[Any],
    claims: Any,
) -> Recording:
    """Return the recording that arrays hold; see stillcal.load. Raises TraceError where it cannot be used."""
    stamps = _numbers(t, "t", name)
    also = (
        None if temperature is None else _filled(_numbers(temperature, "temperature", name)),
        None if t_arrival is None else _filled(_numbers(t_arrival, "t_arrival", name)),
    )
    force = _numbers(accelerometer, "accelerometer", name)
    accel = _samples(name, Sensor.ACCELEROMETER, stamps, force, also)
    if gyroscope is None:
        return checked(accel, None, name, events, claims)
    rate = _numbers(gyroscope, "gyroscope", name)
    if gyroscope_t is None:
        gyro = _samples(name, Sensor.GYROSCOPE, stamps, rate, also)
    else:
        gyro = _samples(name, Sensor.GYROSCOPE, _numbers(gyroscope_t, "gyroscope_t", name), rate)
    return checked(accel, warmed(gyro, accel), name, events, claims)


def checked(
    accelerometer: Samples, gyroscope: Samples | None, name: str, events: Iterable[Any], claims: Any
) -> Recording:
    """Return a recording whose units have been looked at as those of a file are.

    events, claims: as for `_told`. Raises TraceError where the units, an event or a claim cannot be right.
    """
    if len(accelerometer) < 2:
        what = f"the recording holds {len(accelerometer)} samples of the accelerometer"
        raise TraceError(name, what, "give a recording of some minutes")
    recording = Recording(accelerometer, gyroscope, *_told(events, claims, name), [], name)
    units = UnitCheck(Path(name))
    for chunk in recording.chunks():
        units.see(chunk.accelerometer, chunk.gyroscope)
    units.finish()
    return recording


def _told(events: Iterable[Any], claims: Any, name: str) -> tuple[list[Event], Claims]:
    """Return events in time order, and claims.

    events: events, or mappings as lines of NAME.events.jsonl hold them. claims: Claims, a mapping as
    NAME.json holds it, or None. Raises TraceError.
    """
    try:
        told = [plausible_event(msgspec.convert(e, Event, from_attributes=True)) for e in events]
        maker = Claims() if claims is None else msgspec.convert(claims, Claims, from_attributes=True)
    except ValueError as error:
        raise TraceError(name, f"not an event, or not a claim: {error}", "see docs/formats.md") from None
    return sorted(told, key=lambda event: event.t), maker


def _samples(
    name: str, sensor: Sensor, t: Array, xyz: Array, also: tuple[Array | None, Array | None] = (None, None)
) -> Samples:
    """Return the rows in which a sensor has a sample: all but those whose three cells are NaN.

    also: temperatures and times of arrival.
    """
    if t.ndim != 1 or xyz.shape != (t.size, 3):
        what = f"the {sensor} has shape {xyz.shape} and its time stamps {t.shape}"
        raise TraceError(name, what, "give (n, 3) and (n,)")
    for what, column in zip(("temperature", "t_arrival"), also, strict=True):
        if column is not None and column.shape != t.shape:
            raise TraceError(name, f"{what} has shape {column.shape}", f"give {t.shape}")
    there = ~np.isnan(xyz).all(axis=1)
    warm, arrival = (None if column is None else column[there] for column in also)
    try:
        return Samples.checked(sensor, t[there], xyz[there], warm, arrival)
    except ValueError as error:
        raise TraceError(name, f"{sensor}: {error}", "correct or delete that row") from None


def _numbers(values: Any, column: str, name: str) -> Array:
    try:
        return np.asarray(_in_seconds(values), dtype=np.float64)
    except (TypeError, ValueError):
        raise TraceError(name, f"{column} holds what is not a number", "give numbers, NaN for none") from None


def _filled(column: Array | None) -> Array | None:
    """Return a column with unknown values filled by the one before; None where nothing is known."""
    if column is None or not column.size:
        return None
    return filled_forward(np.where(np.isnan(column), EMPTY, column), np.nan)
