"""The search behind gyroscope.py: what stays fixed, what is sought, how well the turns tell it.

Weighted Gauss-Newton on Eq. 15 of Grammenos et al. 2018, turns that nothing fits left out, and the
uncertainty of what was found. What a user asks for and gets is gyroscope.py's.
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
NOMINAL = np.concatenate((np.eye(3).ravel(), np.zeros(3)))
"""The parameters before anything is known: scale 1, row by row, then no shift of the bias."""

_MEDIAN_RAYLEIGH = np.sqrt(2.0 * np.log(2.0))  # median length of a standard normal 2-vector
_SHRINK = 0.1  # of the allowance for a wrong start, per iteration
_NEGLIGIBLE = 2e-3  # allowance below which there is none
_ROUGH = 1e-3  # step of the scale that ends the first search; force along the turns is not known better
_FINEST = 1e-6  # rad; no turn is integrated better, however little noise the rests claim
_IMPLAUSIBLE = 0.5  # of a scale element off its nominal value: the search went astray


class Parameters(StrEnum):
    """What is estimated: the bias alone, with the three scale factors, or with all nine elements."""

    BIAS = "bias"
    SCALE3 = "scale3"
    FULL9 = "full9"


_FREE = {
    Parameters.SCALE3: np.concatenate((np.eye(3, dtype=bool).ravel(), np.full(3, True))),
    Parameters.FULL9: np.full(12, True),
}


_FREE = {
    Parameters.SCALE3: np.concatenate((np.eye(3, dtype=bool).ravel(), np.full(3, True))),
    Parameters.FULL9: np.full(12, True),
}


@dataclass(frozen=True, slots=True)
class GyroscopeSettings:
    """How the fit is made and when it is refused.

    nominal_error: how far the scale may be off at first. bias_shift: rad/s, typical difference of the
    bias while turning from that at rest (what a 16-bit word over 2000 deg/s rounds off where no noise
    dithers it). g_sensitivity: (rad/s)/(m/s^2), typical element of the gyroscope's response to force
    (0.1 deg/s per g). max_uncertainty: largest standard uncertainty of a scale element that still counts
    as observed. outlier: robust standard deviations beyond which a turn is left out. tolerance: of the
    scale, ends the iteration.
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
    """What stays the same while the scale is sought.

    bias: what the rests say of it. bias_covariance: (3, K, K) of the turns' biases. random_walk: (K,)
    rad^2, what the rate's noise adds up to over each turn.
    """

    turns: Sequence[RotationSegment]
    rests: Rests
    bundle: Bundle
    bias: BiasTrajectory
    bias_covariance: Array
    random_walk: Array
    settings: GyroscopeSettings

    @classmethod
    def of(cls, turns: Sequence[RotationSegment], accel: SensorModel, settings: GyroscopeSettings) -> Problem:
        """Pose the problem; force along a turn is at first taken for the mean of its two rests."""
        rests = Rests.of(turns, accel)
        bias = BiasTrajectory.of(*rest_rates(rests.rests), rests.forces, settings.g_sensitivity)
        mean = 0.5 * (rests.forces[rests.before] + rests.forces[rests.after])
        return _posed(turns, rests, bias, list(mean[:, None]), settings)

    def along(self, theta: Array) -> Problem:
        """Pose it anew with gravity's force along each turn as these parameters (12,) carry it."""
        up = self.bundle.up_along(theta[:9].reshape(3, 3), theta[9:])
        norms = np.linalg.norm(self.rests.forces[self.rests.before], axis=1)
        along = [norm * u for norm, u in zip(norms, up, strict=True)]
        return _posed(self.turns, self.rests, self.bias, along, self.settings)

    def at(self, theta: Array, allowance: float) -> System:
        """Residuals, slopes and covariance at parameters (12,), the scale still wrong by `allowance`."""
        propagated = self.bundle.propagate(theta[:9].reshape(3, 3), theta[9:])
        covariance = propagated.covariance(self.rests, self.bias_covariance, self.random_walk)
        still_wrong = allowance * np.linalg.norm(self.bundle.path(), axis=1)
        covariance[np.diag_indices_from(covariance)] += np.repeat(still_wrong**2, 2)
        slopes = np.concatenate((propagated.scale_slopes, propagated.bias_slopes), axis=2)
        return System(propagated, slopes, covariance)


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """The problem made linear at one point. slopes: (K, 2, 12); covariance: (2 K, 2 K) rad^2."""

    propagated: PropagatedGravity
    slopes: Array
    covariance: Array

    def lengths(self) -> Array:
        """Each turn's residual in standard deviations, (K,)."""
        k = len(self.slopes)
        own = self.covariance.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k)]
        r = self.propagated.residuals
        squared: Array = np.einsum("ki,ki->k", r, np.linalg.solve(own, r[..., None])[..., 0])
        return np.sqrt(squared)

    def whitened(self, used: Mask) -> tuple[Array, Array]:
        """Slopes (2 K', 12) and residuals (2 K',) of the turns used, independent and of unit variance."""
        rows = np.repeat(used, 2)
        root = np.linalg.cholesky(self.covariance[np.ix_(rows, rows)])
        both = np.column_stack((self.slopes.reshape(-1, 12), self.propagated.residuals.ravel()))
        white: Array = np.linalg.solve(root, both[rows])
        return white[:, :12], white[:, 12]


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where the search ended. theta: (12,) scale row by row and shift; covariance: (12, 12)."""

    theta: Array
    used: Mask
    covariance: Array
    variance_factor: float
    iterations: int


def solve(problem: Problem, choice: Parameters) -> tuple[Problem, Solution]:
    """Find the scale; returns it with the problem as finally posed. Raises NotSupported.

    The turns must tell what is asked both beforehand, going by their directions and uncertainties, and
    afterwards, going by their residuals. The second search knows how gravity ran along each turn.
    """
    if choice is Parameters.BIAS:
        return problem, held(problem)
    free, limit = _FREE[choice], problem.settings.max_uncertainty
    slopes, misfit = problem.at(NOMINAL, 0.0).whitened(np.full(len(problem.turns), True))
    normal, _ = _normal_equations(slopes, misfit, NOMINAL, problem.settings)
    _require_observed(_covariance(normal, free, 1.0), limit)
    settings = problem.settings
    rough = _searched(problem, free, NOMINAL, settings.nominal_error, _ROUGH)
    refined = problem.along(rough.theta)
    solution = _searched(refined, free, rough.theta, 0.0, settings.tolerance)
    _require_plausible(solution.theta)
    _require_observed(solution.covariance, limit)
    return refined, replace(solution, iterations=rough.iterations + solution.iterations)


def held(problem: Problem) -> Solution:
    """Keep the nominal scale, seeking nothing."""
    everything = np.full(len(problem.turns), True)
    misfit = problem.at(NOMINAL, 0.0).whitened(everything)[1]
    return Solution(NOMINAL, everything, np.zeros((12, 12)), float(misfit @ misfit) / misfit.size, 0)


def _posed(
    turns: Sequence[RotationSegment],
    rests: Rests,
    bias: BiasTrajectory,
    along: Sequence[Array],
    settings: GyroscopeSettings,
) -> Problem:
    """Take every turn's bias off, with what the force along it, (n, 3) or (1, 3), adds."""
    mean_force = np.array([force.mean(axis=0) for force in along])
    walk, covariance = bias.between(rests.before, rests.after, mean_force)
    biases = [w + force @ bias.sensitivity.T for w, force in zip(walk, along, strict=True)]
    bundle = Bundle.of(turns, biases, rests)
    random_walk = bundle.durations() * _rate_density(rests.rests) + _FINEST**2
    return Problem(turns, rests, bundle, bias, covariance, random_walk, settings)


