"""Accelerometer calibration from rests whose attitudes nobody knows (Grammenos et al. 2018, 4.2).

calibrated = scale @ (raw - bias) such that every rest has gravity's norm. The cost is that of Eq. 5, each
squared-norm difference weighted by its rest's own uncertainty and by the scatter of rests beyond it. The
steps are Eq. 6-8 (maths/levenberg_marquardt.py). Rests that share an attitude count once together. Which
model the attitudes support is judged in observability.py; known attitudes are fitted in known_attitudes.py.
Attitudes that do not support all nine parameters can be fitted with a prior (prior.py).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stillcal.calib_core.accelerometer import observability
from stillcal.calib_core.accelerometer import prior as prior_fit
from stillcal.calib_core.accelerometer.equations import Norms, Solution, solve
from stillcal.calib_core.accelerometer.observability import Attitude
from stillcal.calib_core.accelerometer.parameters import Form, basis, inverse, names, variances_along
from stillcal.calib_core.accelerometer.prior import FleetPrior
from stillcal.calib_core.accelerometer.result import AccelerometerFit, Dropped
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths import random_effects
from stillcal.calib_core.maths.levenberg_marquardt import Damping
from stillcal.calib_core.maths.rms import rms
from stillcal.calib_core.maths.student_t import quantile
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.ranges import check_ranges
from stillcal.calib_core.static.rest import ATTITUDE_ANGLE, attitude_labels


@dataclass(frozen=True, slots=True)
class AccelerometerSettings:
    """What a fit requires of its rests, and how it proceeds.

    damping: of the Gauss-Newton steps. attitude_angle: rad, rests closer than this share an attitude.
    max_amplification: along the worst direction, the calibrated norm may be known this many times worse than
    one rest is measured. The default is the ratio of what an omitted 1 % of cross-axis sensitivity costs (a
    phone's MEMS datasheet figure; half of it, 0.05 m/s^2, along the worst direction) to the 0.01 m/s^2 by
    which a phone's rests scatter: beyond it, leaving the cross-axis terms out does less harm. max_norm_sd:
    m/s^2, the same cost as a bound on the result. spare_attitudes: "auto" takes more than 6 parameters only
    with this many more attitudes than parameters, so that the fit can be checked at all. outlier_level:
    probability of dropping any rest where none is bad; 0 drops none. max_outliers: largest fraction of rests
    dropped. max_bias, m/s^2, and max_scale_error: a fit beyond these is refused, as of no phone's
    accelerometer. rounds: of weighting anew. prior_attitudes: so many are needed with a prior.
    max_prior_sd: m/s^2, with a prior, the calibrated norm may be known so badly along the worst direction:
    half of what the prior of sound phones alone leaves.
    """

    damping: Damping = field(default_factory=Damping)
    attitude_angle: float = ATTITUDE_ANGLE
    max_amplification: float = 5.0
    max_norm_sd: float = 0.05
    spare_attitudes: int = 1
    outlier_level: float = 0.01
    max_outliers: float = 0.2
    max_bias: float = 5.0
    max_scale_error: float = 0.3
    rounds: int = 10
    prior_attitudes: int = 8
    max_prior_sd: float = 0.25

    def __post_init__(self) -> None:
        allowed = {
            "attitude_angle": (0.0, 1.0),
            "max_amplification": (1.0, np.inf),
            "max_norm_sd": (0.0, np.inf),
            "spare_attitudes": (0, 100),
            "outlier_level": (0.0, 0.5),
            "max_outliers": (0.0, 0.5),
            "max_bias": (0.0, np.inf),
            "max_scale_error": (0.0, 1.0),
            "rounds": (1, 1000),
            "prior_attitudes": (1, 1000),
            "max_prior_sd": (0.0, np.inf),
        }
        check_ranges(self, allowed)


class AttitudesMissing(NotSupported):
    """Refusal of a fit because the attitudes do not support the model; attitudes: those to add."""

    def __init__(self, reason: str, wanted: tuple[Attitude, ...]) -> None:
        super().__init__(reason, [a.words for a in wanted])
        self.attitudes = wanted


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """One model to be fitted to rests.

    least: number of distinct attitudes required. local: (n,) gravity of each rest's place, m/s^2.
    """

    norms: Norms
    parameters: int
    form: Form
    least: int
    local: Array
    gravity_uncertainty: float
    settings: AccelerometerSettings

    @property
    def g(self) -> float:
        """The unit of `norms`: mean gravity, m/s^2."""
        return float(self.local.mean())

    def supported_by(self, rests: Norms, least: int) -> bool:
        """Tell whether these rests' attitudes determine the model well enough."""
        up = rests.directions()
        if len(up) < least:
            return False
        return observability.amplification(up, self.parameters) <= self.settings.max_amplification


def task_of(  # noqa: PLR0917 - `fit`'s own arguments, in its order
    forces: ArrayLike,
    uncertainties: ArrayLike | None,
    gravity: ArrayLike,
    gravity_uncertainty: float,
    parameters: int,
    form: Form,
    settings: AccelerometerSettings,
) -> Task:
    """Check the arrays and put them in units of gravity.

    Raises ValueError on arrays that do not fit, NotSupported where they seem to be multiples of g, and
    AttitudesMissing where there is no rest.
    """
    raw = np.asarray(forces, dtype=np.float64).reshape(-1, 3) if np.size(forces) == 0 else np.asarray(forces)
    sd = np.zeros(raw.shape) if uncertainties is None else np.asarray(uncertainties, dtype=np.float64)
    _check_arrays(raw, sd.reshape(raw.shape) if raw.size == 0 else sd)
    local = np.array(np.broadcast_to(np.asarray(gravity, dtype=np.float64), len(raw)))
    if not (np.isfinite(local).all() and (local > 0.0).all() and gravity_uncertainty >= 0.0):
        raise ValueError("gravity must be positive and its uncertainty not negative")
    if len(raw) == 0:
        wanted = observability.missing_attitudes(raw, 6, settings.max_amplification, 6)
        raise AttitudesMissing("there is no rest", wanted)
    g = float(local.mean())
    _check_unit(raw, g)
    own_form: Form = "symmetric" if parameters == 12 else form
    labels = attitude_labels(raw, settings.attitude_angle)
    norms = Norms(raw / g, sd / g, local / g, labels, basis(min(parameters, 9), own_form))
    least = min(parameters, 9)
    return Task(norms, parameters, own_form, least, local, gravity_uncertainty, settings)


def _check_arrays(raw: Array, sd: Array) -> None:
    """Raise ValueError on forces or uncertainties of wrong shape or value."""
    if raw.ndim != 2 or raw.shape[1] != 3:
        raise ValueError(f"forces have shape {raw.shape}: expected (n, 3)")
    if sd.shape != raw.shape:
        raise ValueError(f"uncertainties have shape {sd.shape}: expected {raw.shape}")
    if not (np.isfinite(raw).all() and np.isfinite(sd).all() and (sd >= 0.0).all()):
        raise ValueError("forces and uncertainties must be finite, uncertainties not negative")


def _check_unit(raw: Array, gravity: float) -> None:
    """Raise NotSupported where forces seem to be multiples of g instead of m/s^2."""
    norm = float(np.median(np.linalg.norm(raw, axis=1)))
    if 0.5 < norm < 2.0 < gravity:
        reason = f"the forces' norm is about {norm:.2f}: these look like multiples of g, not m/s^2"
        raise NotSupported(reason, ["the same rests in m/s^2 (multiply by 9.80665)"])


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
    prior: FleetPrior | None = None,
) -> AccelerometerFit:
    """Fit bias and scale to rests of unknown attitude.

    forces: (n, 3) mean raw specific forces, m/s^2. uncertainties: (n, 3) standard uncertainties, or None to
    weight all rests equally. gravity: m/s^2, one value or (n,) where the place changed. gravity_uncertainty:
    its standard uncertainty, common to all rests. parameters: "auto" takes nine where the attitudes support
    them, else nine with the prior if one is given, else six. form: of a 9-parameter scale, see parameters.py.
    Raises AttitudesMissing (a NotSupported) where the attitudes do not support the model, or not even 6
    parameters; NotSupported where the result cannot be a phone's accelerometer; ValueError on arrays of wrong
    shape or value.

    A sensor with bias and 1 % of scale in eighteen attitudes:

    >>> up = observability.places()[:18]
    >>> raw = 9.81 * up @ np.diag([1 / 1.01, 1.0, 1 / 0.99]) + [0.3, -0.2, 0.1]
    >>> result = fit(raw, None, gravity=9.81)
    >>> result.parameters, result.model.bias.round(6).tolist()
    (9, [0.3, -0.2, 0.1])
    >>> np.diag(result.model.scale).round(6).tolist()
    [1.01, 1.0, 0.99]
    """
    if parameters != "auto":
        return _fit(task_of(forces, uncertainties, gravity, gravity_uncertainty, parameters, form, settings))
    task = task_of(forces, uncertainties, gravity, gravity_uncertainty, 9, form, settings)
    try:
        return _fit(replace(task, least=9 + settings.spare_attitudes))
    except AttitudesMissing:
        known = None if prior is None else _fit_with_prior(task, prior)
        six = task_of(forces, uncertainties, gravity, gravity_uncertainty, 6, form, settings)
        return known or _fit(six)


