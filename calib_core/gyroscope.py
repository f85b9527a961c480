"""Gyroscope scale and misalignment from rest to rest (Grammenos et al. 2018, Eq. 9-15).

Gravity as the calibrated accelerometer sees it at one rest is carried by the gyroscope to the next and
compared there. Unlike the paper, which disregards the bias, each turn takes its bias from the rests
around it, with their covariance, and one shift common to all turns is estimated along with the scale.
Rotation about the vertical moves no gravity, so every axis must be turned about while it lies level.
The frame is the accelerometer's. Integration lives in rotation.py, slopes and weights in carried.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.carried import Bundle, Carried, Rests
from stillcal.calib_core.gyro_bias import BiasEstimate, bias_from_rests, smoothed
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.refusals import NotSupported
from stillcal.calib_core.rests import RestState
from stillcal.calib_core.samples import Array
from stillcal.calib_core.turns import Turn

_MEDIAN_RAYLEIGH = np.sqrt(2.0 * np.log(2.0))  # median length of a standard normal 2-vector
_SHRINK = 0.25  # of the allowance for a wrong start, per iteration
_NEGLIGIBLE = 1e-5  # allowance below which there is none
_NOMINAL = np.concatenate((np.eye(3).ravel(), np.zeros(3)))
_TURN_ABOUT = "a few turns about {axis} with {axis} level, from rest to rest"

Mask = NDArray[np.bool_]


class Parameters(StrEnum):
    """What is estimated: the bias alone, with the three scale factors, or with all nine elements."""

    BIAS = "bias"
    SCALE3 = "scale3"
    FULL9 = "full9"


_FREE = {
    Parameters.SCALE3: np.concatenate((np.eye(3, dtype=bool).ravel(), np.full(3, True))),
    Parameters.FULL9: np.full(12, True),
}


@dataclass(frozen=True, slots=True)
class GyroscopeSettings:
    """How the fit is made and when it is refused.

    nominal_error: how far the scale may be off at first. bias_shift: rad/s, how far the bias while
    turning may differ from that at rest (0.1 deg/s per g of g-sensitivity). max_uncertainty: largest
    standard uncertainty of a scale element that still counts as observed. outlier: robust standard
    deviations beyond which a turn is left out. tolerance: of the scale, ends the iteration.
    """

    nominal_error: float = 0.15
    bias_shift: float = 1.7e-3
    max_uncertainty: float = 0.005
    outlier: float = 4.5
    tolerance: float = 1e-9
    max_iterations: int = 50

    def __post_init__(self) -> None:
        for name in ("nominal_error", "bias_shift", "max_uncertainty", "tolerance"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ValueError(f"{name} is {getattr(self, name)}: it must lie between 0 and 1")
        if not self.outlier >= 2.0:
            raise ValueError(f"outlier is {self.outlier}: it must be at least 2")
        if self.max_iterations < 1:
            raise ValueError(f"max_iterations is {self.max_iterations}: it must be at least 1")


@dataclass(frozen=True, slots=True, eq=False)
class GyroscopeFit:
    """A fitted gyroscope. calibrated = model.scale @ (raw - model.bias).

    covariance: (12, 12) of the scale, row by row, then the bias (rad/s); zero where held fixed. bias: what
    the rests say, with its caveats. shift, shift_uncertainty: (3,) rad/s, bias while turning less that at
    rest; the model's bias is that at rest. before, after: (K,) rad, angle between gravity carried and
    measured, with the nominal scale and with the fitted one, the rests' bias taken off in both.
    gravity_rms_*: the same in m/s^2, rms over the turns used. rejected: indices of turns left out.
    turned: (3,) rad, path about each axis over the turns used. variance_factor: squared residuals over
    what their uncertainties promise. missing: what to do to get a larger model.
    """

    model: SensorModel
    parameters: Parameters
    covariance: Array
    bias: BiasEstimate
    shift: Array
    shift_uncertainty: Array
    before: Array
    after: Array
    rms_before: float
    rms_after: float
    gravity_rms_before: float
    gravity_rms_after: float
    rejected: tuple[int, ...]
    turned: Array
    variance_factor: float
    iterations: int
    missing: tuple[str, ...] = ()

    @property
    def scale_uncertainty(self) -> Array:
        """Standard uncertainty of each scale element, (3, 3)."""
        return np.sqrt(np.diag(self.covariance)[:9]).reshape(3, 3)


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """What stays the same while the scale is sought."""

    rests: Rests
    bundle: Bundle
    bias: Array
    walk: Array
    settings: GyroscopeSettings

    def at(self, theta: Array, allowance: float) -> _System:
        """Residuals, slopes and covariance at parameters (12,), the scale still wrong by `allowance`."""
        carried = self.bundle.carry(theta[:9].reshape(3, 3), theta[9:])
        covariance = carried.covariance(self.rests, self.bias, self.walk)
        still_wrong = allowance * np.linalg.norm(self.bundle.path(), axis=1)
        covariance[np.diag_indices_from(covariance)] += np.repeat(still_wrong**2, 2)
        slopes = np.concatenate((carried.scale_slopes, carried.bias_slopes), axis=2)
        return _System(carried, slopes, covariance)


@dataclass(frozen=True, slots=True, eq=False)
class _System:
    """The problem made linear at one point. slopes: (K, 2, 12); covariance: (2 K, 2 K) rad^2."""

    carried: Carried
    slopes: Array
    covariance: Array

    def lengths(self) -> Array:
        """Each turn's residual in standard deviations, (K,)."""
        k = len(self.slopes)
        own = self.covariance.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k)]
        r = self.carried.residuals
        squared: Array = np.einsum("ki,ki->k", r, np.linalg.solve(own, r[..., None])[..., 0])
        return np.sqrt(squared)

    def whitened(self, used: Mask) -> tuple[Array, Array]:
        """Slopes (2 K', 12) and residuals (2 K',) of the turns used, independent and of unit variance."""
        rows = np.repeat(used, 2)
        root = np.linalg.cholesky(self.covariance[np.ix_(rows, rows)])
        both = np.column_stack((self.slopes.reshape(-1, 12), self.carried.residuals.ravel()))
        white: Array = np.linalg.solve(root, both[rows])
        return white[:, :12], white[:, 12]


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """Where the search ended. theta: (12,) scale row by row and shift; covariance: (12, 12)."""

    theta: Array
    used: Mask
    covariance: Array
    variance_factor: float
    iterations: int


