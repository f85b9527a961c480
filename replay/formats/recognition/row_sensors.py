"""Tables that hold one row for each sensor and time: `sensor,timestamp,x,y,z`, in any order of columns.

The column that names the sensor is known by what it holds: with its text, the axes' names are those of an
accelerometer or a gyroscope, as `accelerometer.x` is. Numbers in it may be Android's types of sensors.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.columns import ColumnMap
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.log import GyroscopeAloneError, LoggedSensor
from stillcal.replay.formats.recognition.names.axes import find_axes
from stillcal.replay.formats.recognition.names.containers import name_sensors, qualified
from stillcal.replay.formats.recognition.names.kinds import rates_alone
from stillcal.replay.formats.recognition.names.words import spaced, split_words
from stillcal.replay.formats.recognition.settle import OneSensor, settled_apart
from stillcal.replay.formats.tables.cells import is_number
from stillcal.replay.formats.tables.chosen import ChosenRows, TableWithTexts
from stillcal.replay.formats.tables.dates import is_date

_RARELY = 0.2
"""Share of rows at which a text changes, and share of rows that have a text of their own, at most, where rows
are of one device, and where a text is a device's name."""


_ANDROID = {
    1: "accelerometer",
    2: "magnetic_field",
    3: "orientation",
    4: "gyroscope",
    5: "light",
    6: "pressure",
    7: "temperature",
    8: "proximity",
    9: "gravity",
    10: "linear_acceleration",
    11: "rotation_vector",
    12: "relative_humidity",
    13: "ambient_temperature",
    14: "magnetic_field_uncalibrated",
    15: "game_rotation_vector",
    16: "gyroscope_uncalibrated",
    17: "significant_motion",
    18: "step_detector",
    19: "step_counter",
    20: "geomagnetic_rotation_vector",
    21: "heart_rate",
    35: "accelerometer_uncalibrated",
}
"""Types of sensors by their numbers: TYPE_ACCELEROMETER = 1 and so on in Android's source,
frameworks/base/core/java/android/hardware/Sensor.java."""

_FORCE_TYPES, _RATE_TYPES, _RAW_TYPES = {1, 35}, {4, 16}, {16, 35}


def sensors_of_rows(
    opened: Callable[[], TableWithTexts], column_map: ColumnMap, rate_hz: float | None = None
) -> list[LoggedSensor]:
    """Return the sensors of a table with a row for each; none where it is no such table.

    opened: opens the table, once for each sensor. column_map: how it is cut into columns. rate_hz: of each
    sensor, as the file states it. Raises TraceError where the sensors' rows cannot be read.
    """
    table = opened()
    place, called = _naming(table)
    if place is not None or table.names is None or find_axes(table.names):
        refuse_devices_in_turn(table, place)
    if place is None:
        return []
    names = {text: qualified(table.names or [], spaced(word)) for text, word in called.items()}
    of_sensors = [text for text in called if find_axes(names[text])]
    if all(rates_alone(names[text]) for text in of_sensors):
        raise GyroscopeAloneError(table.path)
    apart = [
        OneSensor(ChosenRows(opened(), place, text, names[text]), column_map, rate_hz) for text in of_sensors
    ]
    read = [called[text] for text in of_sensors]
    others = sorted({word.strip() for word in called.values()} - {word.strip() for word in read})
    said = (
        f"{short_name(table.path)}: a row for each sensor, by {table.column_name(place)}: {', '.join(read)}"
    )
    said += f"; passed over: {', '.join(others)}" if others else ""
    return [replace(sensor, notes=(said, *sensor.notes)) for sensor in settled_apart(apart)]


def _naming(table: TableWithTexts) -> tuple[int | None, dict[str, str]]:
    """Return the place of the column that names the sensors, and what each of its texts calls one.

    None where there is no such column. Raises TraceError where numbers may be types of sensors, or not.
    """
    names = table.names or []
    if find_axes(names) or len(names) != len(table.first_row):
        return None, {}
    for place, cell in enumerate(table.first_row):
        if _is_value(cell):
            continue
        texts = [text for text in table.texts(place) or [] if text != names[place]]  # of a repeated header
        if name_sensors(texts, names):
            return place, {text: text for text in texts}
    return _naming_by_types(table, names)


def _naming_by_types(table: TableWithTexts, names: Sequence[str]) -> tuple[int | None, dict[str, str]]:
    """Return what _naming does for a column of Android's types of sensors, which change from row to row.

    Raises TraceError where the column is not called a type, and its numbers may mean something else.
    """
    with_axes = qualified(names, _ANDROID[1])
    rows = [row for row in table.opening if len(row) == len(names)]
    for place, column in enumerate(zip(*rows, strict=True)):
        changes = sum(a != b for a, b in itertools.pairwise(column))
        if with_axes == list(names) or with_axes[place] != names[place] or changes <= len(column) * _RARELY:
            continue
        types = (
            None if None in map(_type, column) else {text: _type(text) for text in table.texts(place) or ()}
        )
        found = set((types or {}).values())
        if types is None or None in found or not (found & _FORCE_TYPES and found & _RATE_TYPES):
            continue
        if "type" not in split_words(names[place]) and not found >= _RAW_TYPES:
            listed = ", ".join(types)
            what = (
                f"{table.column_name(place)} may hold Android's types of sensors, or something else: {listed}"
            )
            remedy = 'if it does, call it sensor_type; else write "accelerometer" and "gyroscope" in it'
            raise TraceError(table.path, what, remedy, table.header_line)
        return place, {text: _ANDROID[kind] for text, kind in types.items() if kind is not None}
    return None, {}


def _type(text: str) -> int | None:
    """Return the number of one of Android's types of sensors, None of other texts."""
    number = text.strip()
    return int(number) if number.isdecimal() and int(number) in _ANDROID else None


def refuse_devices_in_turn(table: TableWithTexts, naming: int | None = None) -> None:
    """Raise TraceError where the rows are of several devices in turn, which would be read as one.

    A text that changes from row to row says so; what a person does lasts for many rows. naming: the place of
    the column by which the sensors are told apart: only the rows of the first one are looked at.
    """
    rows = [row for row in table.opening if len(row) == table.width]
    own = rows if naming is None else [row for row in rows if row[naming] == rows[0][naming]]
    for place, column in enumerate(zip(*own, strict=True)):
        texts = set(column)
        if place == naming or not 2 <= len(texts) <= len(column) * _RARELY or any(map(_is_value, texts)):
            continue
        changes = sum(a != b for a, b in itertools.pairwise(column))
        if changes > len(column) * _RARELY:
            listed = ", ".join(sorted(texts)[:8])
            what = f"rows of several devices in turn, by {table.column_name(place)}: {listed}"
            remedy = "give the rows of one, or choose them in a column map ([select], docs/formats.md)"
            raise TraceError(table.path, what, remedy, table.header_line)


def _is_value(text: str) -> bool:
    cell = text.strip().encode()
    return is_number(cell.replace(b",", b".")) or is_date(cell) or cell.lower() in (b"true", b"false")
