"""The solver of the gyroscope's fit: weighted Gauss-Newton on Eq. 15 of Grammenos et al. 2018.

It leaves out rotation segments that no parameters fit and returns the parameters with their covariance.
Parameters are theta (12,): the scale, row by row, then one shift of the bias, rad/s, common to all segments.
The public fit is fit.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.gyroscope.bias import rest_rates
from stillcal.calib_core.gyroscope.bias_trajectory import BiasTrajectory
from stillcal.calib_core.gyroscope.gravity_propagation import Bundle, PropagatedGravity, Rests
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegment
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState

Mask = NDArray[np.bool_]

TURN_ABOUT = "a few turns about {axis} with {axis} level, from rest to rest"
"""What to gather for an axis. It is part of a record, hence of a calibration's identifier: do not reword."""
NOMINAL = np.concatenate((np.eye(3).ravel(), np.zeros(3)))
"""The parameters of an ideal gyroscope: scale 1, row by row, then no shift of the bias."""

_MEDIAN_RAYLEIGH = np.sqrt(2.0 * np.log(2.0))  # median length of a standard normal 2-vector
_SHRINK = 0.1  # factor on the allowance for a wrong start in each iteration
_NEGLIGIBLE = 2e-3  # an allowance below this is dropped: it is less than max_uncertainty
_ROUGH = 1e-3  # step of the scale that ends the first search; force along the segments is not known better
_FINEST = 1e-6  # rad; no segment is integrated more accurately, however little noise the rests claim
_IMPLAUSIBLE = 0.5  # a scale element this far from its nominal value: the search went astray


class Parameters(StrEnum):
    """What is estimated: the bias alone, also the three scale factors, or also all nine scale elements."""

    BIAS = "bias"
    SCALE3 = "scale3"
    FULL9 = "full9"


_FREE = {
    Parameters.SCALE3: np.concatenate((np.eye(3, dtype=bool).ravel(), np.full(3, True))),
    Parameters.FULL9: np.full(12, True),
}
"""Which of the parameters (12,), scale row by row and shift, each choice estimates."""