def fit(
    turns: Sequence[Turn],
    accel: SensorModel,
    gravity: float,
    *,
    rests: Sequence[RestState] = (),
    parameters: Parameters | None = None,
    settings: GyroscopeSettings | None = None,
) -> GyroscopeFit:
    """Fit the gyroscope to `turns` under the accelerometer's model; gravity in m/s^2.

    rests: further rests for the bias. parameters: what to estimate; None takes the largest model that
    the turns support and says in `missing` what a larger one needs. Raises NotSupported where the
    model asked for is beyond the turns, or no rest has a gyroscope mean.
    """
    bias = bias_from_rests(_distinct(turns, rests))
    if not turns:
        return _without_turns(bias, parameters)
    problem = _posed(turns, accel, settings or GyroscopeSettings())
    missing: tuple[str, ...] = ()
    for choice in (parameters,) if parameters else (Parameters.FULL9, Parameters.SCALE3):
        try:
            solution = _supported(problem, choice)
            return _reported(problem, solution, choice, bias=bias, gravity=gravity, missing=missing)
        except NotSupported as refusal:
            if parameters:
                raise
            missing = missing or refusal.missing
    return _reported(problem, _held(problem), Parameters.BIAS, bias=bias, gravity=gravity, missing=missing)


def residuals(turns: Sequence[Turn], accel: SensorModel, scale: Array, shift: Array | None = None) -> Array:
    """Angles between gravity carried through each turn and measured, (K,) rad: Eq. 15, for any turns.

    The bias is that of the rests around each turn, plus `shift`, (3,) rad/s.
    """
    problem = _posed(turns, accel, GyroscopeSettings())
    return problem.bundle.carry(scale, np.zeros(3) if shift is None else shift).angle


