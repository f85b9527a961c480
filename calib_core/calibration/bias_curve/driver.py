"""What a bias is learnt to follow, and how late: the thermometer, or where there is none the charger."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.calibration.corrections.charging_heat import BY_CHARGING
from stillcal.calib_core.calibration.corrections.term import Term, lag_of
from stillcal.calib_core.calibration.terms import polynomial
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.temperature.breaks import learn
from stillcal.calib_core.temperature.charger import CHARGER_LAGS_S
from stillcal.calib_core.temperature.forecast import Forecast, plausible, thermometer_step
from stillcal.calib_core.temperature.memory import Memory
from stillcal.calib_core.temperature.regression import UNIT_K, Fit, Model, Observations, Priors, Regression
from stillcal.calib_core.temperature.thermometer import LAGS_S, felt

_USUAL_C = 25.0

_LIKELIER_LAG = 3.0
"""nats by which another lag must explain the rests better than the one in use."""

_ENOUGH_LAGGED = 0.3
"""Share of rests of known lagged temperature from which on a lag is considered."""


_NEWEST = 2
"""Newest rests that must have doubtful readings for the thermometer to be doubted: one may be a slip."""


_SILENT = 4
"""Newest rests without a reading from which on a thermometer is no longer waited for."""


@dataclass(frozen=True, slots=True, eq=False)
class Driver:
    """Temperatures of the rests kept: the thermometer's, or those that the charger stands in for.

    read: (n,) readings, NaN where unknown; degC, or K above a phone off the charger. lagged: (n, k) those of
    sensors that follow with each of lags_s. by_charger: a bias then follows as a straight line. lies: whether
    the newest readings are doubted.
    """

    read: Array
    lagged: Array
    lags_s: tuple[float, ...] = LAGS_S
    by_charger: bool = False
    lies: bool = False

    @property
    def known(self) -> Array:
        """The readings that are known."""
        return self.read[np.isfinite(self.read)]

    @property
    def mostly_known(self) -> bool:
        """Whether more than half of the rests have a reading."""
        return self.known.size > self.read.size / 2

    @property
    def silent(self) -> bool:
        """Whether none of the newest rests has a reading."""
        return not np.isfinite(self.read[-_SILENT:]).any()

    def drives(self, term: Term) -> bool:
        """Tell whether a term follows this."""
        return (term.effect == BY_CHARGING) == self.by_charger

    def reference(self, term: Term | None) -> float:
        """Return where a curve is to count from: where the term in use does, if there is one."""
        if self.by_charger:
            return 0.0
        usual = float(np.median(self.known)) if self.known.size else _USUAL_C
        return usual if term is None else term.reference.get("temperature", usual)

    def priors(self, priors: Priors) -> Priors:
        """Return what is known of a kind of sensor before its rests."""
        return replace(priors, curve=(priors.curve[0], 0.0, 0.0)) if self.by_charger else priors

    def offset(self, term: Term) -> Array:
        """Return what a term that follows this adds to the bias at the rests, (n, 3)."""
        return polynomial(term, felt(self.read, self.lagged, lag_of(term), self.lags_s))

    def stated(self, forecast: Forecast, celsius: Array) -> Forecast:
        """Return a forecast with what its temperatures are. celsius: (n,) the sensor's at the rests."""
        if self.by_charger:
            return replace(forecast, by_charger=True)
        known = celsius[np.isfinite(celsius)]
        return replace(
            forecast,
            temperature_min=float(known.min()) if known.size else None,
            temperature_max=float(known.max()) if known.size else None,
            thermometer_sd=thermometer_step(self.read) / np.sqrt(12.0),
        )

    def at_likeliest_lag(
        self, seen: Observations, model: Model, t: float, before: Forecast | None, *, search: bool = True
    ) -> tuple[float, Observations, Fit]:
        """Return the lag, s, that explains the rests best, the observations with it, and their fit.

        before: the forecast in use, whose lag stays unless another one is clearly likelier; without `search`
        it stays, and so does its wander as `learn` says.
        """
        lag_s, start = (0.0, None) if before is None else (before.lag_s, before.wander)
        known = 0.0 if before is None else float(np.linalg.norm(before.curve[0])) / UNIT_K
        here = self._with_lag(seen, lag_s, known)
        fit = learn(here, model, t, start, search=search)
        if before is not None and not search:
            return lag_s, here, fit
        seen = seen.about(fit.course)
        slope = float(np.linalg.norm(fit.curve[0])) / UNIT_K
        scores = {}
        for other in (0.0, *self.lags_s):
            if other and np.isfinite(self._late(other)).mean() < _ENOUGH_LAGGED:
                continue
            tried = self._with_lag(seen, other, slope)
            scores[other] = Regression(tried, model).log_likelihood(fit.wander, fit.steps)
        best = max(scores, key=lambda lag: scores[lag])
        if lag_s in scores and scores[best] <= scores[lag_s] + _LIKELIER_LAG:
            best = lag_s
        if best == lag_s:
            return best, here, fit
        there = self._with_lag(seen, best, slope)
        return best, there, learn(there, model, t, fit.wander)

    def _late(self, lag_s: float) -> Array:
        return self.lagged[:, self.lags_s.index(lag_s)]

    def _with_lag(self, seen: Observations, lag_s: float, slope: float) -> Observations:
        """Return observations by the temperature of a sensor that follows with a lag, s.

        slope: change of bias per K, by which rests of unknown lagged temperature are more uncertain.
        """
        if lag_s not in self.lags_s:
            return seen
        late = self._late(lag_s)
        behind = (late - seen.celsius)[np.isfinite(late)]
        more = slope * rms(behind)
        own = felt(seen.celsius, self.lagged, lag_s, self.lags_s)
        return replace(seen, celsius=own).wider(np.where(np.isfinite(late), 0.0, more))


def by_thermometer(memory: Memory) -> Driver:
    """Return the thermometer, without readings that are doubted."""
    read = plausible(memory.celsius)
    doubted = np.isfinite(memory.celsius) & ~np.isfinite(read)
    lagged = np.where(np.isfinite(read)[:, None], memory.lagged, np.nan)
    return Driver(read, lagged, lies=bool(doubted[-_NEWEST:].all()))


def by_charger(memory: Memory) -> Driver:
    """Return the charger."""
    return Driver(memory.charged[:, 0], memory.charged[:, 1:], CHARGER_LAGS_S, by_charger=True)
