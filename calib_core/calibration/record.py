"""The record of a calibration: plain values with units, evidence and origin, to be stored and applied.

A record checks itself when it is made, so that one that was loaded is as sound as one that was fitted. Its
field names are the keys of stored files. Times are s of the sensor's own stamp, forces m/s^2, rates rad/s,
temperatures degC.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from stillcal.calib_core.accelerometer.parameters import BIAS, DIAGONAL, LOWER, SCALE
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.corrections.catalogue import check_terms
from stillcal.calib_core.calibration.corrections.term import Term
from stillcal.calib_core.codec import digest, floats, jsonable
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.streams.beginning import Beginning
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.charger import CHARGER_LAGS_S, FULL_K
from stillcal.calib_core.temperature.forecast import Forecast

How = Literal["calibration", "zeroing", "following", "terms", "rollback", "migration"]
Evidence = dict[str, float | int | str | bool | None]

DETERMINANTS = (1 / 8, 8.0)
"""Bounds of |det scale|: a factor of two on every axis; the largest error seen on a phone is 15 %."""


TAIL = 0.975
"""Of a two-sided interval of 95 %."""

LOWER_TO_UPPER = {lower: upper for upper, lower in LOWER.items()}


class NotCalibratedError(ValueError):
    """The record has no calibration of the sensor asked for."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SensorRecord:
    """One sensor's calibration: calibrated = scale @ (raw - bias).

    scale: (3, 3), dimensionless. bias: (3,) in `unit`. parameters: number of parameters fitted. covariance:
    (p, p) of the parameters called `names`, None where unknown; NaN where the rests bound nothing.
    rms_residual: over all rests used, in `residual_unit`. n_rests: number of rests used. n_states: number of
    distinct attitudes among them.
    """

    scale: Array
    bias: Array
    parameters: int
    names: tuple[str, ...] = ()
    covariance: Array | None = None
    rms_residual: float | None = None
    n_rests: int = 0
    n_states: int = 0

    def __post_init__(self) -> None:
        for name in ("scale", "bias") if self.covariance is None else ("scale", "bias", "covariance"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        model = SensorModel.of(self.scale, self.bias)
        _require_within("|det scale|", abs(float(np.linalg.det(model.scale))), *DETERMINANTS)
        _require_within("parameters", self.parameters, 3, 12)
        _require_within("n_states", self.n_states, 0, self.n_rests)
        if self.rms_residual is not None:
            _require_within("rms_residual", self.rms_residual, 0.0, math.inf)
        if self.covariance is not None:
            _check_covariance(self.covariance, len(self.names))

    @property
    def model(self) -> SensorModel:
        """The correction alone, without its evidence."""
        return SensorModel.of(self.scale, self.bias)

    @property
    def bias_uncertainty(self) -> Array | None:
        """Standard uncertainty of the bias, (3,) in `unit`; None where the covariance does not hold it."""
        if self.covariance is None or not set(BIAS) <= set(self.names):
            return None
        return frozen(self._sd(BIAS))

    @property
    def scale_uncertainty(self) -> Array | None:
        """Standard uncertainty of the scale, (3, 3); NaN for what was not fitted, None where unknown."""
        if self.covariance is None or not set(DIAGONAL) <= set(self.names):
            return None
        symmetric = not set(LOWER.values()) & set(self.names)
        fitted = [LOWER_TO_UPPER.get(n, n) if symmetric else n for n in SCALE]
        sd = self._sd(fitted).reshape(3, 3)
        return frozen(np.where(sd > 0.0, sd, np.nan))

    @property
    def bias_interval(self) -> Array | None:
        """The bias' 95 % interval, (2, 3) in `unit`: lower and upper ends. None where unknown."""
        return self._interval(self.bias, self.bias_uncertainty)

    @property
    def scale_interval(self) -> Array | None:
        """The scale's 95 % interval, (2, 3, 3): lower and upper ends, NaN for what was not fitted."""
        return self._interval(self.scale, self.scale_uncertainty)

    @property
    def degrees_of_freedom(self) -> int:
        """Distinct attitudes less parameters; at 0 or less, uncertainties come only from the rests' noise."""
        return self.n_states - self.parameters

    def _sd(self, names: Sequence[str]) -> Array:
        """Return the standard uncertainties of parameters, NaN for one that was not fitted."""
        assert self.covariance is not None
        known = dict(zip(self.names, np.sqrt(np.diag(self.covariance)), strict=False))
        return np.array([known.get(name, np.nan) for name in names])

    def _interval(self, value: Array, sd: Array | None) -> Array | None:
        """Return value -+ reach, by Student's t where there are degrees of freedom, else by the normal."""
        if sd is None:
            return None
        from scipy.special import ndtri, stdtrit  # noqa: PLC0415 - loaded when used: the daemon stays light

        free = self.degrees_of_freedom
        reach = float(stdtrit(free, TAIL) if free > 0 else ndtri(TAIL))
        return frozen(np.stack([value - reach * sd, value + reach * sd]))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AccelerometerRecord(SensorRecord):
    """The accelerometer's calibration.

    gravity: m/s^2, the norm that its rests were fitted to. repeatability: m/s^2, standard deviation of the
    norm between rests of one attitude, None where no attitude was held twice. observability: (p,) how well
    the attitudes show each parameter, from 0, not at all, to 1, as well as evenly spread ones. unobservable:
    what no rest can show. most_helpful_attitude: the attitude to add, in words. n_dropped: number of rests
    left out as outliers. iterations: number of steps of the fit. with_prior: whether what is known of sound
    phones entered, because the attitudes alone do not show all parameters; the covariance holds it.
    """

    gravity: float
    repeatability: float | None = None
    observability: Array | None = None
    unobservable: tuple[str, ...] = ()
    most_helpful_attitude: str | None = None
    n_dropped: int = 0
    iterations: int | None = None
    with_prior: bool = False
    unit: Literal["m/s^2"] = "m/s^2"
    residual_unit: Literal["m/s^2"] = "m/s^2"

    def __post_init__(self) -> None:
        SensorRecord.__post_init__(self)  # super() does not reach through slots=True
        _require_within("gravity", self.gravity, 9.7, 9.9)

    @property
    def degrees_of_freedom(self) -> int:
        """Distinct attitudes less parameters; with a prior, which counts as an observation of each, all."""
        return self.n_states - (0 if self.with_prior else self.parameters)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GyroscopeRecord(SensorRecord):
    """The gyroscope's calibration.

    rms_residual: rad, angle between gravity propagated by the gyroscope and gravity measured. rms_nominal:
    rad, the same with the nominal scale; the rests' bias is taken off in both. n_turns: number of rotation
    segments used. rotation_admitted: (3,) rad/s, bound on undetected rotation: the error that slow rotation
    in the rests may have put into the bias; NaN where nothing bounds it. missing: rotations that a larger
    model needs. zeroed_at: s, when the bias was last measured at rest. turn_powers: (2, 3) rad/s and
    (rad/s)^2, by how much an error of the rate by its square, and by its cube, makes the turns larger, per
    radian and unit of that error; None where no turns were used, or an earlier version fitted them.
    """

    rms_nominal: float | None = None
    n_turns: int = 0
    rotation_admitted: Array | None = None
    missing: tuple[str, ...] = ()
    zeroed_at: float | None = None
    turn_powers: Array | None = None
    unit: Literal["rad/s"] = "rad/s"
    residual_unit: Literal["rad"] = "rad"

    def __post_init__(self) -> None:
        SensorRecord.__post_init__(self)
        powers = self.turn_powers
        if powers is not None and (powers.shape != (2, 3) or not np.isfinite(powers).all()):
            raise ValueError(f"turn_powers has shape {powers.shape}: expected finite numbers, (2, 3)")

    @property
    def degrees_of_freedom(self) -> int:
        """Two a turn, less the scale's parameters; 0 or less where only the bias was measured."""
        return 2 * self.n_turns - (self.parameters - 3)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StateRecord:
    """A rest that a calibration was fitted to.

    specific_force, force_uncertainty, rate, rate_uncertainty: (3,), raw, as in RestState. residual: m/s^2,
    norm of the calibrated force less gravity. attitude: number of its attitude, from 0. charging: 1 on the
    charger and 0 off it, None where unknown.
    """

    t_start: float
    t_end: float
    n: int
    specific_force: Array
    force_uncertainty: Array
    rate: Array | None = None
    rate_uncertainty: Array | None = None
    temperature: float | None = None
    residual: float | None = None
    attitude: int | None = None
    charging: float | None = None

    def __post_init__(self) -> None:
        for name in ("specific_force", "force_uncertainty", "rate", "rate_uncertainty"):
            vector = getattr(self, name)
            if vector is not None and vector.shape != (3,):
                raise ValueError(f"{name} has shape {vector.shape}: expected (3,)")

    @classmethod
    def of(cls, rest: RestState, residual: float | None = None, attitude: int | None = None) -> StateRecord:
        """Build from a rest with its residual, m/s^2, and the number of its attitude."""
        return cls(
            t_start=rest.t_start,
            t_end=rest.t_end,
            n=rest.n,
            specific_force=rest.specific_force,
            force_uncertainty=rest.force_uncertainty,
            rate=rest.rate,
            rate_uncertainty=rest.rate_uncertainty,
            temperature=rest.temperature,
            residual=residual,
            attitude=attitude,
            charging=_charging(rest),
        )

    def rest(self) -> RestState:
        """Return the rest again, with what is kept of it."""
        lagged = np.full(len(CHARGER_LAGS_S), np.nan)
        on = np.nan if self.charging is None else self.charging * FULL_K
        return RestState(
            t_start=self.t_start,
            t_end=self.t_end,
            n=self.n,
            specific_force=self.specific_force,
            force_sd=self.force_uncertainty,
            force_uncertainty=self.force_uncertainty,
            level=0.0,
            rate=self.rate,
            rate_sd=self.rate_uncertainty,
            rate_uncertainty=self.rate_uncertainty,
            temperature=self.temperature,
            charged=np.concatenate(([on], lagged)),
        )


def _charging(rest: RestState) -> float | None:
    """Return whether a rest was on the charger, None where unknown."""
    known = rest.charged is not None and bool(np.isfinite(rest.charged[0]))
    return float(rest.charged[0] / FULL_K) if known and rest.charged is not None else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Validity:
    """The range of temperatures, degC, that the calibration was measured in; None where unknown."""

    temperature_min: float | None = None
    temperature_max: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Acceptance:
    """How and why the calibration became current; evidence: the figures that were decided on."""

    how: How = "calibration"
    reason: str = ""
    evidence: Evidence = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """Where the calibration comes from; t_start, t_end: s, the span of the samples used.

    beginning: of the recording that they are from, None for samples of a running phone.
    """

    software: str = ""
    source: str = ""
    device: str = ""
    t_start: float | None = None
    t_end: float | None = None
    beginning: Beginning | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CalibrationRecord:
    """A calibration of a phone: either sensor or both, with all that is needed to judge and use it.

    fitted_at: s, sample time of the fit, None where unknown. forecast: by sensor, how uncertain its bias is
    at other times and temperatures, where that was learnt. Raises ValueError where both sensors are missing
    or gravity is one that no place on earth has, or a term is no sound one of its effect.
    """

    accelerometer: AccelerometerRecord | None = None
    gyroscope: GyroscopeRecord | None = None
    gravity: Gravity | None = None
    fitted_at: float | None = None
    validity: Validity = field(default_factory=Validity)
    acceptance: Acceptance = field(default_factory=Acceptance)
    provenance: Provenance = field(default_factory=Provenance)
    terms: tuple[Term, ...] = ()
    states: tuple[StateRecord, ...] = ()
    forecast: dict[str, Forecast] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.accelerometer is None and self.gyroscope is None:
            raise ValueError("a calibration needs an accelerometer part, a gyroscope part, or both")
        if self.gravity is not None:
            _require_within("gravity.value", self.gravity.value, 9.7, 9.9)
            _require_within("gravity.uncertainty", self.gravity.uncertainty, 0.0, 0.1)
        check_terms(self.terms)

    @property
    def provisional(self) -> bool:
        """Whether this is a gyroscope part alone that no later rest has confirmed since the start."""
        return self.accelerometer is None and bool(self.acceptance.evidence.get("provisional"))

    @property
    def id(self) -> str:
        """The calibration's identifier: twelve hex digits of the digest of its values.

        Acceptance and provenance do not enter, so that a live run and its replay give the same id; a prior
        does where there is one, and the speed of turns does not, so that older calibrations keep their ids.
        """
        accelerometer = jsonable(self.accelerometer)
        if accelerometer is not None and not accelerometer["with_prior"]:
            del accelerometer["with_prior"]
        gyroscope = jsonable(self.gyroscope)
        if gyroscope is not None:
            del gyroscope["turn_powers"]
        values = {
            "accelerometer": accelerometer,
            "gyroscope": gyroscope,
            "gravity": self.gravity,
            "fitted_at": self.fitted_at,
            "terms": self.terms,
        }
        return digest(floats(jsonable(values)))[:12]

    def model(self, sensor: Sensor) -> SensorModel:
        """Return the correction of one sensor. Raises NotCalibratedError where there is none."""
        part = self.accelerometer if sensor == Sensor.ACCELEROMETER else self.gyroscope
        if part is None:
            raise NotCalibratedError(
                f"calibration {self.id} has no {sensor} part: record one with it at rest"
            )
        return part.model

    def bias_uncertainty_at(
        self,
        sensor: Sensor,
        t: float | None,
        celsius: float | None,
        lagged: Array | None = None,
        charged: Array | None = None,
        *,
        stray_k: float = 0.0,
    ) -> Array | None:
        """Return the standard uncertainty (3,) of a bias at t (s) and a temperature, degC; None if unknown.

        celsius: None where unknown. lagged: (k,) degC, of sensors that follow the thermometer late. charged:
        (1 + k,) K, what the charger stands in for. stray_k: K, standard uncertainty of the temperature. Where
        no forecast was learnt, it is that of the time of the fit.
        """
        forecast = self.forecast.get(str(sensor))
        if forecast is not None and t is not None:
            return forecast.bias_uncertainty(t, celsius, lagged, charged, stray_k=stray_k)
        part = self.accelerometer if sensor == Sensor.ACCELEROMETER else self.gyroscope
        return None if part is None else part.bias_uncertainty

    def apply(self, raw: Array, sensor: Sensor) -> Array:
        """Correct raw readings (..., 3) of one sensor by its affine model; `terms.correct` adds the terms."""
        return self.model(sensor).apply(raw)


def _require_within(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ValueError(f"{name} is {value:g}: expected within {low:g} .. {high:g}")


def _check_covariance(covariance: Array, n_names: int) -> None:
    p = covariance.shape[0] if covariance.ndim else 0
    if covariance.shape != (p, p) or (n_names and n_names != p):
        raise ValueError(f"covariance has shape {covariance.shape}: expected square, one row per name")
    if (np.diag(covariance) < 0).any():
        raise ValueError("covariance has a negative variance")
