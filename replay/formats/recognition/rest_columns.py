"""Which columns of a rest table hold which quantity, and in which unit, by how people name them.

Its own names `ax ay az`, `gx gy gz`, `sax say saz`, `sgx sgy sgz`, `t duration n temperature` come first.
Others are found as in a recording (names.py). A unit that a name does not say is SI, or of a standard
deviation that of the mean.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.formats.columns import LONG_TIME_UNITS, TIME_UNITS, SensorMap, TemperatureMap
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.names.axes import find_axes
from stillcal.replay.formats.recognition.names.stamps import find_stamps, find_thermometer
from stillcal.replay.formats.recognition.names.units import KNOWN_UNITS

FORCE, RATE = ("ax", "ay", "az"), ("gx", "gy", "gz")
FORCE_SCATTER, RATE_SCATTER = ("sax", "say", "saz"), ("sgx", "sgy", "sgz")
_SI = {Sensor.ACCELEROMETER: "m/s^2", Sensor.GYROSCOPE: "rad/s"}
_SCATTER_WORD = re.compile(
    r"(?:^|[_. ]+)(?:sd|std|stdev|stddev|sigma)(?=[_. \[(]|$)|^s(?=[ag][xyz]\b)", re.IGNORECASE
)
_DURATION = re.compile(r"^(?:duration|dauer|length)(?=[_. \[(]|$)", re.IGNORECASE)
_COUNT = re.compile(r"^(?:n|samples|n_samples|count)(?=[ \[(]|$)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class RestColumn:
    """A column of a rest table. quantity: its own name; SI = factor * value + offset.

    stated: the unit that the name says, None where it says none.
    """

    name: str
    quantity: str
    factor: float = 1.0
    offset: float = 0.0
    stated: str | None = None


def rest_columns(names: Sequence[str], path: Path) -> list[RestColumn]:
    """Return the columns that a rest table is read from. Raises TraceError where a unit is not known."""
    scatter = {_SCATTER_WORD.sub("", name).strip("_. "): name for name in names if _SCATTER_WORD.search(name)}
    means = [name for name in names if name not in scatter.values()]
    found = []
    for sensor, own, scattered in (
        (Sensor.ACCELEROMETER, FORCE, FORCE_SCATTER),
        (Sensor.GYROSCOPE, RATE, RATE_SCATTER),
    ):
        mean = list(_three(means, sensor, own, path, _SI[sensor]))
        unit = (mean[0].stated if mean else None) or _SI[sensor]
        found += mean
        found += [
            replace(one, name=scatter[one.name], quantity=quantity, offset=0.0)
            for one, quantity in zip(_three(list(scatter), sensor, own, path, unit), scattered, strict=False)
        ]
    return [*found, *_single(means)]


def _three(
    names: Sequence[str], sensor: Sensor, own: Sequence[str], path: Path, usual: str
) -> Iterator[RestColumn]:
    """Yield the axes of a sensor, in the unit that their names say, else the usual one. Raises TraceError."""
    axes = [a for a in find_axes(names) if a.sensor is sensor]
    if not axes:
        return
    chosen = next((a for a in axes if a.columns == tuple(own)), axes[0])
    unit = chosen.unit or usual
    if unit not in KNOWN_UNITS:
        what = f"the unit {unit!r} of {', '.join(map(str, chosen.columns))} is not known"
        raise TraceError(path, what, f"give {_SI[sensor]}")
    factor = SensorMap(columns=chosen.columns, unit=unit).si_per_unit  # type: ignore[arg-type]
    for quantity, column in zip(own, chosen.columns, strict=True):
        yield RestColumn(str(column), quantity, factor, 0.0, chosen.unit)


def _single(names: Sequence[str]) -> Iterator[RestColumn]:
    """Yield the columns of time, duration, number of samples and temperature."""
    seconds = TIME_UNITS | LONG_TIME_UNITS
    lengths = {_DURATION.sub("time", name): name for name in names if _DURATION.search(name)}
    times = {name: name for name in names if name not in lengths.values()}
    for quantity, candidates in (("t", times), ("duration", lengths)):
        stamps = find_stamps(list(candidates))
        own = next((s for s in stamps if s.column == "t"), stamps[0] if stamps else None)
        if own is not None:
            factor = seconds[own.unit or "s"]
            yield RestColumn(candidates[str(own.column)], quantity, factor, 0.0, own.unit)
    yield from [RestColumn(name, "n") for name in names if _COUNT.match(name.strip())][:1]
    thermometer = find_thermometer([name for name in names if name == "temperature"] or names, "")
    if thermometer is not None:
        factor, offset = TemperatureMap(column=thermometer[0], unit=thermometer[1]).celsius
        yield RestColumn(thermometer[0], "temperature", factor, offset, thermometer[1])
