"""What is learnt of temperature from real recordings with a thermometer: held-out rests before and after.

`python -m stillcal.replay.studies.real_temperature FOLDER` prints one row for each sensor of each recording.
Every rest is predicted from the rests before it: by the bias of the first rest (before), as the daemon
learns (after), and as it learns without the thermometer (withheld). The recordings of CarbonixUAV were
corrected by the autopilot's own temperature polynomials. Here these are also taken off again, so that a bias
that follows temperature is in the samples for certain (AP_InertialSensor_tempcal.cpp, correct_sensor:
raw = corrected + p(T - 35) - p(T_cal - 35), temperatures within the span that was calibrated).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.bias_curve.learn import LEAST_RESTS, learn_accelerometer, learn_gyroscope
from stillcal.calib_core.calibration.bias_curve.learnt import Learnt
from stillcal.calib_core.calibration.drift_check import QualitySettings
from stillcal.calib_core.calibration.record import CalibrationRecord, GyroscopeRecord
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings
from stillcal.calib_core.gravity import STANDARD
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.settings import DetectorSettings
from stillcal.calib_core.streams.events import End
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.calib_core.temperature.memory import Memory
from stillcal.replay.formats.trace import open_trace

FLIGHT = "carbonix/flight_three_imus.npz"
KNOWN = (
    ("sunsided/still_10min.csv.gz", None),
    ("axivity/ax3_testfile.cwa", None),
    ("axivity/ax6_testfile.cwa", None),
    *((FLIGHT, str(number)) for number in range(3)),
)
"""Recordings with a thermometer, and which of their sensors."""

_REST_S = 8.0
"""Longest rest, s: these recordings last minutes, and one long rest would show nothing of their course."""

_UNITS = {Sensor.ACCELEROMETER: ("mg", 1000 / STANDARD), Sensor.GYROSCOPE: ("deg/s", 180 / np.pi)}
_KINDS = {Sensor.ACCELEROMETER: "ACC", Sensor.GYROSCOPE: "GYR"}
_REFERENCE_C = 35.0

Change = Callable[[Samples], Samples]


@dataclass(frozen=True, slots=True)
class Row:
    """One sensor of a recording.

    span_k: K, of the rests' temperatures. moved: how far, in `unit`, the polynomials that were taken off move
    the bias over that span, None where there are none. before, after, withheld: median error of predicting a
    rest, in `unit`; NaN with fewer rests than the daemon learns from. taken_up: whether a curve was.
    """

    name: str
    sensor: Sensor
    unit: str
    rests: int
    minutes: float
    span_k: float
    moved: float | None
    before: float
    after: float
    withheld: float
    taken_up: bool


class Polynomials:
    """The autopilot's temperature polynomials of one inertial sensor, `number` from 1."""

    def __init__(self, folder: Path, number: int) -> None:
        with np.load(folder / FLIGHT) as file:
            self._parameters: dict[str, float] = json.loads(str(file["parameters"]))
        self._number = number

    def undone(self, samples: Samples) -> Samples:
        """Return samples as they were before the correction."""
        assert samples.temperature is not None
        at_calibration = np.array([self._named(f"{_KINDS[samples.sensor]}{self._number}_CALTEMP")])
        change = self.bias(samples.sensor, samples.temperature) - self.bias(samples.sensor, at_calibration)
        return replace(samples, xyz=samples.xyz + change)

    def bias(self, sensor: Sensor, celsius: Array) -> Array:
        """Return what the polynomials take off at temperatures (n,), degC: (n, 3), m/s^2 or rad/s."""
        low, high = (self._named(f"TCAL{self._number}_T{end}") for end in ("MIN", "MAX"))
        warmer = (np.clip(celsius, low, high) - _REFERENCE_C)[:, None]
        first, second, third = (self._coefficient(sensor, power) for power in (1, 2, 3))
        return np.asarray(1e-6 * warmer * (first + warmer * (second + warmer * third)))

    def _coefficient(self, sensor: Sensor, power: int) -> Array:
        name = f"TCAL{self._number}_{_KINDS[sensor]}{power}"
        return np.array([self._named(f"{name}_{axis}") for axis in "XYZ"])

    def _named(self, name: str) -> float:
        return self._parameters[f"INS_{name}"]


