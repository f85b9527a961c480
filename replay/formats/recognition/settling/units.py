"""The units of a table's columns: of acceleration by the size of gravity, of rates by how gravity turns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.checks.axes import Turning, turnings
from stillcal.replay.formats.checks.units import DEGREE, shown_unit
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.columns import SensorMap
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.log import Part
from stillcal.replay.formats.recognition.names.axes import Axes
from stillcal.replay.formats.recognition.names.units import KNOWN_UNITS
from stillcal.replay.formats.recognition.settling.counts import EXPLAINED, counts_per_degree, counts_per_g
from stillcal.replay.formats.recognition.settling.probe import PROBED_ROWS, Probe
from stillcal.replay.formats.stream import SampleFile
from stillcal.replay.formats.tables.table import Table

_GRAVITY_IN = {"m/s^2": (4.0, 16.0), "g": (0.4, 1.6), "mg": (400.0, 1600.0)}
"""Sizes of the median acceleration for each unit: gravity, with room for bias, scale and motion."""

_LIKE_GRAVITY = 0.05
"""Share by which the median acceleration of a phone that rests now and then differs from gravity at most."""

_THOUSANDTHS = {"mrad/s": 1e-3, "mdeg/s": 1e-3 * DEGREE}
"""Smaller units of rates, in rad/s (MAVLink: SCALED_IMU; drivers for ST's chips)."""

_FASTEST_RAD_S = 70.0
"""rad/s: 4000 deg/s, the widest range of consumer gyroscopes (Bosch BMI270 and its like measure 2000)."""


@dataclass(frozen=True, slots=True)
class Unit:
    """The unit of a sensor's columns. said: where it comes from; counts_per_unit: in one SI unit."""

    name: Any
    said: str = ""
    counts_per_unit: float | None = None

    def of(self, axes: Axes) -> SensorMap:
        """Return how the columns of a sensor are read."""
        return SensorMap(
            columns=axes.columns,
            unit=self.name,
            signs=(axes.sign, axes.sign, axes.sign),
            counts_per_unit=self.counts_per_unit,
            gravity=axes.gravity,
        )


def unit_of_force(path: Path, probe: Probe, axes: Axes) -> Unit:
    """Return the unit of acceleration. Raises TraceError without gravity."""
    if axes.unit is not None:
        return Unit(_known(path, axes))
    unit = _by_gravity(probe, axes)
    if unit is not None and not probe.keeps_its_direction(axes):
        what = f"{axes.listed()} swing about zero: gravity was taken out"
        raise TraceError(path, what, "give the accelerometer with gravity")
    if unit is not None:
        return unit
    norms = probe.norms(axes)
    typical = float(np.median(norms)) if norms.size else 0.0
    what = f"{axes.listed()} are about {typical:.4g} in size, which is gravity in no unit"
    remedy = "give the accelerometer with gravity; of raw counts say the value of one in a column map"
    raise TraceError(path, what, remedy)


def _known(path: Path, axes: Axes) -> str | None:
    """Return the unit that names state. Raises TraceError where it is none that is known."""
    if axes.unit in KNOWN_UNITS:
        return axes.unit
    what = f"{axes.listed()} are in {axes.unit}, which is no unit that is known"
    remedy = (
        'say in a column map how many make one SI unit: unit = "counts", counts_per_unit (docs/formats.md)'
    )
    raise TraceError(path, what, remedy)


def measures_gravity(table: Table, axes: Axes) -> bool:
    """Whether columns of an unknown kind are an accelerometer's: of gravity's size, as positions rarely are.

    Rows of several sensors in turn are not: many are smaller or larger by far. Raises TraceError where they
    hold no numbers.
    """
    norms = Probe(table).norms(axes)
    low, typical, high = np.quantile(norms, (0.1, 0.5, 0.9)) if norms.size else (0.0, 0.0, 0.0)
    like = any(abs(typical / one - 1) < _LIKE_GRAVITY for one in (STANDARD, 1.0, 1000.0))
    return bool(like and low > typical / 2 and high < 2 * typical)


def is_gravity(probe: Probe, axes: Axes) -> bool:
    """Whether columns have the size of gravity in a unit, or in a known chip's counts."""
    return _by_gravity(probe, axes) is not None


def _by_gravity(probe: Probe, axes: Axes) -> Unit | None:
    """Return the unit, or a known chip's counts, in which columns have the size of gravity; None for none."""
    norms, whole = probe.norms(axes), probe.whole_numbers(axes)
    typical = float(np.median(norms)) if norms.size else 0.0
    for unit, (low, high) in _GRAVITY_IN.items():
        if low < typical < high:
            counts = "; whole numbers: if they are raw counts, say the value of one in a column map"
            return Unit(unit, f" (by the size of gravity{counts if unit == 'mg' and whole else ''})")
    per_g = counts_per_g(norms) if whole else None
    if per_g is None:
        return None
    return Unit("counts", f", {per_g:g} in g (by the size of gravity)", per_g / STANDARD)


def unit_of_rates(parts: Sequence[Part], axes: Axes, force: Unit) -> Unit | None:
    """Return the unit of rates; None of raw counts whose value turns do not show.

    parts: both sensors, the rates read as rad/s; force: the unit of the accelerometer.
    """
    if axes.unit is not None:
        return Unit(_known(parts[-1].table.path, axes))
    whole = Probe(parts[-1].table).whole_numbers(axes)
    per_degree = counts_per_degree(turnings(*_first_samples(parts))) if whole else None
    if per_degree is not None:
        said = f", {per_degree:.4g} in deg/s (as gravity's direction turns)"
        return Unit("counts", said, per_degree / DEGREE)
    if whole and force.name == "counts":
        return None
    unit, said = rate_unit_shown(parts)
    if unit is not None:
        return Unit(unit, f" ({said})")
    unit = "rad/s" if force.name == "m/s^2" else "deg/s"
    return Unit(unit, f" (assumed, as usual beside {force.name}; a column map can say otherwise)")


def rate_unit_shown(parts: Sequence[Part], fewest: int = 1) -> tuple[Any, str]:
    """Return the unit that the first rates show themselves to have, None where they show none, and how.

    parts: both sensors, the rates read as rad/s. fewest: spans of some seconds that must show it.
    """
    accelerometer, gyroscope = _first_samples(parts)
    fastest = float(np.abs(gyroscope.xyz).max()) if len(gyroscope) else 0.0
    if fastest > np.degrees(_FASTEST_RAD_S):
        return "mdeg/s", "too fast for deg/s"
    spans = list(turnings(accelerometer, gyroscope))
    votes = Counter(map(shown_unit, spans))
    if max(votes["deg/s"], votes["as stated"]) >= fewest and votes["deg/s"] != votes["as stated"]:
        unit = _degrees_or_thousandths(spans) if votes["deg/s"] > votes["as stated"] else "rad/s"
        return unit, "as gravity's direction turns"
    return ("deg/s", "too fast for rad/s") if fastest > _FASTEST_RAD_S else (None, "")


def _degrees_or_thousandths(spans: Sequence[Turning]) -> str:
    """Return the unit of rates that are not rad/s: deg/s, unless a smaller one explains gravity's turning."""
    degrees, none = (sum(span.misfit(k) for span in spans) for k in (DEGREE, 0.0))
    left = {unit: sum(span.misfit(k) for span in spans) for unit, k in _THOUSANDTHS.items()}
    best = min(left, key=lambda unit: left[unit])
    return best if left[best] < EXPLAINED * min(degrees, none) else "deg/s"


def _first_samples(parts: Sequence[Part]) -> tuple[Samples, Samples]:
    """Return the first samples of the accelerometer and of the gyroscope; none where one is not there."""
    first: dict[Sensor, Samples] = {}
    for part in parts:
        for sensor, samples in _first_run(SampleFile(part.table, part.column_map, part.sensors, Claims())):
            first[sensor] = samples
    accelerometer, gyroscope = (
        first.get(s, Samples.empty(s)) for s in (Sensor.ACCELEROMETER, Sensor.GYROSCOPE)
    )
    return accelerometer, gyroscope


def _first_run(file: SampleFile) -> list[tuple[Sensor, Samples]]:
    """Return the first samples of each sensor of a file."""
    runs: dict[Sensor, list[Samples]] = {sensor: [] for sensor in file.sensors}
    count = 0
    for run in file.runs():
        for sensor, samples in run.items():
            runs[sensor].append(samples)
            count = max(count, sum(map(len, runs[sensor])))
        if count >= PROBED_ROWS:
            break
    return [(sensor, Samples.joined(found)[:PROBED_ROWS]) for sensor, found in runs.items() if found]
