"""Coloured noise of an inertial sensor: Allan deviations, the covariance of bin means, a likelihood fit.

The model is white noise + flicker noise + a Gauss-Markov process + a random walk. The fit works on bins,
which are means over spans of any length and any distance apart, because rests come when the phone lies still
and not on a grid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array

FLICKER_TIMES_PER_DECADE = 2
"""Gauss-Markov processes a decade of correlation time that make up flicker noise (Keshner 1982)."""

DEPENDENT = 1e-6
"""Relative singular value below which columns are one another's combinations."""

_PART = 1 << 15  # 256 KB: three of them fit a second-level cache


def allan_deviation(values: Array, m: int) -> float:
    """Return the overlapping Allan deviation of equally spaced `values` (n,) at an averaging factor `m`.

    See allan_deviations. That of white noise falls with the square root of the averaging time:

    >>> white = np.random.default_rng(1).normal(0.0, 1.0, 100_000)
    >>> [round(allan_deviation(white, m), 2) for m in (1, 100)]
    [1.0, 0.1]
    """
    return float(allan_deviations(values, (m,))[0])


def allan_deviations(values: Array, factors: Iterable[int]) -> Array:
    """Return the overlapping Allan deviations of equally spaced `values` (n,) at averaging factors m, (k,).

    NIST SP1065, Eq. 10 (overlapping, from phase). Raises ValueError where n < 2 m + 1 or m < 1. The phase is
    summed once, and each part of it that fits a processor's cache serves all factors in turn.
    """
    wanted = [int(m) for m in factors]
    for m in wanted:
        if m < 1 or values.size < 2 * m + 1:
            reason = f"needs 1 <= m and at least {2 * m + 1} values, have {values.size}"
            raise ValueError(f"averaging factor {m}: {reason}")
    phase = np.concatenate(([0.0], values))
    phase[1:] -= values.mean()
    np.cumsum(phase, out=phase)
    half, scratch = -0.5 * phase, np.empty(_PART)
    totals = np.zeros(len(wanted))
    for first in range(0, phase.size, _PART):
        totals += [_squares(phase, half, m, first, scratch) for m in wanted]
    terms = phase.size - 2.0 * np.array(wanted)
    return np.asarray(np.sqrt(2.0 * totals / terms) / wanted)


def _squares(phase: Array, half: Array, m: int, first: int, scratch: Array) -> float:
    """Return the sum of (x[i+m] - (x[i] + x[i+2m]) / 2)^2 over a part of i; half: -x / 2."""
    last = min(first + scratch.size, phase.size - 2 * m)
    if last <= first:
        return 0.0
    off = scratch[: last - first]
    np.add(half[first:last], half[first + 2 * m : last + 2 * m], out=off)
    np.add(off, phase[first + m : last + m], out=off)
    return float(off @ off)


def white_covariance(duration: Array) -> Array:
    """Return the covariance (n, n) of bin means of white noise of unit density; duration: (n,) s.

    >>> white_covariance(np.array([1.0, 4.0]))
    array([[1.  , 0.  ],
           [0.  , 0.25]])
    """
    return np.diag(1.0 / duration)


def gauss_markov_covariance(t: Array, duration: Array, tau: float) -> Array:
    """Return the covariance (n, n) of bin means of a Gauss-Markov process of unit variance.

    t: (n,) s, middles of disjoint bins. duration: (n,) s. tau: s, correlation time. The averages of
    exp(-|dt| / tau) are exact.
    """
    x = duration / (2.0 * tau)
    # Gaps are taken from edge to edge so that the growing sinh cannot overflow for bins longer than tau.
    decay = (1.0 - np.exp(-2.0 * x)) / (2.0 * np.maximum(x, 1e-12))
    gap = np.maximum(np.abs(t[:, None] - t[None, :]) - (duration[:, None] + duration[None, :]) / 2.0, 0.0)
    covariance = np.exp(-gap / tau) * decay[:, None] * decay[None, :]
    own = np.where(x > 1e-4, (2.0 * x - 1.0 + np.exp(-2.0 * x)) / (2.0 * x**2 + 1e-300), 1.0 - 2.0 * x / 3.0)
    np.fill_diagonal(covariance, own)
    return covariance


def random_walk_covariance(t: Array, duration: Array) -> Array:
    """Return the covariance (n, n) of bin means of a random walk from the first bin's start, unit density."""
    start = float((t - duration / 2.0).min())
    covariance = np.minimum(t[:, None], t[None, :]) - start
    np.fill_diagonal(covariance, t - start - duration / 6.0)
    return covariance


