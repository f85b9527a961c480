"""A text table, or an accelerometer's and a gyroscope's, read through a known column map."""

from __future__ import annotations

from pathlib import Path

from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.log import Log, LoggedSensor
from stillcal.replay.formats.recognition.text_formats import (
    TextFormat,
)
from stillcal.replay.formats.sources import Source, source_of
from stillcal.replay.formats.stream import SampleFile
from stillcal.replay.formats.tables.text import TextTable, has_rows


def by_map(source: Source, form: TextFormat, gyro: Source | None, notes: list[str]) -> Log:
    """Return the log of one text table, or two, read through a known map."""
    path, column_map = source.path, form.column_map
    both = [Sensor.ACCELEROMETER] + ([Sensor.GYROSCOPE] if column_map.gyroscope else [])
    rules = column_map.gyroscope.other_file if column_map.gyroscope else ()
    if gyro is not None and column_map.gyroscope is None:
        raise TraceError(gyro.path, "the format has no gyroscope", "say its columns in a column map")
    beside = other_file(path, rules) if source.local == path and gyro is None else None
    other = gyro or (None if beside is None else source_of(beside))
    if other is not None and gyro is None and not has_rows(other):
        notes = [*notes, f"{short_name(other.path)}: holds a header and no samples; read without a gyroscope"]
        other, rules = None, ()
    if gyro is None and other is None:
        _refuse_gyroscope_file(source, rules)
    if gyro is None and rules and other is None:
        notes = [*notes, f"{short_name(path)}: no gyroscope file beside it (name it with --gyro)"]

    def files(claims: Claims) -> list[SampleFile]:
        sensors = both if gyro is None and not rules else [Sensor.ACCELEROMETER]
        first = SampleFile(TextTable(source, column_map), column_map, sensors, claims)
        if other is None:
            return [first]
        second = TextTable(other, column_map)
        return [first, SampleFile(second, column_map, [Sensor.GYROSCOPE], claims, first.selected)]

    return Log(path, form.name or "text table", [LoggedSensor("imu", files)], notes, beside=source.local)


def _refuse_gyroscope_file(source: Source, rules: tuple[tuple[str, str], ...]) -> None:
    """Raise TraceError where the file is the gyroscope's one of a pair, and the other lies beside it."""
    back = tuple((replacement, part) for part, replacement in rules)
    first = other_file(source.path, back) if source.local == source.path else None
    if first is not None:
        raise TraceError(source.path, "is the gyroscope's file of a pair", f"give {first.name}")


def other_file(path: Path, rules: tuple[tuple[str, str], ...]) -> Path | None:
    """Return the file beside `path` whose name the first fitting rule gives, None where there is none."""
    for part, replacement in rules:
        candidate = path.with_name(path.name.replace(part, replacement))
        if part in path.name and candidate.is_file():
            return candidate
    return None
