"""Accelerometer calibration from rests whose attitudes nobody knows (Grammenos et al. 2018, 4.2).

calibrated = scale @ (raw - bias) such that every rest has gravity's norm. The cost is that of Eq. 5, each
squared-norm difference weighted by its rest's own uncertainty and by what rests are found to scatter
besides; the steps are Eq. 6-8 (damped.py). Rests that share an attitude count once together. Which model
the attitudes support is judged in attitudes.py; known attitudes are fitted in sixface.py.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stillcal.calib_core.accelerometer import observability as attitudes
from stillcal.calib_core.accelerometer.equations import Solution, solve
from stillcal.calib_core.accelerometer.parameters import Form, basis, names
from stillcal.calib_core.accelerometer.result import AccelerometerFit, Dropped
from stillcal.calib_core.accelerometer.task import AccelerometerSettings, AttitudesMissing, Task, task_of
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths import random_effects as excess
from stillcal.calib_core.maths.student_t import quantile
from stillcal.calib_core.model import SensorModel

__all__ = ["AccelerometerFit", "AccelerometerSettings", "AttitudesMissing", "Parameters", "fit"]

Parameters = Literal["auto", 6, 9, 12]


_DEFAULT = AccelerometerSettings()


def fit(
    forces: ArrayLike,
    uncertainties: ArrayLike | None,
    gravity: ArrayLike,
    gravity_uncertainty: float = 0.0,
    *,
    parameters: Parameters = "auto",
    form: Form = "symmetric",
    settings: AccelerometerSettings = _DEFAULT,
) -> AccelerometerFit:
    """Fit bias and scale to rests of unknown attitude.

    forces: (n, 3) mean raw specific forces, m/s^2. uncertainties: (n, 3) standard uncertainties, or None to
    weigh all rests alike. gravity: m/s^2, one value or (n,) where the place changed; gravity_uncertainty:
    its standard uncertainty, common to all rests. parameters: "auto" takes the largest model that the
    attitudes support. Raises AttitudesMissing (a NotSupported) where they do not support it, or not even 6;
    NotSupported where the outcome is no phone's accelerometer; ValueError on arrays that do not fit.

    A sensor with bias and 1 % of scale in eighteen attitudes:

    >>> up = attitudes.places()[:18]
    >>> raw = 9.81 * up @ np.diag([1 / 1.01, 1.0, 1 / 0.99]) + [0.3, -0.2, 0.1]
    >>> found = fit(raw, None, gravity=9.81)
    >>> found.parameters, found.model.bias.round(6).tolist()
    (9, [0.3, -0.2, 0.1])
    >>> np.diag(found.model.scale).round(6).tolist()
    [1.01, 1.0, 0.99]
    """
    if parameters != "auto":
        return _fit(task_of(forces, uncertainties, gravity, gravity_uncertainty, parameters, form, settings))
    try:
        task = task_of(forces, uncertainties, gravity, gravity_uncertainty, 9, form, settings)
        return _fit(replace(task, least=9 + settings.spare_attitudes))
    except AttitudesMissing:
        return _fit(task_of(forces, uncertainties, gravity, gravity_uncertainty, 6, form, settings))


def _fit(task: Task) -> AccelerometerFit:
    """Fit one model or raise AttitudesMissing."""
    _require_support(task)
    used, solution = _robust(task)
    _require_plausible(task, solution)
    found = _report(task, solution, used)
    worst, limit = found.worst_norm_uncertainty, task.settings.max_norm_sd
    if worst > limit:
        wanted = attitudes.most_helpful_attitude(task.norms.only(used).directions(), task.parameters)
        reason = f"{task.parameters} parameters would leave {worst:.2g} m/s^2 open along the worst direction"
        raise AttitudesMissing(f"{reason}, more than {limit:g}", (wanted,))
    return found


def _require_support(task: Task) -> None:
    if task.supported_by(task.norms, task.least):
        return
    up, limit = task.norms.directions(), task.settings.max_amplification
    reason = f"{len(up)} distinct attitudes do not support {task.parameters} parameters"
    if len(up) >= task.least:
        worst = attitudes.amplification(up, task.parameters)
        reason += f": the worst direction would be known {worst:.3g} times worse than a rest measures it"
        reason += f", the limit is {limit:g}"
    wanted = attitudes.missing_attitudes(up, task.parameters, limit, task.least)
    raise AttitudesMissing(reason, wanted)


def _robust(task: Task) -> tuple[NDArray[np.bool_], Solution]:
    """Fit, drop what does not belong as long as the model stays supported, and fit again."""
    damping, rounds = task.settings.damping, task.settings.rounds
    solution = solve(task.norms, damping, rounds)
    used = _without(task, _suspects(task, solution))
    if used.all():
        return used, solution
    solution = solve(task.norms.only(used), damping, rounds, solution.v)
    again = used | _explained(task, solution, int(used.sum()))
    if np.array_equal(again, used):
        return used, solution
    return again, solve(task.norms.only(again), damping, rounds, solution.v)


def _suspects(task: Task, solution: Solution) -> list[int]:
    """Return the rests that do not belong, worst first.

    Where the attitudes determine nine parameters, a rest that nine would explain is not a bad one, though
    six be fitted: what a smaller model leaves over is its own want, not the rest's.
    """
    if task.settings.outlier_level == 0.0:
        return []
    residuals, jacobian = task.norms.residuals(solution.v)
    if np.isfinite(attitudes.amplification(task.norms.directions(), 9)):
        richer = replace(task.norms, matrix=basis(9, task.form))
        jacobian = richer.residuals(np.linalg.pinv(richer.matrix) @ task.norms.matrix @ solution.v)[1]
    most = int(task.settings.max_outliers * len(residuals))
    variances = solution.variances(task.norms)
    return excess.outliers(residuals, jacobian, variances, most, task.settings.outlier_level)


def _without(task: Task, rows: list[int]) -> NDArray[np.bool_]:
    """Drop rows, worst first, each only if what is left still supports the model."""
    used = np.ones(len(task.local), dtype=bool)
    for row in rows:
        used[row] = False
        if not task.supported_by(task.norms.only(used), task.least):
            used[row] = True
    return used


def _explained(task: Task, solution: Solution, fitted: int) -> NDArray[np.bool_]:
    """Tell which rests the fitted ones explain, given the scatter that these show among themselves."""
    residuals, jacobian = task.norms.residuals(solution.v)
    predicted = np.einsum("ij,jk,ik->i", jacobian, solution.covariance, jacobian)
    free = max(fitted - jacobian.shape[1], 1)
    limit = quantile(free, 1.0 - task.settings.outlier_level / (2.0 * len(residuals)))
    sd = np.sqrt(solution.variances(task.norms) + predicted)
    return np.asarray(np.abs(residuals) <= limit * sd, dtype=np.bool_)


def _require_plausible(task: Task, solution: Solution) -> None:
    settings = task.settings
    model = _model(task, solution)
    bias = float(np.abs(model.bias).max())
    error = float(np.abs(np.linalg.svd(model.scale, compute_uv=False) - 1.0).max())
    if not solution.converged:
        raise NotSupported("the fit did not converge", ["rests in more attitudes"])
    if bias > settings.max_bias or error > settings.max_scale_error:
        reason = f"no phone's accelerometer: a bias of {bias:.2g} m/s^2 and a scale off by {error:.0%}"
        raise NotSupported(reason, ["rests, in m/s^2, of a phone that lies still"])


def _model(task: Task, solution: Solution) -> SensorModel:
    twelve = task.norms.matrix @ solution.v
    return SensorModel.of(twelve[3:].reshape(3, 3), task.g * twelve[:3])


def _covariance(task: Task, solution: Solution) -> Array:
    """Return the covariance of the model's own parameters, (p, p), in m/s^2 and 1."""
    units = np.r_[np.full(3, task.g), np.ones(9)]
    spread = np.linalg.pinv(basis(task.parameters, task.form)) @ (task.norms.matrix * units[:, None])
    return frozen(spread @ solution.covariance @ spread.T)


