"""A recording from what is in memory: arrays, or a table of columns such as a pandas data frame.

A table has the columns of the CSV format (docs/formats.md), a NaN standing for an empty cell. What is refused
in a file is refused here too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.checks.units import UnitCheck
from stillcal.replay.formats.claims import Claims, Event
from stillcal.replay.formats.columns import load_map
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.log import Log
from stillcal.replay.formats.recognition.settle import settled
from stillcal.replay.formats.stream import filled_forward
from stillcal.replay.formats.tables.numbers import in_arrays
from stillcal.replay.formats.tables.table import EMPTY
from stillcal.replay.formats.trace import Chunk, Recording, Trace, whole

AXES = {Sensor.ACCELEROMETER: ("ax", "ay", "az"), Sensor.GYROSCOPE: ("gx", "gy", "gz")}


def column_names(table: Any) -> list[str] | None:
    """Return the names of a table's columns; None where `table` is no table.

    A table is a data frame (anything with `columns`), a mapping of columns, or a structured array.
    """
    if isinstance(table, Mapping):
        return [str(name) for name in table]
    names = getattr(table, "columns", None)
    if names is None:
        names = getattr(getattr(table, "dtype", None), "names", None)
    return None if names is None else [str(name) for name in names]


def of_table(table: Any, name: str, events: Iterable[Any], claims: Any) -> Recording:
    """Return the recording that a table of columns holds. Raises TraceError where it cannot be used."""
    names = column_names(table) or []
    wanted = ["t", *AXES[Sensor.ACCELEROMETER]]
    if not set(wanted) <= set(names):
        found = _by_names(table, names, name)
        if found is not None:
            return checked(found.accelerometer, found.gyroscope, name, events, claims, notes=found.notes)
    if any(axis in names for axis in AXES[Sensor.GYROSCOPE]):
        wanted += AXES[Sensor.GYROSCOPE]
    for column in wanted:
        if column not in names:
            raise TraceError(name, f"no column {column!r}", f"name its columns {', '.join(wanted)}")
    columns = {c: _numbers(table[c], c, name) for c in [*wanted, "temperature", "t_arrival"] if c in names}
    also = (_filled(columns.get("temperature")), _filled(columns.get("t_arrival")))
    parts: dict[Sensor, Samples | None] = {}
    for sensor, axes in AXES.items():
        xyz = np.column_stack([columns[a] for a in axes]) if axes[0] in columns else None
        parts[sensor] = None if xyz is None else _samples(name, sensor, columns["t"], xyz, also)
    accelerometer = parts[Sensor.ACCELEROMETER]
    assert accelerometer is not None, "its columns are among those that must be there"
    return checked(accelerometer, parts[Sensor.GYROSCOPE], name, events, claims)


def _by_names(table: Any, names: list[str], name: str) -> Recording | None:
    """Return what a table of other columns holds by their names, None where they say nothing.

    Raises TraceError where they say what it holds, and it cannot be used.
    """
    columns = {}
    for column in names:
        with suppress(TypeError, ValueError):  # texts, dates
            columns[column] = np.asarray(table[column], dtype=np.float64)
    numbers = in_arrays(Path(name), {k: v for k, v in columns.items() if v.ndim == 1}, 0)
    sensors = settled(numbers, load_map("csv"))
    if not sensors:
        return None
    trace = Trace(Log(Path(name), "table", sensors))
    chunks = list(trace.chunks())
    gyroscope = whole([c.gyroscope for c in chunks]) if trace.has_gyroscope else None
    return Recording(whole([c.accelerometer for c in chunks]), gyroscope, [], Claims(), trace.notes, name)


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
    accelerometer: Samples,
    gyroscope: Samples | None,
    name: str,
    events: Iterable[Any],
    claims: Any,
    *,
    notes: Sequence[str] = (),
) -> Recording:
    """Return a recording whose units have been looked at as those of a file are.

    events: events, or mappings as lines of NAME.events.jsonl hold them. claims: Claims, a mapping as
    NAME.json holds it, or None. Raises TraceError where the units, an event or a claim cannot be right.
    """
    if len(accelerometer) < 2:
        what = f"the recording holds {len(accelerometer)} samples of the accelerometer"
        raise TraceError(name, what, "give a recording of some minutes")
    try:
        ordered_events = sorted(
            (msgspec.convert(e, Event, from_attributes=True) for e in events), key=lambda e: e.t
        )
        maker = Claims() if claims is None else msgspec.convert(claims, Claims, from_attributes=True)
    except msgspec.ValidationError as error:
        raise TraceError(name, f"not an event, or not a claim: {error}", "see docs/formats.md") from None
    recording = Recording(accelerometer, gyroscope, ordered_events, maker, list(notes), name)
    units = UnitCheck(Path(name))
    chunk: Chunk
    for chunk in recording.chunks():
        units.see(chunk.accelerometer, chunk.gyroscope)
    units.finish()
    return recording


def warmed(gyroscope: Samples, accelerometer: Samples) -> Samples:
    """Return the gyroscope's samples with the temperature of the accelerometer's last one, as in a file."""
    if accelerometer.temperature is None or gyroscope.temperature is not None or not len(gyroscope):
        return gyroscope
    last = np.searchsorted(accelerometer.t, gyroscope.t, side="right") - 1
    return replace(gyroscope, temperature=frozen(accelerometer.temperature[np.maximum(last, 0)]))


def _samples(
    name: str, sensor: Sensor, t: Array, xyz: Array, also: tuple[Array | None, Array | None] = (None, None)
) -> Samples:
    """Return the rows in which a sensor has a sample: all but those whose three cells are NaN.

    also: temperatures and times of arrival.
    """
    if xyz.shape != (t.size, 3):
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
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise TraceError(name, f"{column} holds what is not a number", "give numbers, NaN for none") from None


def _filled(column: Array | None) -> Array | None:
    """Return a column with unknown values filled by the one before; None where nothing is known."""
    if column is None or not column.size:
        return None
    return filled_forward(np.where(np.isnan(column), EMPTY, column), np.nan)