def _fit(task: Task) -> AccelerometerFit:
    """Fit one model or raise AttitudesMissing."""
    _require_support(task)
    used, solution = _robust(task)
    _require_plausible(task, solution)
    result = _result(task, solution, used)
    worst, limit = result.worst_norm_uncertainty, task.settings.max_norm_sd
    if worst > limit:
        wanted = observability.most_helpful_attitude(task.norms.only(used).directions(), task.parameters)
        reason = (
            f"{task.parameters} parameters would leave {worst:.2g} m/s^2 uncertain along the worst direction"
        )
        raise AttitudesMissing(f"{reason}, more than {limit:g}", (wanted,))
    return result


_RESCALED, _UNLIKE = 4, 40.0
"""Rounds of weighting anew with a prior, and the squared distance from it that one device in 100 000
exceeds (chi-squared with nine degrees of freedom)."""


def _fit_with_prior(task: Task, prior: FleetPrior) -> AccelerometerFit | None:
    """Fit nine parameters with a prior; None where even so too much stays unknown.

    The scatter of attitudes is the prior's, or larger where they disagree by more. None too for a phone that
    is unlike its prior, for rests that disagree too much, and for attitudes too few.
    """
    settings, g = task.settings, task.g
    raw, sd = task.norms.raw * g, task.norms.sd * g
    states = int(task.norms.labels.max()) + 1
    if states < settings.prior_attitudes or task.form != "symmetric":
        return None
    known = prior
    try:
        fitted = prior_fit.fit(raw, sd, task.local, known, settings.damping)
        for _ in range(_RESCALED):
            excess = fitted.squares / max(states - float(fitted.shown.sum()), 1.0)
            if excess <= 1.0:
                break
            known = replace(known, scatter=known.scatter * float(np.sqrt(excess)))
            fitted = prior_fit.fit(raw, sd, task.local, known, settings.damping)
    except NotSupported:
        return None
    if known.scatter > settings.max_norm_sd or prior_fit.distance(fitted, known) > _UNLIKE:
        return None
    if fitted.worst_norm_uncertainty > settings.max_prior_sd:
        return None
    return AccelerometerFit(
        model=fitted.model,
        parameters=9,
        form=task.form,
        names=names(9),
        covariance=fitted.covariance,
        degrees_of_freedom=float("inf"),
        coverage=observability.coverage(task.norms.directions(), 9),
        residuals=fitted.residuals,
        rms_residual=rms(fitted.residuals),
        dropped=(),
        n_rests=len(raw),
        n_states=states,
        repeatability=_repeatability(fitted.residuals, task.norms.labels),
        excess_rest=0.0,
        excess_attitude=known.scatter,
        gravity=g,
        gravity_uncertainty=task.gravity_uncertainty,
        iterations=fitted.iterations,
        with_prior=True,
    )