def _degrees_of_freedom(solution: Solution, rests: int, states: int) -> float:
    """Return on how many degrees of freedom the covariance rests; see AccelerometerFit."""
    if solution.between > 0.0:
        return float(states - len(solution.v))
    return float(rests - states) if solution.within > 0.0 else float("inf")


def _report(task: Task, solution: Solution, used: NDArray[np.bool_]) -> AccelerometerFit:
    """Put a solution in m/s^2 and beside it what a reader needs to judge it."""
    model, kept = _model(task, solution), task.norms.only(used)
    residuals = np.linalg.norm(model.apply(task.g * task.norms.raw), axis=1) - task.local
    states = int(kept.labels.max()) + 1
    return AccelerometerFit(
        model=model,
        parameters=task.parameters,
        form=task.form,
        names=names(task.parameters, task.form),
        covariance=_covariance(task, solution),
        degrees_of_freedom=_degrees_of_freedom(solution, len(kept.raw), states),
        coverage=attitudes.coverage(kept.directions(), task.parameters, task.form),
        residuals=frozen(residuals),
        rms_residual=float(np.sqrt(np.mean(residuals**2))),
        dropped=_dropped(residuals, used),
        n_rests=len(used),
        n_states=states,
        repeatability=_repeatability(residuals[used], kept.labels),
        excess_rest=task.g * float(np.sqrt(solution.within)),
        excess_attitude=task.g * float(np.sqrt(solution.between)),
        gravity=task.g,
        gravity_uncertainty=task.gravity_uncertainty,
        iterations=solution.iterations,
    )


def _repeatability(residuals: Array, labels: NDArray[np.intp]) -> float | None:
    """Return the sd of norms within an attitude, pooled over those held more than once; None without."""
    if labels.size == np.unique(labels).size:
        return None
    return float(np.sqrt(excess.within_variance(residuals, labels, np.zeros(labels.size))))


def _dropped(residuals: Array, used: NDArray[np.bool_]) -> tuple[Dropped, ...]:
    rows = np.flatnonzero(np.logical_not(used))
    why = "its norm is {:+.3g} m/s^2 off what the other rests agree on"
    return tuple(Dropped(int(row), why.format(residuals[row])) for row in rows)