def _rate_density(rests: Sequence[RestState]) -> float:
    """Variance of the integrated rate per second, rad^2/s: angle random walk, from rests' mean rates."""
    seen = [(r.duration, r.rate_uncertainty) for r in rests if r.rate_uncertainty is not None]
    return float(np.median([t * np.mean(u * u) for t, u in seen])) if seen else 0.0


def _searched(problem: Problem, free: Mask, start: Array, allowance: float, tolerance: float) -> Solution:
    """Gauss-Newton on Eq. 15, weighted, leaving out turns that nothing fits. free, start: (12,).

    A start wrong by `allowance` is allowed for by a variance that grows with the angle turned and shrinks
    with every iteration, so that long turns, which may wrap around, speak last. Once there is none left,
    a turn left out stays out, so that none can go in and out for ever.
    """
    settings = problem.settings
    theta = start.copy()
    used = np.full(len(problem.turns), True)
    for _iteration in range(1, settings.max_iterations + 1):
        system = problem.at(theta, allowance)
        inside = _inliers(system.lengths(), int(free[:9].sum()), settings.outlier)
        used = inside if allowance > 0.0 else inside & used
        slopes, misfit = system.whitened(used)
        normal, gradient = _normal_equations(slopes, misfit, theta, settings)
        step = np.linalg.solve(normal[np.ix_(free, free)], -gradient[free])
        theta[free] += step
        if allowance == 0.0 and np.abs(step[:-3]).max(initial=0.0) < tolerance:
            break
        allowance = allowance * _SHRINK if allowance > _NEGLIGIBLE else 0.0
    else:
        raise NotSupported(f"the gyroscope fit did not settle in {settings.max_iterations} iterations")
    freedom = max(2 * int(used.sum()) - int(free[:9].sum()), 1)
    factor = float(misfit @ misfit + (theta[9:] @ theta[9:]) * settings.bias_shift**-2) / freedom
    return Solution(theta, used, _covariance(normal, free, factor), factor, _iteration)


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


def _require_plausible(theta: Array) -> None:
    """Raise NotSupported where the scale found is no correction of a working gyroscope."""
    furthest = float(np.abs(theta - NOMINAL)[:9].max())
    if not furthest < _IMPLAUSIBLE:
        raise NotSupported(
            f"the gyroscope's scale came out {furthest:.2g} off its nominal value",
            ["rates in rad/s", "turns that end in rest"],
        )


def _require_observed(covariance: Array, limit: float) -> None:
    """Raise NotSupported naming the axes whose column of the scale is not observed well enough."""
    uncertain = np.sqrt(np.diag(covariance)[:9]).reshape(3, 3).max(axis=0)
    if (uncertain > limit).any():
        axes = [axis for axis, u in zip("xyz", uncertain, strict=True) if u > limit]
        raise NotSupported(
            f"the turns leave the gyroscope's {' and '.join(axes)} scale uncertain by {uncertain.max():.2g}",
            [TURN_ABOUT.format(axis=axis) for axis in axes],
        )