def _distinct(turns: Sequence[Turn], rests: Sequence[RestState]) -> list[RestState]:
    """All rests at hand once each, in time order."""
    ends = (r for turn in turns for r in (turn.before, turn.after))
    found = {(r.t_start, r.t_end): r for r in (*rests, *ends)}
    return [found[key] for key in sorted(found)]


def _posed(turns: Sequence[Turn], accel: SensorModel, settings: GyroscopeSettings) -> _Problem:
    """Take the bias of every turn from the rests at its ends and lay the turns out."""
    rests = Rests.of(turns, accel)
    mean, covariance, step = smoothed(rests.rests)
    halves = 0.5 * (np.eye(len(mean))[rests.before] + np.eye(len(mean))[rests.after])
    within = 0.25 * step[:, None, None] ** 2 * np.eye(len(turns))
    bundle = Bundle.of(turns, halves @ mean, rests)
    walk = bundle.durations() * _rate_density(rests.rests)
    return _Problem(rests, bundle, halves @ covariance @ halves.T + within, walk, settings)


def _rate_density(rests: Sequence[RestState]) -> float:
    """Variance of the integrated rate per second, rad^2/s: angle random walk, from rests' mean rates."""
    seen = [(r.duration, r.rate_uncertainty) for r in rests if r.rate_uncertainty is not None]
    return float(np.median([t * np.mean(u * u) for t, u in seen])) if seen else 0.0


def _supported(problem: _Problem, choice: Parameters) -> _Solution:
    """Solve where the turns can tell what is asked, before the fit and by its own residuals after."""
    if choice is Parameters.BIAS:
        return _held(problem)
    limit = problem.settings.max_uncertainty
    free = _FREE[choice]
    everything = np.full(len(problem.walk), True)
    slopes, misfit = problem.at(_NOMINAL, 0.0).whitened(everything)
    normal, _ = _normal_equations(slopes, misfit, _NOMINAL, problem.settings)
    _require_observed(_covariance(normal, free, 1.0), limit)
    solution = _solved(problem, free)
    _require_observed(solution.covariance, limit)
    return solution


def _held(problem: _Problem) -> _Solution:
    """Keep the nominal scale, seeking nothing."""
    everything = np.full(len(problem.walk), True)
    misfit = problem.at(_NOMINAL, 0.0).whitened(everything)[1]
    return _Solution(_NOMINAL, everything, np.zeros((12, 12)), float(misfit @ misfit) / misfit.size, 0)


def _without_turns(bias: BiasEstimate, parameters: Parameters | None) -> GyroscopeFit:
    """Report the bias alone. Raises NotSupported where a scale was asked for."""
    missing = tuple(_TURN_ABOUT.format(axis=axis) for axis in "xyz")
    if parameters not in {None, Parameters.BIAS}:
        raise NotSupported("there is no turn between two rests", missing)
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = bias.covariance
    return GyroscopeFit(
        model=SensorModel.of(np.eye(3), bias.bias),
        parameters=Parameters.BIAS,
        covariance=covariance,
        bias=bias,
        shift=np.zeros(3),
        shift_uncertainty=np.full(3, np.nan),
        before=np.zeros(0),
        after=np.zeros(0),
        rms_before=np.nan,
        rms_after=np.nan,
        gravity_rms_before=np.nan,
        gravity_rms_after=np.nan,
        rejected=(),
        turned=np.zeros(3),
        variance_factor=np.nan,
        iterations=0,
        missing=missing,
    )