@dataclass(frozen=True, slots=True)
class GyroscopeSettings:
    """How the fit is made and when it is refused.

    nominal_error: how far the scale may be off at the start. bias_shift: rad/s, prior standard deviation of
    the bias during rotation less that at rest (what a 16-bit word over 2000 deg/s rounds off where no noise
    dithers it). g_sensitivity: (rad/s)/(m/s^2), prior standard deviation of an element of the gyroscope's
    sensitivity to force (0.1 deg/s per g). max_uncertainty: largest standard uncertainty of a scale element
    that still counts as observed. outlier: robust standard deviations beyond which a segment is left out.
    tolerance: step of the scale that ends the iteration. max_iterations: of each search.
    """

    nominal_error: float = 0.15
    bias_shift: float = 3e-4
    g_sensitivity: float = 1.8e-4
    max_uncertainty: float = 0.005
    outlier: float = 4.5
    tolerance: float = 1e-7
    max_iterations: int = 50

    def __post_init__(self) -> None:
        for name in ("nominal_error", "bias_shift", "g_sensitivity", "max_uncertainty", "tolerance"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ValueError(f"{name} is {getattr(self, name)}: it must lie between 0 and 1")
        if not self.outlier >= 2.0:
            raise ValueError(f"outlier is {self.outlier}: it must be at least 2")
        if self.max_iterations < 1:
            raise ValueError(f"max_iterations is {self.max_iterations}: it must be at least 1")


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What stays the same while the scale is estimated.

    bias: its trajectory as the rests show it. bias_covariance: (3, K, K) of the segments' biases.
    random_walk: (K,) rad^2, what the rate's noise adds up to over each segment.
    """

    segments: Sequence[RotationSegment]
    rests: Rests
    bundle: Bundle
    bias: BiasTrajectory
    bias_covariance: Array
    random_walk: Array
    settings: GyroscopeSettings

    @classmethod
    def of(
        cls, segments: Sequence[RotationSegment], accel: SensorModel, settings: GyroscopeSettings
    ) -> Problem:
        """Pose the problem; the force during a segment is first taken to be the mean of its two rests."""
        rests = Rests.of(segments, accel)
        bias = BiasTrajectory.of(*rest_rates(rests.rests), rests.forces, settings.g_sensitivity)
        mean = 0.5 * (rests.forces[rests.before] + rests.forces[rests.after])
        return _posed(segments, rests, bias, list(mean[:, None]), settings)

    def along(self, theta: Array) -> Problem:
        """Pose the problem anew with the force during each segment as parameters (12,) propagate it."""
        up = self.bundle.up_along(theta[:9].reshape(3, 3), theta[9:])
        norms = np.linalg.norm(self.rests.forces[self.rests.before], axis=1)
        along = [norm * u for norm, u in zip(norms, up, strict=True)]
        return _posed(self.segments, self.rests, self.bias, along, self.settings)

    def at(self, theta: Array, allowance: float) -> System:
        """Linearise at parameters (12,), for a scale that may still be wrong by `allowance`."""
        propagated = self.bundle.propagate(theta[:9].reshape(3, 3), theta[9:])
        covariance = propagated.covariance(self.rests, self.bias_covariance, self.random_walk)
        still_wrong = allowance * np.linalg.norm(self.bundle.path(), axis=1)
        covariance[np.diag_indices_from(covariance)] += np.repeat(still_wrong**2, 2)
        slopes = np.concatenate((propagated.scale_slopes, propagated.bias_slopes), axis=2)
        return System(propagated, slopes, covariance)


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """The problem linearised at one point. slopes: (K, 2, 12); covariance: (2 K, 2 K) rad^2."""

    propagated: PropagatedGravity
    slopes: Array
    covariance: Array

    def lengths(self) -> Array:
        """Return each segment's residual in standard deviations, (K,)."""
        k = len(self.slopes)
        own = self.covariance.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k)]
        r = self.propagated.residuals
        squared: Array = np.einsum("ki,ki->k", r, np.linalg.solve(own, r[..., None])[..., 0])
        return np.sqrt(squared)

    def whitened(self, used: Mask) -> tuple[Array, Array]:
        """Return slopes (2 K', 12) and residuals (2 K',) of the K' segments used, whitened."""
        rows = np.repeat(used, 2)
        root = np.linalg.cholesky(self.covariance[np.ix_(rows, rows)])
        both = np.column_stack((self.slopes.reshape(-1, 12), self.propagated.residuals.ravel()))
        white: Array = np.linalg.solve(root, both[rows])
        return white[:, :12], white[:, 12]


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The result of a search.

    theta: (12,) scale row by row and shift. used: (K,) segments used. covariance: (12, 12). variance_factor:
    squared residuals over what their uncertainties promise.
    """

    theta: Array
    used: Mask
    covariance: Array
    variance_factor: float
    iterations: int


def solve(problem: Problem, choice: Parameters) -> tuple[Problem, Solution]:
    """Estimate the scale; return the problem as finally posed and the solution. Raises NotSupported.

    The segments must determine the parameters both beforehand, by their directions and uncertainties, and
    afterwards, by their residuals. The first search gives the force during each segment to the second one.
    """
    if choice is Parameters.BIAS:
        return problem, nominal(problem)
    free, limit = _FREE[choice], problem.settings.max_uncertainty
    slopes, residuals = problem.at(NOMINAL, 0.0).whitened(np.full(len(problem.segments), True))
    normal, _ = _normal_equations(slopes, residuals, NOMINAL, problem.settings)
    _require_observed(_covariance(normal, free, 1.0), limit)
    settings = problem.settings
    rough = _searched(problem, free, NOMINAL, settings.nominal_error, _ROUGH)
    refined = problem.along(rough.theta)
    solution = _searched(refined, free, rough.theta, 0.0, settings.tolerance)
    _require_plausible(solution.theta)
    _require_observed(solution.covariance, limit)
    return refined, replace(solution, iterations=rough.iterations + solution.iterations)


def nominal(problem: Problem) -> Solution:
    """Return the nominal scale as a solution, without estimating anything."""
    everything = np.full(len(problem.segments), True)
    residuals = problem.at(NOMINAL, 0.0).whitened(everything)[1]
    return Solution(NOMINAL, everything, np.zeros((12, 12)), float(residuals @ residuals) / residuals.size, 0)


def _posed(
    segments: Sequence[RotationSegment],
    rests: Rests,
    bias: BiasTrajectory,
    along: Sequence[Array],
    settings: GyroscopeSettings,
) -> Problem:
    """Pose the problem with the bias of every segment taken off.

    along: for each segment the force during it, (n, 3) or (1, 3) m/s^2, which adds to its bias.
    """
    mean_force = np.array([force.mean(axis=0) for force in along])
    walk, covariance = bias.between(rests.before, rests.after, mean_force)
    biases = [w + force @ bias.sensitivity.T for w, force in zip(walk, along, strict=True)]
    bundle = Bundle.of(segments, biases, rests)
    random_walk = bundle.durations() * _rate_density(rests.rests) + _FINEST**2
    return Problem(segments, rests, bundle, bias, covariance, random_walk, settings)


def _rate_density(rests: Sequence[RestState]) -> float:
    """Return the variance of the integrated rate per second, rad^2/s, from the rests' mean rates."""
    known = [(r.duration, r.rate_uncertainty) for r in rests if r.rate_uncertainty is not None]
    return float(np.median([t * np.mean(u * u) for t, u in known])) if known else 0.0


