"""The uncertainty of a bias now: at another time and another temperature than it was measured at."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.temperature.charger import CHARGER_LAGS_S, FULL_K
from stillcal.calib_core.temperature.regression import curve_basis
from stillcal.calib_core.temperature.thermometer import LAGS_S, felt
from stillcal.calib_core.temperature.wander import Wander

_LEAST_SPAN_K = 1.0

UNSEEN_S = 600.0
"""s: where no rest has come for so long, the phone may be in use, and warmer than rests have shown it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Forecast:
    """What is known of a sensor's bias besides its value; in the sensor's unit, K and s.

    at: s, time that the bias holds for. reference: degC, temperature that it holds for. temperature_min,
    temperature_max: degC, span of the rests, None without a thermometer. curve: (3, 3) coefficients of u,
    u^2, u^3 by axis, u = (T - reference) / 10 K. error: (4, 3) what is expected of the true bias beyond the
    bias and the terms of the calibration: at the reference, and coefficients; not zero where the evidence
    does not suffice to correct it. covariance: (12, 12) of the bias and the coefficients, axes innermost.
    white, flicker, walk: the wander measured on this phone (wander.Wander). thermometer_sd: K, standard
    uncertainty of a temperature for the thermometer's steps. lag_s: s, with which the sensor follows the
    thermometer; all temperatures here are the sensor's. behind_sd: K, how far the two were apart in the
    rests, root mean square: what is unknown of the sensor's temperature where only the thermometer's is
    known. by_charger: whether all temperatures here are those that the charger stands in for, in K
    (charger.py). unfollowed: (3,) how far the bias is expected to move with a temperature that it was learnt
    to follow and that is not believed or not known now; zero where there is none. unfollowed_since: s.
    rested_at: s, time of the newest rest, None where unknown. unseen: by how many of their standard
    uncertainties rests were off (root mean square, 1 at least) that came after UNSEEN_S without a rest.
    """

    at: float
    reference: float
    curve: Array
    error: Array
    covariance: Array
    white: float
    flicker: float
    walk: float
    temperature_min: float | None = None
    temperature_max: float | None = None
    thermometer_sd: float = 0.0
    lag_s: float = 0.0
    behind_sd: float = 0.0
    by_charger: bool = False
    unfollowed: Array = field(default_factory=lambda: frozen(np.zeros(3)))
    unfollowed_since: float | None = None
    rested_at: float | None = None
    unseen: float = 1.0

    @property
    def wander(self) -> Wander:
        """How the bias wanders."""
        return Wander(self.white, self.flicker, self.walk)

    def bias_uncertainty(
        self,
        t: float,
        celsius: float | None,
        lagged: Array | None = None,
        charged: Array | None = None,
        *,
        stray_k: float = 0.0,
    ) -> Array:
        """Return the standard uncertainty (3,) of the bias at t (s) and a temperature, degC.

        lagged: (k,) degC, of sensors that follow the thermometer late. charged: (1 + k,) K, the readings that
        the charger stands in for. stray_k: K, standard uncertainty of the temperature, for its age. Without a
        temperature, it is taken to be anywhere in the span of the rests.
        """
        lags_s = LAGS_S
        if self.by_charger:
            lags_s = CHARGER_LAGS_S
            celsius, lagged = (None, None) if charged is None else (float(charged[0]), charged[1:])
        if celsius is not None and np.isfinite(celsius):
            known_to = float(np.hypot(self.thermometer_sd, 0.0 if self.by_charger else stray_k))
            own = felt(np.array([np.nan]), lagged, self.lag_s, lags_s)[0] if self.lag_s else celsius
            if np.isfinite(own):
                return self._stated(self._squares(float(own), self.error, known_to), t)
            either = float(np.hypot(known_to, self.behind_sd))
            return self._stated(self._squares(celsius, self.error, either), t)
        error = np.vstack((self.error[:1], self.curve))
        unknown = [self._squares(float(c), error, 0.0) for c in np.linspace(*self._span(), 7)]
        return self._stated(np.mean(unknown, axis=0), t)

    def of_fit(self) -> Forecast:
        """Return the forecast without what is unfollowed or unseen: how certain the fit to the rests is."""
        return replace(self, unfollowed=frozen(np.zeros(3)), unfollowed_since=None, unseen=1.0)

    def at_reference(self, t: float) -> Array:
        """Return the standard uncertainty (3,) of the bias at t (s) and the reference temperature."""
        return self.bias_uncertainty(t, self.reference, charged=np.zeros(1 + len(CHARGER_LAGS_S)))

    def between_temperatures(self) -> Array:
        """Return how far the bias moves with temperature, (3,) root mean square.

        That is by the curve, from any temperature in the span of the rests to any other one: the bias was
        measured at one of them and is wanted at another, and neither is known.
        """
        curve = curve_basis(np.linspace(*self._span(), 7), self.reference) @ self.curve
        return frozen(np.sqrt(2.0) * np.std(curve, axis=0))

    def _span(self) -> tuple[float, float]:
        if self.by_charger:
            return 0.0, FULL_K
        if self.temperature_min is None or self.temperature_max is None:
            return self.reference - _LEAST_SPAN_K, self.reference + _LEAST_SPAN_K
        return self.temperature_min, self.temperature_max

    def _stated(self, squares: Array, t: float) -> Array:
        """Return the standard uncertainty (3,) at t (s). squares: (2, 3), as `_squares` has them.

        What is unfollowed and what is unseen are both for want of a temperature, and the larger counts.
        """
        variance, expected = squares
        variance = variance + self.wander.growth(t - self.at)
        hidden = np.square(self.unfollowed)
        if self.rested_at is not None and t - self.rested_at >= UNSEEN_S:
            hidden = np.maximum(hidden, (self.unseen**2 - 1.0) * variance)
        return np.asarray(np.sqrt(variance + expected + hidden))

    def _squares(self, celsius: float, error: Array, thermometer_sd: float) -> Array:
        """Return the variance of the bias at a temperature, and the square of its expected error, (2, 3).

        error: (4, 3) the coefficients of that.
        """
        at = np.array([celsius])
        basis = np.concatenate(([1.0], curve_basis(at, self.reference)[0]))
        rows = np.kron(basis, np.eye(3))
        slope = (curve_basis(at + 0.5, self.reference) - curve_basis(at - 0.5, self.reference))[
            0
        ] @ self.curve
        variance = np.diag(rows @ self.covariance @ rows.T) + (slope * thermometer_sd) ** 2
        return np.stack((variance, (basis @ error) ** 2))


def plausible(celsius: Array) -> Array:
    """Return temperatures (n,), degC, with NaN for those far beyond nearly all others.

    A thermometer is doubted further from the median than 10 K and four median absolute deviations, until half
    of the rests have such temperatures. Of temperatures that are spread evenly, four deviations are the span.
    """
    known = celsius[np.isfinite(celsius)]
    if not known.size:
        return celsius
    middle = np.median(known)
    reach = 4.0 * np.median(np.abs(known - middle)) + PLAUSIBLE_K
    return np.where(np.abs(celsius - middle) <= reach, celsius, np.nan)


PLAUSIBLE_K = 10.0


def thermometer_step(celsius: Array) -> float:
    """Return the step of a thermometer, K, from the means of rests (n,), degC; 0 where none shows.

    While a phone rests, a coarse thermometer mostly stays on one step, so that the mean is a multiple of it.
    """
    known = celsius[np.isfinite(celsius)]
    for step in (1.0, 0.5, 0.25, 0.2, 0.1):
        if known.size and np.mean(np.abs(known / step - np.round(known / step)) < 0.01) > _ON_STEP:
            return step
    return 0.0


_ON_STEP = 0.5
"""Share of rests on a multiple of a step from which it is the thermometer's; by chance 2 % are."""
