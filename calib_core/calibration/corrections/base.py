"""What all corrections share: what they follow, and how a term's parameters are made, checked and applied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.streams.limits import READING
from stillcal.calib_core.streams.samples import Sensor

REACH_OF_95 = 1.96
"""Standard uncertainties from a value to an end of its 95 % interval."""

UNIT = {Sensor.ACCELEROMETER: "m/s^2", Sensor.GYROSCOPE: "rad/s"}
LARGEST_BIAS = {Sensor.ACCELEROMETER: 5.0, Sensor.GYROSCOPE: 0.5}
"""Half of gravity, and 30 degrees a second: no change of a bias is larger."""

PREFIX = {Sensor.ACCELEROMETER: "accel", Sensor.GYROSCOPE: "gyro"}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Drivers:
    """What terms follow, at n moments. None is unknown at all of them, NaN at one of them.

    celsius: (n,) degC. lagged: (n, k) degC, of sensors that follow the thermometer late, as thermometer.py
    has it. charged: (n, 1 + k) K, as charger.py has it. force: (n, 3) m/s^2, calibrated. age: (n,) s since
    the sensor was switched on. raw: (n, 3) what the sensor reads. reading: (n, 3), the same less its bias and
    its other errors.
    """

    celsius: Array | None = None
    lagged: Array | None = None
    charged: Array | None = None
    force: Array | None = None
    age: Array | None = None
    raw: Array | None = None
    reading: Array | None = None


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a correction. most: the largest size that a stored value may have, in `unit`."""

    name: str
    unit: str
    most: float
    shape: tuple[int, ...] = (3,)
    required: bool = True