def _reported(
    problem: _Problem,
    solution: _Solution,
    choice: Parameters,
    *,
    bias: BiasEstimate,
    gravity: float,
    missing: tuple[str, ...],
) -> GyroscopeFit:
    """Put a solution into the record that users see."""
    scale, shift = solution.theta[:9].reshape(3, 3), solution.theta[9:]
    covariance = solution.covariance.copy()
    covariance[9:], covariance[:, 9:] = 0.0, 0.0
    covariance[9:, 9:] = bias.covariance
    before = problem.at(_NOMINAL, 0.0).carried.angle
    after = problem.at(solution.theta, 0.0).carried.angle
    used = solution.used
    rms_before, rms_after = (float(np.sqrt(np.mean(a[used] ** 2))) for a in (before, after))
    return GyroscopeFit(
        model=SensorModel.of(scale, bias.bias),
        parameters=choice,
        covariance=covariance,
        bias=bias,
        shift=shift,
        shift_uncertainty=np.sqrt(np.diag(solution.covariance)[9:]),
        before=before,
        after=after,
        rms_before=rms_before,
        rms_after=rms_after,
        gravity_rms_before=gravity * rms_before,
        gravity_rms_after=gravity * rms_after,
        rejected=tuple(np.flatnonzero(~used).tolist()),
        turned=problem.bundle.path()[used].sum(axis=0),
        variance_factor=solution.variance_factor,
        iterations=solution.iterations,
        missing=missing,
    )


def _solved(problem: _Problem, free: Mask) -> _Solution:
    """Gauss-Newton on Eq. 15, weighted, leaving out turns that nothing fits. free: (12,).

    A wrong start is allowed for by a variance that grows with the angle turned and shrinks with every
    iteration, so that long turns, which may wrap around, speak last.
    """
    settings = problem.settings
    theta = _NOMINAL.copy()
    allowance = settings.nominal_error
    for _iteration in range(1, settings.max_iterations + 1):
        system = problem.at(theta, allowance)
        used = _inliers(system.lengths(), int(free[:9].sum()), settings.outlier)
        slopes, misfit = system.whitened(used)
        normal, gradient = _normal_equations(slopes, misfit, theta, settings)
        step = np.linalg.solve(normal[np.ix_(free, free)], -gradient[free])
        theta[free] += step
        if allowance == 0.0 and np.abs(step[:-3]).max(initial=0.0) < settings.tolerance:
            break
        allowance = allowance * _SHRINK if allowance > _NEGLIGIBLE else 0.0
    else:
        raise NotSupported(f"the gyroscope fit did not settle in {settings.max_iterations} iterations")
    freedom = max(2 * int(used.sum()) - int(free[:9].sum()), 1)
    factor = float(misfit @ misfit + (theta[9:] @ theta[9:]) * settings.bias_shift**-2) / freedom
    return _Solution(theta, used, _covariance(normal, free, factor), factor, _iteration)


def _inliers(lengths: Array, n_scale: int, limit: float) -> Mask:
    """Tell which turns stay within the limit, in robust standard deviations."""
    freedom = max(2 * len(lengths) - n_scale, 1) / (2 * len(lengths))
    spread = max(1.0, float(np.median(lengths)) / (_MEDIAN_RAYLEIGH * np.sqrt(freedom)))
    inside: Mask = lengths <= limit * spread
    return inside


def _normal_equations(
    slopes: Array, misfit: Array, theta: Array, settings: GyroscopeSettings
) -> tuple[Array, Array]:
    """Information (12, 12) and gradient (12,), with what is known of the shift beforehand."""
    prior = np.concatenate((np.zeros(9), np.full(3, settings.bias_shift**-2)))
    return slopes.T @ slopes + np.diag(prior), slopes.T @ misfit + prior * theta


def _covariance(normal: Array, free: Mask, factor: float) -> Array:
    """Covariance (12, 12), zero for what is held; an element nothing observes gets a variance of 1."""
    weak = np.diag(np.concatenate((np.ones(9), np.zeros(3))))
    out = np.zeros((12, 12))
    inside = np.ix_(free, free)
    out[inside] = max(1.0, factor) * np.linalg.inv((normal + weak)[inside])
    return out


def _require_observed(covariance: Array, limit: float) -> None:
    """Raise NotSupported naming the axes whose column of the scale is not observed well enough."""
    uncertain = np.sqrt(np.diag(covariance)[:9]).reshape(3, 3).max(axis=0)
    if (uncertain > limit).any():
        axes = [axis for axis, u in zip("xyz", uncertain, strict=True) if u > limit]
        raise NotSupported(
            f"the turns leave the gyroscope's {' and '.join(axes)} scale uncertain by {uncertain.max():.2g}",
            [_TURN_ABOUT.format(axis=axis) for axis in axes],
        )
