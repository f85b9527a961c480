"""Betaflight's and INAV's blackbox log as CSV, by blackbox_decode or by the Blackbox Explorer.

The firmware logs counts: gyroADC in deg/s, tenths of that with blackbox_high_resolution (betaflight,
blackbox.c), accSmooth in 1/acc_1G of g. The Explorer writes these facts before the table, blackbox_decode
with --save-headers into NAME.headers.csv. There `gyro_scale` is deg/s in one count, a float's bits in hex,
and `gyroScale` is rad/us (blackbox-tools, parser.c; blackbox-log-viewer, flightlog_parser.js). Asked for
units, blackbox_decode names them behind the columns and writes two decimals (blackbox_decode.c, units.h).
"""

from __future__ import annotations

import csv
import math
import struct
from collections.abc import Sequence
from pathlib import Path

import msgspec

from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.columns import ColumnMap, SensorMap, TimeMap
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.log import Log, LoggedSensor, Part
from stillcal.replay.formats.sources import Source, source_of
from stillcal.replay.formats.tables.text import TextTable, text_head

_DEGREE = 0.017453292519943295
_UNITS = {"(g)": "g", "(m/s/s)": "m/s^2", "(deg/s)": "deg/s", "(rad/s)": "rad/s"}
_REMEDY = "decode it with --save-headers, or with --unit-acceleration m/s2 --unit-rotation deg/s"


def open_betaflight(source: Source, base: ColumnMap) -> Log:
    """Open a decoded log; base: where its header is, and what separates cells. Raises TraceError."""
    table = TextTable(source, base)
    names = table.names or []
    time = next((name for name in names if name.partition(" ")[0] == "time"), None)
    force, rates = _axes(names, "accSmooth"), _axes(names, "gyroADC")
    if time is None or force is None:
        what = "this Betaflight log has no columns accSmooth[0] to [2]" if time else "it has no column time"
        raise TraceError(source.path, what, "log with the accelerometer switched on")
    facts = _facts(source, base.skip_lines)
    unit = {"(s)": "s", "(ms)": "ms"}.get(time.partition(" ")[2], "us")
    column_map = msgspec.structs.replace(
        base,
        time=TimeMap(column=time, unit=unit),  # type: ignore[arg-type]
        accelerometer=_sensor_map(source.path, Sensor.ACCELEROMETER, force, facts),
        gyroscope=None if rates is None else _sensor_map(source.path, Sensor.GYROSCOPE, rates, facts),
        temperature=None,
    )
    notes = ["the firmware filters gyroADC and takes its own offsets off both sensors"]
    if any(unit in name for name in force for unit in _UNITS):
        notes.append("accSmooth has two decimals; blackbox_decode --save-headers keeps its counts")
    sensors = [Sensor.ACCELEROMETER] + ([] if rates is None else [Sensor.GYROSCOPE])
    logged = LoggedSensor.of("imu", [Part(table, column_map, sensors)], " and ".join(sensors))
    said = [f"{short_name(source.path)}: {note}" for note in notes]
    return Log(source.path, "Betaflight CSV", [logged], said, source.local)


def _axes(names: Sequence[str], field: str) -> tuple[str, str, str] | None:
    """Return the names of a field's three columns, which may end in a unit."""
    found = [next((n for n in names if n.partition(" ")[0] == f"{field}[{i}]"), None) for i in range(3)]
    x, y, z = found
    return None if x is None or y is None or z is None else (x, y, z)


def _sensor_map(
    path: Path, sensor: Sensor, columns: tuple[str, str, str], facts: dict[str, str]
) -> SensorMap:
    """Return where a sensor is and in which unit. Raises TraceError where the unit is not known."""
    stated = columns[0].partition(" ")[2]
    if stated in _UNITS:
        return SensorMap(columns=columns, unit=_UNITS[stated])  # type: ignore[arg-type]
    one = _count(facts, sensor)
    if one is None:
        what = (
            f"{columns[0]} is in counts, and what one is stands neither here nor in {path.stem}.headers.csv"
        )
        raise TraceError(path, what, _REMEDY)
    return SensorMap(columns=columns, unit="counts", counts_per_unit=1.0 / one)


def _count(facts: dict[str, str], sensor: Sensor) -> float | None:
    """Return the SI value of one count, None where the facts do not tell a size."""
    try:
        one = STANDARD / float(facts["acc_1G"]) if sensor is Sensor.ACCELEROMETER else _rate(facts)
        return one if 0.0 < 1.0 / one < math.inf else None
    except (KeyError, ValueError, OverflowError, ZeroDivisionError):
        return None


def _rate(facts: dict[str, str]) -> float:
    """Return one count of the gyroscope, rad/s. Raises KeyError, ValueError, OverflowError."""
    fine = 10.0 if float(facts.get("blackbox_high_resolution") or 0) else 1.0
    if "gyroScale" in facts:
        return float(facts["gyroScale"]) * 1e6 / fine
    scale = facts["gyro_scale"]
    (degrees,) = struct.unpack(">f", int(scale, 16).to_bytes(4, "big")) if "x" in scale else [float(scale)]
    return float(degrees) * _DEGREE / fine


def _facts(source: Source, lines_before: int) -> dict[str, str]:
    """Return what stands before the table, or beside it, as names and values."""
    lines = text_head(source).split("\n")[:lines_before]
    beside = None if source.local is None else source.local.with_name(f"{source.local.stem}.headers.csv")
    if not lines and beside is not None and beside.is_file():
        lines = text_head(source_of(beside)).split("\n")
    pairs = csv.reader(line.replace("\r", "") for line in lines)
    return {row[0].strip(): row[1].strip() for row in pairs if len(row) > 1}