def _require_support(task: Task) -> None:
    """Raise AttitudesMissing where the attitudes do not support the model."""
    if task.supported_by(task.norms, task.least):
        return
    up, limit = task.norms.directions(), task.settings.max_amplification
    attitudes = "1 distinct attitude does" if len(up) == 1 else f"{len(up)} distinct attitudes do"
    reason = f"{attitudes} not support {task.parameters} parameters"
    if len(up) >= task.least:
        worst = observability.amplification(up, task.parameters)
        reason += (
            f": they are too similar (uncertainty along the worst direction {worst:.3g} times that of a rest,"
        )
        reason += f" limit {limit:g})"
    wanted = observability.missing_attitudes(up, task.parameters, limit, task.least)
    raise AttitudesMissing(reason, wanted)


def _robust(task: Task) -> tuple[NDArray[np.bool_], Solution]:
    """Fit, drop outliers as long as the model stays supported, and fit again."""
    damping, rounds = task.settings.damping, task.settings.rounds
    solution = solve(task.norms, damping, rounds)
    used = _without(task, _outliers(task, solution))
    if used.all():
        return used, solution
    solution = solve(task.norms.only(used), damping, rounds, solution.v)
    again = used | _explained(task, solution, int(used.sum()))
    if np.array_equal(again, used):
        return used, solution
    return again, solve(task.norms.only(again), damping, rounds, solution.v)


def _outliers(task: Task, solution: Solution) -> list[int]:
    """Return the rows of outlying rests, worst first.

    Where the attitudes determine nine parameters, a rest that nine would explain is no outlier even if six
    are fitted: its residual comes from the smaller model, not from the rest.
    """
    if task.settings.outlier_level == 0.0:
        return []
    residuals, jacobian = task.norms.residuals(solution.v)
    if task.parameters < 9 and observability.determined(task.norms.directions(), 9):
        richer = replace(task.norms, matrix=basis(9, task.form))
        jacobian = richer.residuals(inverse(9, task.form) @ task.norms.matrix @ solution.v)[1]
    most = int(task.settings.max_outliers * len(residuals))
    variances = solution.variances(task.norms)
    return random_effects.outliers(residuals, jacobian, variances, most, task.settings.outlier_level)