def _searched(problem: Problem, free: Mask, start: Array, allowance: float, tolerance: float) -> Solution:
    """Minimise Eq. 15 by weighted Gauss-Newton, without segments that no parameters fit. free, start: (12,).

    A start wrong by `allowance` is allowed for by a variance that grows with the angle turned and shrinks
    with every iteration, so that long segments, which may wrap around, gain weight last. Once no allowance is
    left, a segment that was left out stays out, so that none can alternate for ever.
    """
    settings = problem.settings
    theta = start.copy()
    used = np.full(len(problem.segments), True)
    for _iteration in range(1, settings.max_iterations + 1):
        system = problem.at(theta, allowance)
        inside = _inliers(system.lengths(), int(free[:9].sum()), settings.outlier)
        used = inside if allowance > 0.0 else inside & used
        slopes, residuals = system.whitened(used)
        normal, gradient = _normal_equations(slopes, residuals, theta, settings)
        step = np.linalg.solve(normal[np.ix_(free, free)], -gradient[free])
        theta[free] += step
        if allowance == 0.0 and np.abs(step[:-3]).max(initial=0.0) < tolerance:
            break
        allowance = allowance * _SHRINK if allowance > _NEGLIGIBLE else 0.0
    else:
        raise NotSupported(f"the gyroscope fit did not settle in {settings.max_iterations} iterations")
    freedom = max(2 * int(used.sum()) - int(free[:9].sum()), 1)
    factor = float(residuals @ residuals + (theta[9:] @ theta[9:]) * settings.bias_shift**-2) / freedom
    return Solution(theta, used, _covariance(normal, free, factor), factor, _iteration)


def _inliers(lengths: Array, n_scale: int, limit: float) -> Mask:
    """Tell which segments' residuals, (K,), stay within `limit` robust standard deviations."""
    freedom = max(2 * len(lengths) - n_scale, 1) / (2 * len(lengths))
    spread = max(1.0, float(np.median(lengths)) / (_MEDIAN_RAYLEIGH * np.sqrt(freedom)))
    inside: Mask = lengths <= limit * spread
    return inside


def _normal_equations(
    slopes: Array, residuals: Array, theta: Array, settings: GyroscopeSettings
) -> tuple[Array, Array]:
    """Return the information (12, 12) and the gradient (12,), with the prior on the shift."""
    prior = np.concatenate((np.zeros(9), np.full(3, settings.bias_shift**-2)))
    return slopes.T @ slopes + np.diag(prior), slopes.T @ residuals + prior * theta


def _covariance(normal: Array, free: Mask, factor: float) -> Array:
    """Return the covariance (12, 12), 0 for fixed parameters; an unobserved element has variance 1."""
    weak = np.diag(np.concatenate((np.ones(9), np.zeros(3))))
    out = np.zeros((12, 12))
    inside = np.ix_(free, free)
    out[inside] = max(1.0, factor) * np.linalg.inv((normal + weak)[inside])
    return out


def _require_plausible(theta: Array) -> None:
    """Raise NotSupported where the scale cannot be that of a working gyroscope."""
    furthest = float(np.abs(theta - NOMINAL)[:9].max())
    if not furthest < _IMPLAUSIBLE:
        raise NotSupported(
            f"the gyroscope's fitted scale is {furthest:.2g} off its nominal value",
            ["rates in rad/s", "turns that end in rest"],
        )


def _require_observed(covariance: Array, limit: float) -> None:
    """Raise NotSupported with the axes whose column of the scale is not observed well enough."""
    uncertain = np.sqrt(np.diag(covariance)[:9]).reshape(3, 3).max(axis=0)
    if (uncertain > limit).any():
        axes = [axis for axis, u in zip("xyz", uncertain, strict=True) if u > limit]
        raise NotSupported(
            f"the gyroscope's {' and '.join(axes)} scale stays uncertain by {uncertain.max():.2g}",
            [TURN_ABOUT.format(axis=axis) for axis in axes],
        )
