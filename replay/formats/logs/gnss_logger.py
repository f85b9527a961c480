"""Google's GnssLogger (google/gps-measurement-tools): rows of many kinds in one text file.

The first cell says the kind. `UncalAccel` and `UncalGyro` rows hold raw values and, after them, the bias that
Android has estimated; `Accel` and `Gyro` rows hold what Android has corrected. The header names the units.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.columns import ColumnMap, SensorMap, TimeMap
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.log import Log, LoggedSensor, Part
from stillcal.replay.formats.sources import UNREADABLE, Source, damaged, unpacked
from stillcal.replay.formats.tables.cells import read_numbers
from stillcal.replay.formats.tables.numbers import NumberTable

_NAMES = ["utc", "elapsed", "x", "y", "z", "bias_x", "bias_y", "bias_z"]
_PIECE = 1 << 20
_LONGEST_LINE = 1 << 16
_PAIRS = {"uncalibrated": ("UncalAccel", "UncalGyro"), "calibrated": ("Accel", "Gyro")}


@dataclass(frozen=True, slots=True)
class _Rows:
    """The rows of one kind."""

    source: Source
    kind: str

    def __call__(self, places: Sequence[int]) -> Iterator[tuple[Array, float]]:
        """Yield the columns at `places`, and the share of the file read. Raises TraceError."""
        start = self.kind.encode() + b","
        line = 0
        for lines, share in self._pieces():
            own = [(line + i + 1, row[len(start) :]) for i, row in enumerate(lines) if row.startswith(start)]
            line += len(lines)
            if own:
                yield self._numbers(own)[:, list(places)], share

    def _pieces(self) -> Iterator[tuple[list[bytes], float]]:
        """Yield whole lines, and the share of the file read; a last line without its end is left out."""
        tail = b""
        try:
            with self.source.open() as file:
                stream = unpacked(file)
                while piece := stream.read(_PIECE):
                    *lines, tail = (tail + piece).split(b"\n")
                    if len(tail) > _LONGEST_LINE:
                        raise TraceError(self.source.path, "a line does not end", "copy the log again")
                    yield lines, min(1.0, file.tell() / max(self.source.size, 1))
        except UNREADABLE as error:
            raise damaged(self.source.path, error) from None

    def _numbers(self, rows: list[tuple[int, bytes]]) -> Array:
        """Return rows as (n, 8), NaN where a log has no bias. Raises TraceError naming a faulty line."""
        cells = [row.rstrip(b"\r").split(b",") for _, row in rows]
        values = np.full((len(rows), len(_NAMES)), np.nan)
        width = min(len(cells[0]), len(_NAMES))
        even = all(len(row) == len(cells[0]) for row in cells) and width >= 5
        numbers = read_numbers(b",".join(c or b"nan" for row in cells for c in row[:width])) if even else None
        if numbers is None:
            raise self._accused(rows, cells)
        values[:, :width] = numbers.reshape(len(rows), width)
        return values

    def _accused(self, rows: list[tuple[int, bytes]], cells: list[list[bytes]]) -> TraceError:
        for (line, _), row in zip(rows, cells, strict=True):
            if len(row) != len(cells[0]) or len(row) < 5 or read_numbers(b",".join(row[:5])) is None:
                what = f"the {self.kind} row is not like the first"
                return TraceError(self.source.path, what, "correct or delete that row", line)
        return TraceError(self.source.path, f"the {self.kind} rows hold no numbers", "record the log again")


def open_gnss_logger(source: Source) -> Log:
    """Open a GnssLogger text file. Raises TraceError where it has no rows of an accelerometer."""
    sensors, notes = [], []
    for name, kinds in _PAIRS.items():
        parts = []
        for sensor, kind in zip((Sensor.ACCELEROMETER, Sensor.GYROSCOPE), kinds, strict=True):
            rows = _Rows(source, kind)
            first = next(rows(range(len(_NAMES))), None)
            if first is not None:
                parts.append(
                    Part(NumberTable(source.path, _NAMES, rows, source.size), _map(sensor), [sensor])
                )
                notes += [f"{short_name(source.path)}: {line}" for line in _bias(sensor, first[0])]
        if parts and parts[0].sensors == [Sensor.ACCELEROMETER]:
            sensors.append(LoggedSensor.of(name, parts, ", ".join(kinds[: len(parts)])))
    if not sensors:
        what = "this GnssLogger file has no rows UncalAccel or Accel"
        raise TraceError(source.path, what, "switch the sensors on in GnssLogger's settings")
    return Log(source.path, "GnssLogger", sensors, notes, source.local)


def _bias(sensor: Sensor, rows: Array) -> Iterator[str]:
    """Say the bias that the phone's own system estimated."""
    bias = np.median(rows[:, 5:], axis=0)
    if np.isfinite(bias).all() and bias.any():
        unit = "rad/s" if sensor is Sensor.GYROSCOPE else "m/s^2"
        values = " ".join(f"{b:.5g}" for b in bias)
        yield f"the phone's own {sensor} bias is {values} {unit}; raw values are read"


def _map(sensor: Sensor) -> ColumnMap:
    axes = ("x", "y", "z")
    rate = SensorMap(columns=axes, unit="rad/s") if sensor is Sensor.GYROSCOPE else None
    force = SensorMap(columns=axes, unit="m/s^2")
    time = TimeMap(column="elapsed", unit="ns")
    return ColumnMap(time=time, accelerometer=force, gyroscope=rate, reorder=64, repeats="keep")
