"""One rest that misses what is stated of a bias: the uncertainty grows at once, before anything is learnt.

Such a rest is a bad one, or the bias has stepped. Both are taken for equally likely at first. The rests after
it tell them apart: a step is followed as a Kalman filter follows a constant (Bar-Shalom, Li and Kirubarajan
2001, chapter 5), and the odds change by the likelihood of each rest with a step and without. What is stated
grows by the expected square of the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.calibration.drift_check import norm_uncertainty
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.calibration.terms import drivers_at, offsets, terms_uncertainty
from stillcal.calib_core.static.rest import directions
from stillcal.calib_core.streams.samples import Sensor
from stillcal.calib_core.temperature.breaks import HIDDEN
from stillcal.calib_core.temperature.memory import Memory

_MOST_LOG_ODDS = 30.0
"""Log odds, either way, beyond which further rests do not count: later ones must be able to turn them."""


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """By how much one rest misses its prediction. missed: (k,) in the sensor's unit. sd: (k,), of that.

    towards: (k, 3) derivatives by the bias.
    """

    missed: Array
    sd: Array
    towards: Array

    def surprises(self, significance: float) -> bool:
        """Tell whether a component is larger than so many standard uncertainties."""
        return bool((np.abs(self.missed) > significance * self.sd).any())


@dataclass(frozen=True, slots=True, eq=False)
class Suspicion:
    """A step of a bias that is suspected. mean (3,), covariance (3, 3): of it, in the sensor's unit.

    log_odds: natural logarithm, of a step against none.
    """

    mean: Array
    covariance: Array
    log_odds: float = 0.0

    @property
    def probability(self) -> float:
        """The probability that the bias has stepped."""
        return 1.0 / (1.0 + math.exp(-max(self.log_odds, -_MOST_LOG_ODDS)))

    @property
    def uncertainty(self) -> Array:
        """By how much the bias may be off for it, (3,): root of the expected square of the step."""
        return np.sqrt(self.probability * (np.diag(self.covariance) + self.mean**2))

    def after(self, rest: Innovation) -> Suspicion:
        """Return the suspicion after one rest more."""
        without = np.diag(rest.sd**2)
        predicted = rest.towards @ self.covariance @ rest.towards.T + without
        left = rest.missed - rest.towards @ self.mean
        gain = np.linalg.solve(predicted, rest.towards @ self.covariance).T
        likelier = _log_likelihood(left, predicted) - _log_likelihood(rest.missed, without)
        return Suspicion(
            frozen(self.mean + gain @ left),
            frozen(self.covariance - gain @ rest.towards @ self.covariance),
            float(np.clip(self.log_odds + likelier, -_MOST_LOG_ODDS, _MOST_LOG_ODDS)),
        )


def suspected(before: Suspicion | None, rest: Innovation, significance: float) -> Suspicion | None:
    """Return what is suspected after a rest; None for nothing.

    before: what was suspected. significance: standard uncertainties by which a rest must miss its prediction
    for a suspicion to begin; also for another one to begin where a step is the less likely explanation of the
    rests so far. A step is as large as the rest shows (HIDDEN).
    """
    unlikely = before is None or before.log_odds < 0.0
    if not (unlikely and rest.surprises(significance)):
        return None if before is None else before.after(rest)
    hidden = HIDDEN if len(rest.missed) < 3 else 1.0
    size = hidden * float(np.abs(rest.missed).max())
    begun = Suspicion(frozen(np.zeros(3)), frozen(size**2 * np.eye(3))).after(rest)
    return Suspicion(begun.mean, begun.covariance)


def innovation(record: CalibrationRecord, sensor: Sensor, rest: Memory) -> Innovation | None:
    """Return by how much one rest misses what is stated of a sensor; None where it says nothing of it.

    rest: a memory of this rest alone.
    """
    part = record.accelerometer if sensor is Sensor.ACCELEROMETER else record.gyroscope
    celsius, lagged, charged = rest.celsius[0], rest.lagged[0], rest.charged[0]
    stated = record.bias_uncertainty_at(sensor, rest.t[0], celsius, lagged, charged)
    if part is None or stated is None or not np.isfinite(stated).all():
        return None
    forecast = record.forecast.get(str(sensor))
    white = 0.0 if forecast is None else forecast.white
    at = drivers_at(record, sensor, rest)
    offset = offsets(record, sensor, at)
    stated = np.hypot(stated, np.atleast_2d(terms_uncertainty(record, sensor, at))[0])
    if sensor is Sensor.GYROSCOPE:
        missed = (rest.rate - part.bias - offset)[0]
        sd = np.sqrt(stated**2 + rest.rate_sd[0] ** 2 + white**2)
        return Innovation(missed, sd, np.eye(3)) if np.isfinite(missed).all() else None
    return _of_norm(record, rest, offset, stated, white)


def _of_norm(
    record: CalibrationRecord, rest: Memory, offset: Array, stated: Array, white: float
) -> Innovation:
    """Return by how much a rest's calibrated norm is longer than local gravity."""
    part = record.accelerometer
    assert part is not None
    force = part.model.apply(rest.force - offset)
    towards = directions(force) @ part.scale
    of_means = np.linalg.norm(towards * np.hypot(stated, rest.force_sd), axis=1)
    sd = np.sqrt(of_means**2 + norm_uncertainty(part, rest.force) ** 2 + white**2)
    return Innovation(np.linalg.norm(force, axis=1) - rest.gravity, sd, towards)


def _log_likelihood(left: Array, covariance: Array) -> float:
    """Return the logarithm of the normal density of residuals (k,), less its constant."""
    _, log_volume = np.linalg.slogdet(covariance)
    return float(-0.5 * (left @ np.linalg.solve(covariance, left) + log_volume))
