"""The Levenberg-Marquardt method for least squares, in place of Grammenos et al. 2018, Eq. 6-8.

Eq. 6 shortens every step by one factor, delta < 1. That either wastes steps near the optimum or does not damp
enough far from it. The damping here grows when a step would raise the cost and shrinks when a step lowers it
(Marquardt 1963). The Hessian is that of Gauss-Newton, J^T J.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.ranges import check_ranges

Residuals = Callable[[Array], tuple[Array, Array]]
"""v (p,) -> residuals (n,) and their Jacobian (n, p)."""


@dataclass(frozen=True, slots=True)
class Damping:
    """How steps are damped and when they end.

    start: damping of the first step, relative to the Hessian's diagonal. fade, grow: factors on the damping
    after a step that lowered the cost, and after one that would have raised it (Marquardt's 10). most: at
    this damping no step helps any more. tolerance: epsilon of Eq. 8. floor: a parameter smaller than this
    counts as this large in Eq. 8. iterations: largest number of steps tried.
    """

    start: float = 1e-3
    fade: float = 0.1
    grow: float = 10.0
    most: float = 1e10
    tolerance: float = 1e-6
    floor: float = 1e-6
    iterations: int = 200

    def __post_init__(self) -> None:
        allowed = {
            "start": (0.0, 1e3),
            "fade": (0.0, 1.0),
            "grow": (1.0, 1e6),
            "most": (1.0, 1e16),
            "tolerance": (1e-15, 1e-2),
            "floor": (0.0, 1.0),
            "iterations": (1, 100_000),
        }
        check_ranges(self, allowed)


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """The result: v (p,), residuals (n,), jacobian (n, p), number of steps tried, and whether Eq. 8 holds."""

    v: Array
    residuals: Array
    jacobian: Array
    iterations: int
    converged: bool


def minimise(function: Residuals, start: Array, settings: Damping) -> Minimum:
    """Minimise the sum of squares of the residuals of `function`, from `start` (p,), which is not changed.

    No error is raised where it does not converge; the result says so.
    """
    v, damping = start, settings.start
    residuals, jacobian = function(v)
    cost = float(residuals @ residuals)
    for iteration in range(1, settings.iterations + 1):
        hessian = jacobian.T @ jacobian
        step = _step(hessian, jacobian.T @ residuals, damping)
        trial = v + step
        new_residuals, new_jacobian = function(trial)
        new_cost = float(new_residuals @ new_residuals)
        settled = damping <= settings.start and _settled(v, trial, hessian, cost, settings)
        if settled and not new_cost < cost:
            return Minimum(v, residuals, jacobian, iteration, True)
        if new_cost > cost * (1.0 + 1e-12) or not np.isfinite(new_cost):
            damping = max(damping, 1e-12) * settings.grow
            if damping > settings.most:
                return Minimum(v, residuals, jacobian, iteration, True)
            continue
        v, residuals, jacobian, cost = trial, new_residuals, new_jacobian, new_cost
        if settled:
            return Minimum(v, residuals, jacobian, iteration, True)
        damping *= settings.fade
    return Minimum(v, residuals, jacobian, settings.iterations, False)


def _step(hessian: Array, gradient: Array, damping: float) -> Array:
    """Return the step of Eq. 6, (p,), with Marquardt's damping in place of the constant delta."""
    damped = hessian.copy()
    damped.flat[:: len(hessian) + 1] += damping * hessian.diagonal()
    try:
        return np.asarray(-np.linalg.solve(damped, gradient), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(-np.linalg.lstsq(damped, gradient, rcond=None)[0], dtype=np.float64)


def _settled(old: Array, new: Array, hessian: Array, cost: float, settings: Damping) -> bool:
    """Tell whether Eq. 8 holds, made safe where a parameter passes through zero.

    As printed, the change is taken relative to the parameter's own mean, which no true zero can satisfy. Here
    a change below a fraction epsilon of the parameter's standard error is enough, too.
    """
    size = np.maximum(np.abs(old + new) / 2.0, settings.floor)
    spread = np.sqrt(cost / np.maximum(hessian.diagonal(), np.finfo(float).tiny))
    return bool(np.all(np.abs(new - old) < settings.tolerance * np.maximum(size, spread)))
