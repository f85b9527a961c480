"""Which format a text table is, by its first lines."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np

from stillcal.calib_core.gravity import STANDARD
from stillcal.replay.formats.columns import (
    TIME_UNITS,
    ColumnMap,
    SensorMap,
    TemperatureMap,
    TimeMap,
    builtin_formats,
    find_columns,
    load_map,
)
from stillcal.replay.formats.recognition.header import (
    DELIMITERS,
    delimiter_of,
    described_place,
    first_row,
    header_place,
    names_in_parts,
    split_as,
    stated_rate,
    unnamed_place,
    with_units,
)
from stillcal.replay.formats.recognition.names.kinds import is_own
from stillcal.replay.formats.recognition.names.stamps import find_thermometer, is_plausible_temperature
from stillcal.replay.formats.recognition.names.units import is_unit
from stillcal.replay.formats.recognition.rewriting.rewritten import rewritten
from stillcal.replay.formats.recognition.unnamed import names_of_rows
from stillcal.replay.formats.sources import Source
from stillcal.replay.formats.tables.text import text_head, uncommented

BETAFLIGHT, GNSS_LOGGER = "betaflight", "gnss_logger"
REST, UNKNOWN = "rest", ""
SENSOR_LOGGER = ("sensorlogger", "sensorlogger_ios")

_HHAR_NAMES = ["Arrival_Time", "Creation_Time", "x", "y", "z"]
_SENSOR_LOGGER_NAMES = {"time", "seconds_elapsed", "x", "y", "z"}
_RESTS_HAVE = {"ax", "ay", "az", "gx", "gy", "gz", "temperature"}
_ONLY_RESTS_HAVE = {"duration", "sax", "say", "saz", "sgx", "sgy", "sgz"}
_TURNED = 1.0
"""m/s^2: by so much the means of two rests differ, at the median; samples of one recording differ by less."""

_ROS2_WIDTH = 40
"""Values of a sensor_msgs/Imu."""

_G_UNTIL = 2.5
"""Median size of acceleration below which it is in g: Sensor Logger on iOS, its default."""


@dataclass(frozen=True, slots=True)
class TextFormat:
    """A recognised text table. name: of its format, "" where it has none; said: what was assumed.

    names: of its columns, where they are more than the header alone says. rate_hz: as the lines before the
    table state it. source: the text in cells, which is what to read.
    """

    name: str
    column_map: ColumnMap
    said: str = ""
    names: list[str] | None = None
    rate_hz: float | None = None
    source: Source | None = None

    @property
    def cut(self) -> ColumnMap:
        """How the table is cut into columns, to which its names, wherever they come from, are the header."""
        return msgspec.structs.replace(
            self.column_map, header=self.column_map.header or self.names is not None
        )


def text_format(source: Source) -> TextFormat:
    """Recognise a text table. Raises TraceError where the file is empty or no text."""
    text = rewritten(source)
    if text.names is not None:
        column_map = msgspec.structs.replace(_counted(","), skip_lines=text.first)
        return TextFormat(UNKNOWN, column_map, text.said, text.names, source=text.source)
    head = text_head(text.source)
    whole = len(head) < (1 << 15) and not source.zipped
    lines = [line.rstrip("\r") for line in head.split("\n")]
    form = _gyroflow(lines) or _of_lines(lines, whole)
    return replace(form, source=text.source, said=form.said or text.said)


def _of_lines(lines: list[str], whole: bool) -> TextFormat:
    """Recognise a table by its first lines. whole: whether these are all."""
    filled = [line for line in lines if line.strip()]
    if _is_gnss_logger(filled):
        return TextFormat(GNSS_LOGGER, load_map("csv"))
    if first_row(filled) == 0 or _hhar_row(filled[0]):
        return _headerless(filled)
    unnamed, described = unnamed_place(lines), described_place(lines)
    if unnamed or described:
        first = unnamed or described
        form = _headerless([line for line in lines[first:] if line.strip()])
        if unnamed or form.names is not None:
            placed = msgspec.structs.replace(form.column_map, skip_lines=first)
            return replace(form, column_map=placed, rate_hz=stated_rate(lines[:first]))
    in_parts = names_in_parts(lines)
    if in_parts is not None:
        place, names = in_parts
        form = _with_header([line for line in lines[place:] if line.strip()], whole=False)
        rows = (first_row(lines) or 0) - place - 1
        placed = msgspec.structs.replace(form.column_map, skip_lines=place, lines_after_header=rows)
        if form.name == UNKNOWN:
            return TextFormat(UNKNOWN, placed, names=names, rate_hz=stated_rate(lines[:place]))
    before, after = header_place(lines)
    filled = [line for line in lines[before:] if line.strip()]
    form = replace(
        _with_header(filled, whole=whole),
        rate_hz=stated_rate(lines[:before]),
    )
    skip = form.column_map.skip_lines + before
    placed = msgspec.structs.replace(form.column_map, skip_lines=skip, lines_after_header=after)
    if form.name not in (UNKNOWN, REST, "csv") or not after:
        return replace(form, column_map=placed)
    row = lines[before + after + 1]
    names, *below = (split_as(row, uncommented(line)) for line in lines[before : before + after + 1])
    fitting = [cells for cells in below if len(cells) == len(names)]
    units = max(fitting, key=lambda cells: sum(is_unit(cell.strip("[]() ")) for cell in cells), default=names)
    told = with_units(names, units) if units != names else None
    name = REST if form.name == REST else UNKNOWN
    return TextFormat(name, placed, names=told, rate_hz=form.rate_hz)


def _gyroflow(lines: list[str]) -> TextFormat | None:
    """Return how a log of Gyroflow is read, by the values of one count that it states; None of another."""
    names = next((i for i, line in enumerate(lines) if line.startswith("t,")), None)
    if names is None or not lines[0].upper().endswith("IMU LOG"):
        return None
    stated = dict(line.split(",", 1) for line in lines[1:names] if "," in line)
    try:
        second, rate, force = (float(stated[key]) for key in ("tscale", "gscale", "ascale"))
    except (KeyError, ValueError):
        return None
    unit: Any = {length: unit for unit, length in TIME_UNITS.items()}.get(second)
    if unit is None or min(rate, force) <= 0:
        return None
    column_map = msgspec.structs.replace(
        load_map("csv"),
        time=TimeMap(column="t", unit=unit),
        accelerometer=SensorMap(
            columns=("ax", "ay", "az"), unit="counts", counts_per_unit=1 / (force * STANDARD)
        ),
        gyroscope=SensorMap(columns=("gx", "gy", "gz"), unit="counts", counts_per_unit=1 / rate),
        skip_lines=names,
    )
    return TextFormat("Gyroflow's log", column_map)


def _with_header(lines: list[str], *, whole: bool) -> TextFormat:
    header = uncommented(lines[0])
    marks = [mark for mark in DELIMITERS if mark in header]
    delimiter = max(marks, key=header.count) if marks else " "
    names = [n.strip().strip('"').strip() for n in _split(header, delimiter)]
    if set(_HHAR_NAMES) <= set(names):
        hhar = load_map("hhar")
        first = names.index("Index") if "Index" in names else None
        return TextFormat("hhar", hhar if first is None else msgspec.structs.replace(hhar, skip_lines=1))
    if names[:1] == ["time"] and set(names) >= _SENSOR_LOGGER_NAMES:
        return _sensor_logger(names, lines[1:])
    if names[:1] == ["loopIteration"]:
        return TextFormat(BETAFLIGHT, _cut_as(load_map("csv"), delimiter))
    if _is_rest_table(names, [_split(line, delimiter) for line in lines[1:]], whole=whole):
        return TextFormat(REST, _cut_as(load_map("csv"), delimiter))
    for name in sorted(builtin_formats(), key=lambda n: n != "csv"):
        column_map = load_map(name)
        fits = column_map.header and find_columns(_needed(column_map), names, len(names)) is not None
        if fits and name not in SENSOR_LOGGER and (name != "csv" or is_own(names)):
            rows = [_split(line, delimiter) for line in lines[1:]]
            inside = _with_rates_inside(_cut_as(column_map, delimiter), names)
            return TextFormat(name, _with_thermometer_inside(inside, names, rows))
    return TextFormat(UNKNOWN, _cut_as(load_map("csv"), delimiter))


def _is_rest_table(names: list[str], rows: list[list[str]], *, whole: bool) -> bool:
    """Whether a table has columns that only rest tables have, or a new attitude in each of its rows.

    whole: whether these are all rows. Without a count of samples, a column of time is a recording's.
    """
    if not {"ax", "ay", "az"} <= set(names):
        return False
    if set(names) & _ONLY_RESTS_HAVE:
        return True
    may_have = _RESTS_HAVE | ({"n", "t"} if "n" in names else set())
    if not whole or not set(names) <= may_have:
        return False
    places = [names.index(axis) for axis in ("ax", "ay", "az")]
    cells = [[row[p] for p in places] for row in rows if len(row) == len(names)]
    means = np.array([row for row in cells if _numbers_in(row)], dtype=np.float64).reshape(-1, 3)
    if cells and not len(means):
        return False
    means = means[np.isfinite(means).all(axis=1)]  # the reader names the row of one that is not
    steps = np.linalg.norm(np.diff(means, axis=0), axis=1)
    return steps.size == 0 or float(np.median(steps)) > _TURNED


def _needed(column_map: ColumnMap) -> list[str | int]:
    time = [] if column_map.time.column is None else [column_map.time.column]
    gyroscope = column_map.gyroscope
    rates = [] if gyroscope is None or gyroscope.optional or gyroscope.other_file else gyroscope.columns
    return [*time, *column_map.accelerometer.columns, *rates]


def _with_rates_inside(column_map: ColumnMap, names: list[str]) -> ColumnMap:
    """Return the map for a table that holds the gyroscope's columns itself where they are among its names."""
    gyroscope = column_map.gyroscope
    if gyroscope is None or find_columns(gyroscope.columns, names, len(names)) is None:
        return column_map
    return msgspec.structs.replace(column_map, gyroscope=msgspec.structs.replace(gyroscope, other_file=()))