class Correction:
    """One effect that can be taken out of readings.

    effect: its name in a diagnosis. sensor: None for an effect of either sensor. parameters: in the order of
    the formula. references: names of what the parameters count from. keeps_spread: whether a term keeps how
    much the temperatures of the calibration differ (`temperature_sd`, K), for where one is unknown.
    of_reading: whether it follows what the sensor itself reads; else it is a bias. has_forecast: whether the
    forecast of the bias states how uncertain it is. refits: whether a calibration that takes it up is fitted
    anew to its own rests, because its bias and scale hold a part of it. without_rests: whether it may be
    taken up, without that, where the rests do not tell what it follows; the bias then holds about its mean.
    in_turns: whether the scale that was fitted to turns holds a part. by_charger: whether it follows the
    charger. by_start: whether it follows the time since the sensors were switched on. driver: what it
    follows, in words, and remedy: what a calibration needs whose rests do not tell it.
    """

    effect: str
    sensor: Sensor | None
    parameters: tuple[Parameter, ...]
    references: ClassVar[tuple[str, ...]] = ()
    keeps_spread: ClassVar[bool] = False
    of_reading: ClassVar[bool] = False
    has_forecast: ClassVar[bool] = False
    refits: ClassVar[bool] = False
    without_rests: ClassVar[bool] = False
    in_turns: bool = False
    by_charger: ClassVar[bool] = False
    by_start: ClassVar[bool] = False
    driver: ClassVar[str] = ""
    remedy: ClassVar[str] = ""

    def response(self, term: Term, at: Drivers) -> Mapping[str, Array] | None:
        """Return the change of the readings by a unit of each parameter, (n, 3) or (n, 1).

        NaN where a driver is unknown; None where it is unknown at all moments.
        """
        raise NotImplementedError

    def offset(self, term: Term, at: Drivers) -> Array | None:
        """Return what the effect adds to the readings, (n, 3), unknown as in `response`."""
        by = self.response(term, at)
        if by is None:
            return None
        return np.asarray(sum(by[name] * term.parameters[name].value for name in by))

    def unknown(self, term: Term, at: Drivers) -> Array:
        """Return how far readings are off (root mean square) where the driver is unknown, (3,) or (n, 3)."""
        return np.zeros(3)

    def uncertainty(self, term: Term, at: Drivers) -> Array:
        """Return the standard uncertainty of readings from which the offset was taken, (3,) or (n, 3).

        It is that of the parameters, and where a driver is unknown, that of the effect as a whole.
        """
        by = self.response(term, at)
        if by is None:
            return self.unknown(term, at)
        squares = sum((by[name] * uncertainty_of(term.parameters[name])) ** 2 for name in by)
        sd = np.sqrt(np.asarray(squares))
        return np.where(np.isfinite(sd), sd, self.unknown(term, at))

    def from_start(self, term: Term, after: float) -> Term:
        """Return the term of a finding that counts from `after` s after the start, counted from the start."""
        return term

    def held_by_scale(self, term: Term, turn_powers: Array) -> Array:
        """Return how much larger, (3,) of one, a scale that left the effect out makes the reading.

        turn_powers: (2, 3) as GyroscopeRecord has it.
        """
        return np.zeros(3)

    def check(self, term: Term) -> None:
        """Refuse a term whose parameters are missing, strange, of another shape or too large: ValueError."""
        strange = term.parameters.keys() - {p.name for p in self.parameters}
        if strange:
            raise ValueError(f"{self.effect} has no parameter {', '.join(sorted(strange))}")
        for parameter in self.parameters:
            if parameter.name in term.parameters:
                self._check(parameter, term.parameters[parameter.name])
            elif parameter.required:
                raise ValueError(f"{self.effect} lacks its {parameter.name}")
        for name in self.references:
            if name not in term.reference:
                raise ValueError(f"{self.effect} lacks the {name} that it counts from")
        if not all(np.isfinite(value) for value in term.reference.values()):
            raise ValueError(f"{self.effect}: what it counts from must be finite")

    def _check(self, parameter: Parameter, given: TermParameter) -> None:
        value = np.asarray(given.value)
        if value.shape != parameter.shape:
            raise ValueError(
                f"{self.effect}: {parameter.name} has shape {value.shape}: expected {parameter.shape}"
            )
        if not np.isfinite(value).all():
            raise ValueError(f"{self.effect}: {parameter.name} must be finite numbers")
        if (np.abs(value) > parameter.most).any():
            raise ValueError(
                f"{self.effect}: {parameter.name} is {np.abs(value).max():g} {parameter.unit}:"
                f" {parameter.most:g} at most"
            )
        if given.ci95 is not None and np.shape(given.ci95) != (*parameter.shape, 2):
            raise ValueError(f"{self.effect}: ci95 of {parameter.name} has shape {np.shape(given.ci95)}")
        if given.ci95 is not None and not (np.abs(given.ci95) <= READING).all():
            raise ValueError(
                f"{self.effect}: ci95 of {parameter.name} must be numbers of {READING:g} at most"
            )

    def term(self, sensor: Sensor, finding: Mapping[str, Any], reference: dict[str, float]) -> Term:
        """Turn a finding (of `diagnose --json`) into a checked term. reference: what it counts from."""
        given = finding.get("parameters") or {}
        for parameter in self.parameters:
            if parameter.required and given.get(parameter.name) is None:
                raise ValueError(f"{self.effect}: the finding has no {parameter.name}")
        made = {p.name: _read(given[p.name], p.unit) for p in self.parameters if given.get(p.name)}
        term = Term(effect=self.effect, sensor=sensor, parameters=made, reference=reference)
        self.check(term)
        return term


def _read(given: Mapping[str, Any], unit: str) -> TermParameter:
    """Read a parameter of a finding."""
    ci95 = None if given.get("ci95") is None else frozen(np.asarray(given["ci95"], dtype=np.float64))
    value = frozen(np.asarray(given["value"], dtype=np.float64))
    return TermParameter(value=value, unit=str(given.get("unit") or unit), ci95=ci95)


def uncertainty_of(parameter: TermParameter) -> Array:
    """Return the standard uncertainty of a parameter; 0 where it was not stated."""
    if parameter.ci95 is None:
        return np.zeros(parameter.value.shape)
    return np.asarray(np.ptp(parameter.ci95, axis=-1) / (2.0 * REACH_OF_95))