def rows(folder: Path) -> Iterator[Row]:
    """Yield the rows of the recordings that are in FOLDER."""
    for name, sensor in KNOWN:
        if not (folder / name).exists():
            continue
        yield from _rows(folder, name, sensor, None)
        if name == FLIGHT and sensor is not None:
            yield from _rows(folder, name, sensor, Polynomials(folder, int(sensor) + 1))


def _rows(folder: Path, name: str, number: str | None, taken_off: Polynomials | None) -> Iterator[Row]:
    change: Change = (lambda samples: samples) if taken_off is None else taken_off.undone
    memory, end = _kept(folder / name, number, change)
    words = [name, *([] if number is None else [f"sensor {number}"])]
    words += [] if taken_off is None else ["polynomials undone"]
    for sensor in Sensor:
        own = memory if sensor is Sensor.ACCELEROMETER else memory.where(_with_rates(memory))
        if not len(own):
            continue
        unit, factor = _UNITS[sensor]
        moved = None if taken_off is None else taken_off.bias(sensor, np.sort(own.celsius)[[0, -1]])
        learnt = _learnt(sensor, own, end)
        withheld = _learnt(sensor, replace(own, celsius=np.full(len(own), np.nan)), end)
        yield Row(
            ", ".join(words),
            sensor,
            unit,
            len(own),
            float(np.ptp(own.t)) / 60.0,
            float(np.ptp(own.celsius)),
            None if moved is None else factor * float(np.linalg.norm(moved[1] - moved[0])),
            factor * _by_the_first(sensor, own),
            factor * _typical(learnt),
            factor * _typical(withheld),
            learnt is not None and learnt.term is not None,
        )


def _kept(path: Path, number: str | None, change: Change) -> tuple[Memory, float]:
    """Return the rests that the daemon keeps of a recording for learning, and its end, s."""
    detector = DetectorSettings(max_rest_s=_REST_S)
    engine, end = Engine(EngineSettings(ScheduleSettings(watch="continuous"), detector=detector)), 0.0
    for chunk in open_trace(path, sensor=number).chunks():
        gyroscope = [] if chunk.gyroscope is None else [change(chunk.gyroscope)]
        engine.feed(*gyroscope, change(chunk.accelerometer), *chunk.events)
        end = float(chunk.accelerometer.t[-1])
    engine.feed(End(end))
    return engine.present.memory, end


def _with_rates(memory: Memory) -> np.ndarray:
    return np.asarray(np.isfinite(memory.rate).all(axis=1))


def _learnt(sensor: Sensor, memory: Memory, t: float) -> Learnt | None:
    if sensor is Sensor.ACCELEROMETER:
        model = SensorModel.of(np.eye(3), np.zeros(3))
        return learn_accelerometer(memory, model, None, t, QualitySettings())
    record = CalibrationRecord(gyroscope=GyroscopeRecord(scale=np.eye(3), bias=np.zeros(3), parameters=3))
    return learn_gyroscope(memory, record, t, QualitySettings())


def _typical(learnt: Learnt | None) -> float:
    return float("nan") if learnt is None else float(np.median(learnt.errors[1:]))


def _by_the_first(sensor: Sensor, memory: Memory) -> float:
    """Return the median error of predicting each rest by the first: of the norm, or rms over the axes."""
    if len(memory) < LEAST_RESTS:
        return float("nan")
    if sensor is Sensor.ACCELEROMETER:
        norm = np.linalg.norm(memory.force, axis=1)
        return float(np.median(np.abs(norm[1:] - norm[0])))
    return float(np.median(np.sqrt(((memory.rate[1:] - memory.rate[0]) ** 2).mean(axis=1))))


def table(found: Iterator[Row]) -> Iterator[str]:
    """Yield the rows as Markdown."""
    yield "| recording | sensor | rests | polynomials move it by | before | after | withheld | curve |"
    yield "|" + "---|" * 8
    for row in found:
        extent = f"{row.rests} in {row.minutes:.1f} min, {row.span_k:.2g} K"
        moved = "" if row.moved is None else f"{row.moved:.2g} {row.unit}"
        errors = (row.before, row.after, row.withheld)
        told = " | ".join(f"{e:.2g} {row.unit}" if np.isfinite(e) else "-" for e in errors)
        curve = "taken up" if row.taken_up else "refused"
        yield f"| {row.name} | {row.sensor} | {extent} | {moved} | {told} | {curve} |"


@click.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(folder: Path) -> None:
    """Print what is learnt of temperature from the recordings in FOLDER."""
    for line in table(rows(folder)):
        click.echo(line)


if __name__ == "__main__":
    main()