def _with_thermometer_inside(column_map: ColumnMap, names: list[str], rows: list[list[str]]) -> ColumnMap:
    """Return the map for a table that has a thermometer's column, though its format knows none.

    It counts where its first rows are temperatures that a sensor can have.
    """
    thermometer = None if column_map.temperature is not None else find_thermometer(names, "")
    if thermometer is None or names.count(thermometer[0]) != 1:
        return column_map
    place = names.index(thermometer[0])
    cells = [row[place].strip().replace(",", ".") for row in rows if len(row) == len(names)]
    values = np.array([float(cell) for cell in cells if cell and _numbers_in([cell])])
    if not is_plausible_temperature(values, thermometer[1]):
        return column_map
    return msgspec.structs.replace(
        column_map, temperature=TemperatureMap(column=thermometer[0], unit=thermometer[1])
    )


def _cut_as(column_map: ColumnMap, delimiter: str) -> ColumnMap:
    """Return the map for a table whose cells are split by `delimiter`."""
    if column_map.delimiter in (delimiter, "auto"):
        return column_map
    if delimiter == " ":
        return msgspec.structs.replace(column_map, delimiter="space")
    return msgspec.structs.replace(column_map, delimiter=delimiter, decimal="auto")


def _sensor_logger(names: list[str], rows: list[str]) -> TextFormat:
    """Tell Sensor Logger's two layouts apart by the size of gravity."""
    places = [names.index(axis) for axis in ("x", "y", "z")]
    norms = []
    for row in rows[:200]:
        cells = row.split(",")
        if len(cells) == len(names) and _numbers_in([cells[p] for p in places]):
            norms.append(float(np.linalg.norm([float(cells[p]) for p in places])))
    in_g = bool(norms) and float(np.median(norms)) < _G_UNTIL
    name = SENSOR_LOGGER[in_g]
    return TextFormat(name, load_map(name))