def flicker_covariance(t: Array, duration: Array) -> Array:
    """Return the covariance (n, n) of bin means of flicker noise with an Allan variance of 1.

    It is a sum of equal Gauss-Markov processes, `FLICKER_TIMES_PER_DECADE` correlation times a decade, from
    the thirtieth of the shortest bin to ten times the span (Keshner 1982). The floor of flicker noise is 2 ln
    2 h (SP1065, Table 6), with h half the variance per e-fold of correlation time.
    """
    span = float(np.ptp(t) + duration.max())
    low, high = np.log10(float(duration.min()) / 30.0), np.log10(10.0 * span)
    taus = np.logspace(low, high, max(2, round((high - low) * FLICKER_TIMES_PER_DECADE) + 1))
    step = np.log(taus[1] / taus[0])
    total = sum(
        (gauss_markov_covariance(t, duration, float(tau)) for tau in taus), np.zeros((t.size, t.size))
    )
    return np.asarray(total * step / (2.0 * np.log(2.0)), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """The coloured noise of one axis.

    white: density, unit sqrt(s). flicker: floor of the Allan deviation, unit. gauss_markov: standard
    deviation, unit. tau: its correlation time, s. walk: density of the random walk, unit / sqrt(s).
    log_likelihood: restricted, of the fit that it came from, 0 where it came from none.
    """

    white: float
    flicker: float = 0.0
    gauss_markov: float = 0.0
    tau: float = 1.0
    walk: float = 0.0
    log_likelihood: float = 0.0

    def covariance(self, t: Array, duration: Array) -> Array:
        """Return the covariance (n, n) of means over bins with middles t and lengths duration, (n,) s."""
        parts = components(t, duration, self.tau)
        amplitudes = (self.white, self.flicker, self.gauss_markov, self.walk)
        return np.asarray(sum(a**2 * c for a, c in zip(amplitudes, parts, strict=True)), dtype=np.float64)


def components(t: Array, duration: Array, tau: float) -> tuple[Array, Array, Array, Array]:
    """Return the unit covariances, (n, n) each, of white, flicker, Gauss-Markov and random-walk noise."""
    return (
        white_covariance(duration),
        flicker_covariance(t, duration),
        gauss_markov_covariance(t, duration, tau),
        random_walk_covariance(t, duration),
    )


def restricted_log_likelihood(covariance: Array, y: Array, design: Array) -> tuple[float, Array, Array]:
    """Return the restricted log likelihood, P y and P, with P the projected inverse covariance.

    covariance: (n, n). y: (n,). design: (n, p). Patterson and Thompson, Biometrika 58 (1971).
    """
    inverse = np.linalg.inv(covariance)
    weighted = inverse @ design
    information = design.T @ weighted
    projected = inverse - weighted @ np.linalg.solve(information, weighted.T)
    py = projected @ y
    log_determinant = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1]
    return float(-0.5 * (log_determinant + y @ py)), np.asarray(py), np.asarray(projected, dtype=np.float64)


def fit_noise(
    t: Array,
    duration: Array,
    values: Array,
    taus: tuple[float, ...] = (60.0, 240.0, 960.0),
    free: Array | None = None,
) -> NoiseModel:
    """Fit white + flicker + Gauss-Markov + random walk to bin means by restricted maximum likelihood.

    t: (n,) s, middles of the bins. duration: (n,) s. values: (n,). free: (n, p), columns of what may be in
    the values besides, or was fitted to them before; the mean is free too. The correlation time of the
    Gauss-Markov process is the best of `taus`, s. Raises ValueError with fewer than 8 bins beside these.
    """
    columns = np.ones((t.size, 1)) if free is None else np.column_stack([np.ones(t.size), free])
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    design = basis[:, sizes > DEPENDENT * sizes[0]] if t.size else columns
    if t.size - design.shape[1] + 1 < 8:
        raise ValueError(f"coloured noise needs at least 8 bins, have {t.size - design.shape[1] + 1}")
    fits = [_fit_components(components(t, duration, tau), values, design, tau) for tau in taus]
    return max(fits, key=lambda model: model.log_likelihood)


def _fit_components(parts: tuple[Array, ...], values: Array, design: Array, tau: float) -> NoiseModel:
    """Fit the amplitudes of unit covariances, in units of the values' own scatter."""
    from scipy.optimize import minimize  # noqa: PLC0415 - loaded when used: the daemon stays light

    scatter = max(float(values.std()), 1e-300)
    basis = [c / c.diagonal().mean() for c in parts]
    objective = _objective(basis, (values - values.mean()) / scatter, design)
    starts = np.log([[1.0, 0.1, 0.1, 0.1], [0.1, 0.3, 0.3, 0.3]])
    runs = [minimize(objective, s, jac=True, method="L-BFGS-B", bounds=[(-25.0, 8.0)] * 4) for s in starts]
    best = min(runs, key=lambda run: float(run.fun))
    scale = [scatter * np.sqrt(np.exp(x) / c.diagonal().mean()) for x, c in zip(best.x, parts, strict=True)]
    return NoiseModel(
        scale[0],
        scale[1],
        scale[2],
        tau,
        scale[3],
        float(-best.fun) - (values.size - design.shape[1]) * np.log(scatter),
    )


def _objective(basis: list[Array], y: Array, design: Array) -> Callable[[Array], tuple[float, Array]]:
    """Return -log likelihood and its gradient as a function of the components' log variances."""

    def evaluate(x: Array) -> tuple[float, Array]:
        variances = np.exp(x)
        covariance = sum((v * c for v, c in zip(variances, basis, strict=True)), 1e-9 * np.eye(y.size))
        value, py, projected = restricted_log_likelihood(np.asarray(covariance), y, design)
        gradient = [
            0.5 * v * (np.sum(projected * c) - py @ c @ py) for v, c in zip(variances, basis, strict=True)
        ]
        return -value, np.array(gradient)

    return evaluate