def _without(task: Task, rows: list[int]) -> NDArray[np.bool_]:
    """Return which rests to use, (n,), without `rows`, worst first, as far as the model stays supported."""
    used = np.ones(len(task.local), dtype=bool)
    for row in rows:
        used[row] = False
        if not task.supported_by(task.norms.only(used), task.least):
            used[row] = True
    return used


def _explained(task: Task, solution: Solution, fitted: int) -> NDArray[np.bool_]:
    """Tell which rests, (n,), the fitted ones explain, given the scatter that those show."""
    residuals, jacobian = task.norms.residuals(solution.v)
    predicted = variances_along(jacobian, solution.covariance)
    free = max(fitted - jacobian.shape[1], 1)
    limit = quantile(free, 1.0 - task.settings.outlier_level / (2.0 * len(residuals)))
    sd = np.sqrt(solution.variances(task.norms) + predicted)
    return np.asarray(np.abs(residuals) <= limit * sd, dtype=np.bool_)


def _require_plausible(task: Task, solution: Solution) -> None:
    """Raise NotSupported where the fit did not converge or cannot be a phone's accelerometer."""
    settings = task.settings
    model = _model(task, solution)
    bias = float(np.abs(model.bias).max())
    error = float(np.abs(np.linalg.svd(model.scale, compute_uv=False) - 1.0).max())
    if not solution.converged:
        raise NotSupported("the fit did not converge", ["rests in more attitudes"])
    if bias > settings.max_bias or error > settings.max_scale_error:
        reason = (
            f"this is no phone's accelerometer: a bias of {bias:.2g} m/s^2 and a scale off by {error:.0%}"
        )
        raise NotSupported(reason, ["rests, in m/s^2, of a phone that lies still"])


def _model(task: Task, solution: Solution) -> SensorModel:
    twelve = task.norms.matrix @ solution.v
    return SensorModel.of(twelve[3:].reshape(3, 3), task.g * twelve[:3])


def _covariance(task: Task, solution: Solution) -> Array:
    """Return the covariance of the model's own parameters, (p, p), in m/s^2 and 1."""
    units = np.repeat((task.g, 1.0), (3, 9))
    spread = inverse(task.parameters, task.form) @ (task.norms.matrix * units[:, None])
    return frozen(spread @ solution.covariance @ spread.T)


def _degrees_of_freedom(solution: Solution, rests: int, states: int) -> float:
    """Return the degrees of freedom of the covariance; see AccelerometerFit."""
    if solution.between > 0.0:
        return float(states - len(solution.v))
    return float(rests - states) if solution.within > 0.0 else float("inf")


def _result(task: Task, solution: Solution, used: NDArray[np.bool_]) -> AccelerometerFit:
    """Return a solution in m/s^2, with what is needed to judge it."""
    model, fitted = _model(task, solution), task.norms.only(used)
    residuals = np.linalg.norm(model.apply(task.g * task.norms.raw), axis=1) - task.local
    states = int(fitted.labels.max()) + 1
    return AccelerometerFit(
        model=model,
        parameters=task.parameters,
        form=task.form,
        names=names(task.parameters, task.form),
        covariance=_covariance(task, solution),
        degrees_of_freedom=_degrees_of_freedom(solution, len(fitted.raw), states),
        coverage=observability.coverage(fitted.directions(), task.parameters, task.form),
        residuals=frozen(residuals),
        rms_residual=rms(residuals),
        dropped=_dropped(residuals, used),
        n_rests=len(used),
        n_states=states,
        repeatability=_repeatability(residuals[used], fitted.labels),
        excess_rest=task.g * float(np.sqrt(solution.within)),
        excess_attitude=task.g * float(np.sqrt(solution.between)),
        gravity=task.g,
        gravity_uncertainty=task.gravity_uncertainty,
        iterations=solution.iterations,
    )


def _repeatability(residuals: Array, labels: NDArray[np.intp]) -> float | None:
    """Return the standard deviation of norms within attitudes, m/s^2; None where none was held twice."""
    if labels.size == np.unique(labels).size:
        return None
    return float(np.sqrt(random_effects.within_variance(residuals, labels, np.zeros(labels.size))))


def _dropped(residuals: Array, used: NDArray[np.bool_]) -> tuple[Dropped, ...]:
    rows = np.flatnonzero(np.logical_not(used))
    why = "its norm is {:+.3g} m/s^2 off what the other rests agree on"
    return tuple(Dropped(int(row), why.format(residuals[row])) for row in rows)