def _headerless(lines: list[str]) -> TextFormat:
    """Recognise a table without a header by the count and the size of its cells."""
    delimiter = delimiter_of(lines[0])
    if _hhar_row(lines[0]):
        return TextFormat("hhar", load_map("hhar"))
    rows = [_split(line, delimiter) for line in lines[:200]]
    width = len(rows[0])
    if rows[0] == [str(place) for place in range(width)]:  # as pandas calls columns without names
        return TextFormat(UNKNOWN, msgspec.structs.replace(_counted(delimiter), skip_lines=1))
    for name, fits in (("empatica", _is_empatica), ("ros2_csv", _is_ros2)):
        if fits(rows):
            return TextFormat(name, load_map(name))
    usable = [[float(c) for c in row] for row in rows if len(row) == width and _numbers_in(row)]
    values = np.array(usable)
    blanks = delimiter == " " and len(usable) > 0
    if blanks and width == 4 and np.median(np.abs(values[:, 1:])) > 1000:
        return TextFormat("imu_tk", load_map("imu_tk"))
    if blanks and width == 6 and 4 < np.median(np.linalg.norm(values[:, :3], axis=1)) < 16:
        return TextFormat(
            "mikoff", load_map("mikoff"), "no time stamps: 100 Hz is taken, as mikoff's logs have"
        )
    return TextFormat(UNKNOWN, _counted(delimiter), names=names_of_rows(rows))


def _is_empatica(rows: list[list[str]]) -> bool:
    """Whether a table of three columns begins with a time since 1970 and with 32 Hz, the same in each."""
    if len(rows) < 3 or any(len(row) != 3 or not _numbers_in(row) for row in rows[:3]):
        return False
    start, rate = ({float(cell) for cell in row} for row in rows[:2])
    return len(start) == 1 and start.pop() > 1e9 and rate == {32.0}


def _is_ros2(rows: list[list[str]]) -> bool:
    """Whether a row has the values of sensor_msgs/Imu, numbers but for the name of its frame."""
    first, frame = rows[0][:2] + rows[0][3:], rows[0][2:3]
    return len(rows[0]) == _ROS2_WIDTH and _numbers_in(first) and not _numbers_in(frame)


def _counted(delimiter: str) -> ColumnMap:
    """Return how a table without a header is cut into columns, which are then counted."""
    base = ColumnMap(
        time=TimeMap(column=0, unit="auto"),
        accelerometer=SensorMap(columns=(0, 1, 2), unit="m/s^2"),
        header=False,
    )
    return _cut_as(base, delimiter)


def _hhar_row(line: str) -> bool:
    """Whether a line is of HHAR: an index, two times, three numbers, and four words."""
    cells = line.split(",")
    return len(cells) == 10 and _numbers_in(cells[:6]) and not any(_numbers_in([c]) for c in cells[6:])


def _is_gnss_logger(lines: list[str]) -> bool:
    return any(line.startswith(("# UncalAccel,", "UncalAccel,", "# Accel,utcTime")) for line in lines)


def _split(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else line.split(delimiter)


def _numbers_in(cells: list[str]) -> bool:
    try:
        return bool([float(cell) for cell in cells])
    except ValueError:
        return False
