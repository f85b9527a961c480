"""An Allan deviation curve with confidence bands, and the white, flicker and random-walk noise behind it.

The names are IEEE Std 952's: N, random walk of the integral (unit / sqrt(Hz), the deviation at 1 s); B, bias
instability, whose Allan deviation is flat at B sqrt(2 ln 2 / pi) = 0.664 B; K, rate random walk (unit / s /
sqrt(Hz), K sqrt(tau / 3)). Values are evenly spaced here; for rests at any times there is
`covariance.fit_noise`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.noise.covariance import allan_deviations

FLOOR = float(np.sqrt(2.0 * np.log(2.0) / np.pi))
"""Allan deviation of flicker noise over its bias instability B (IEEE Std 952-1997, C.1.3)."""

PER_OCTAVE = 2
"""Averaging factors an octave: neighbouring deviations then share most of their data, so more add little."""

_WHITE, _FLICKER, _WALK = -1.0, 0.0, 1.0  # slopes of the Allan variance over averaging time


@dataclass(frozen=True, slots=True, eq=False)
class AllanCurve:
    """An overlapping Allan deviation with a confidence band.

    tau: (k,) s. deviation: (k,) unit. low, high: (k,) unit, the ends of the band. edf: (k,) equivalent
    degrees of freedom of each Allan variance.
    """

    tau: Array
    deviation: Array
    low: Array
    high: Array
    edf: Array


@dataclass(frozen=True, slots=True, eq=False)
class AllanFit:
    """The noise that explains an Allan curve.

    N: unit sqrt(s). B: unit. K: unit / sqrt(s). errors: (3,) standard errors of their logarithms, infinite
    for one that the curve does not show.
    """

    N: float
    B: float
    K: float
    errors: Array

    def deviation(self, tau: Array) -> Array:
        """Return the Allan deviation of this noise at averaging times (k,) s."""
        return np.asarray(np.sqrt(_shapes(tau) @ np.square([self.N, self.B, self.K])))

    def slopes(self, tau: Array) -> Array:
        """Return the slope of the logarithm of the Allan variance over that of tau at (k,) s."""
        parts = _shapes(tau) * np.square([self.N, self.B, self.K])
        return np.asarray(parts @ np.array([_WHITE, _FLICKER, _WALK]) / parts.sum(axis=1))


def averaging_factors(n: int) -> list[int]:
    """Return averaging factors, PER_OCTAVE an octave, up to a quarter of n values."""
    octaves = np.arange(0.0, np.log2(max(n / 4.0, 1.0)) + 1e-9, 1.0 / PER_OCTAVE)
    return sorted({round(2.0**o) for o in octaves})


def allan_curve(values: Array, rate: float, confidence: float = 0.6827) -> AllanCurve:
    """Return the overlapping Allan deviation of (n,) values at `rate` Hz with a chi-squared band.

    The band follows NIST SP1065, 5.3.1. Its degrees of freedom are those of Table 5 for the noise that
    prevails at each tau, by the slope of a first fit: the curve's own slope is noisy where the band matters.
    confidence: probability of the band. Raises ValueError with fewer than 16 values.
    """
    if values.size < 16:
        raise ValueError(f"an Allan curve needs at least 16 values, have {values.size}")
    from scipy.stats import chi2  # noqa: PLC0415 - loaded when used: the daemon stays light

    factors = averaging_factors(values.size)
    tau = np.array(factors) / rate
    deviation = allan_deviations(values, factors)
    slopes = np.full(tau.size, _FLICKER)
    for _ in range(2):
        edf = np.array([edf_of(values.size + 1, m, s) for m, s in zip(factors, slopes, strict=True)])
        slopes = fit_allan(AllanCurve(tau, deviation, deviation, deviation, edf)).slopes(tau)
    tail = (1.0 - confidence) / 2.0
    low, high = (deviation * np.sqrt(edf / chi2.ppf(q, edf)) for q in (1.0 - tail, tail))
    return AllanCurve(frozen(tau), frozen(deviation), frozen(low), frozen(high), frozen(edf))


def edf_of(n_phase: int, m: int, slope: float) -> float:
    """Return the degrees of freedom of an overlapping Allan variance from n_phase phases at factor m.

    slope: of the logarithm of the variance over that of averaging time, rounded to -1 (white), 0 (flicker) or
    1 (random walk). SP1065, Table 5 (Howe, Allan and Barnes 1981). The result is at least 1.
    """
    n = float(n_phase)
    kind = float(np.clip(np.rint(slope), _WHITE, _WALK))
    if kind == _WHITE:
        edf = (3.0 * (n - 1.0) / (2.0 * m) - 2.0 * (n - 2.0) / n) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    elif kind == _FLICKER:
        edf = 2.0 * (n - 2.0) ** 2 / (2.3 * n - 4.9) if m == 1 else 5.0 * n**2 / (4.0 * m * (n + 3.0 * m))
    else:
        edf = (n - 2.0) / m * ((n - 1.0) ** 2 - 3.0 * m * (n - 1.0) + 4.0 * m**2) / (n - 3.0) ** 2
    return max(edf, 1.0)


def fit_allan(curve: AllanCurve) -> AllanFit:
    """Fit N, B and K to a whole curve by the likelihood of its variances, each chi-squared with its edf.

    Reading slopes off a curve uses three of its points. This uses all of them, and each noise explains only
    what the others do not. Neighbouring points share data; the errors allow for it by counting each octave
    once.
    """
    from scipy.optimize import minimize  # noqa: PLC0415 - loaded when used: the daemon stays light

    variance, shapes, weight = curve.deviation**2, _shapes(curve.tau), curve.edf / (2.0 * PER_OCTAVE)
    scale = variance[0] * curve.tau[0], variance.min() / FLOOR**2, 3.0 * variance[-1] / curve.tau[-1]
    unit = shapes * np.array(scale)

    def deviance(x: Array) -> tuple[float, Array]:
        parts = unit * np.exp(x)
        model = parts.sum(axis=1)
        ratio = variance / model
        return float(weight @ (ratio + np.log(model))), np.asarray(parts.T @ (weight * (1.0 - ratio) / model))

    starts = np.log([[1.0, 1.0, 1.0], [1.0, 0.3, 0.1], [1.0, 0.03, 1.0]])
    runs = [minimize(deviance, s, jac=True, method="L-BFGS-B", bounds=[(-20.0, 5.0)] * 3) for s in starts]
    best = min(runs, key=lambda run: float(run.fun))
    share = unit * np.exp(best.x)
    share /= share.sum(axis=1, keepdims=True)
    n, b, k = (float(v) for v in np.sqrt(np.array(scale) * np.exp(best.x)))
    return AllanFit(n, b, k, frozen(_log_errors(share.T @ (weight[:, None] * share))))


def _shapes(tau: Array) -> Array:
    """Return the Allan variance of N = 1, B = 1 and K = 1 at each tau, (k, 3)."""
    return np.column_stack((1.0 / tau, np.full(tau.size, FLOOR**2), tau / 3.0))


def _log_errors(information: Array) -> Array:
    """Return standard errors of half the logarithms of variances from their information (3, 3)."""
    shown = information.diagonal() > 0.5
    errors = np.full(3, np.inf)
    errors[shown] = 0.5 * np.sqrt(np.linalg.pinv(information[np.ix_(shown, shown)]).diagonal())
    return errors
