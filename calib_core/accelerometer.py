"""Accelerometer calibration from rests whose attitudes nobody knows (Grammenos et al. 2018, 4.2).

calibrated = scale @ (raw - bias) such that every rest has gravity's norm. The cost is that of Eq. 5, each
squared-norm difference weighted by its rest's own uncertainty and by what rests are found to scatter
besides; the steps are Eq. 6-8 (damped.py). Rests that share an attitude count once together. Which model
the attitudes support is judged in attitudes.py; known attitudes are fitted in sixface.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from stillcal.calib_core import attitudes, excess
from stillcal.calib_core.accelerometer_fit import AccelerometerFit as AccelerometerFit
from stillcal.calib_core.accelerometer_fit import Dropped
from stillcal.calib_core.attitudes import Attitude
from stillcal.calib_core.damped import Damping, minimise
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.parameters import Form, basis, names
from stillcal.calib_core.refusals import NotSupported
from stillcal.calib_core.rests import attitude_labels
from stillcal.calib_core.samples import Array, frozen

Parameters = Literal["auto", 6, 9, 12]

_IDENTITY = np.r_[np.zeros(3), np.eye(3).ravel()]
_LEAST_SD = 1e-12  # of gravity: no rest is weighted as better known than this


@dataclass(frozen=True, slots=True)
class AccelerometerSettings:
    """What a fit asks of its rests, and how it proceeds.

    damping: of the Gauss-Newton steps. attitude_angle: rad, rests nearer than this share an attitude.
    max_amplification: the calibrated norm may be known, along the worst direction, this many times worse
    than one rest is measured. The default sets what an omitted 1 % of cross-axis sensitivity costs (a
    phone's MEMS datasheet figure; half of it, 0.05 m/s^2, along the worst direction) against the 0.01 m/s^2
    by which a phone's rests scatter: beyond it, leaving the cross-axis terms out does less harm.
    max_norm_sd: m/s^2, the same cost as a bound on the outcome. spare_attitudes: how many more than
    parameters "auto" wants before it takes more than 6, so that the fit can be checked at all.
    outlier_level: chance of dropping any rest where none is bad; 0 drops none. max_outliers: most rests
    dropped, as a fraction. max_bias: m/s^2 and max_scale_error: beyond these it is not a phone's
    accelerometer. rounds: of reweighting.
    """

    damping: Damping = Damping()
    attitude_angle: float = np.deg2rad(5.0)
    max_amplification: float = 5.0
    max_norm_sd: float = 0.05
    spare_attitudes: int = 1
    outlier_level: float = 0.01
    max_outliers: float = 0.2
    max_bias: float = 5.0
    max_scale_error: float = 0.3
    rounds: int = 10

    def __post_init__(self) -> None:
        for name, low, high in (
            ("attitude_angle", 0.0, 1.0),
            ("max_amplification", 1.0, np.inf),
            ("max_norm_sd", 0.0, np.inf),
            ("spare_attitudes", 0, 100),
            ("outlier_level", 0.0, 0.5),
            ("max_outliers", 0.0, 0.5),
            ("max_bias", 0.0, np.inf),
            ("max_scale_error", 0.0, 1.0),
            ("rounds", 1, 1000),
        ):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} is {getattr(self, name)}: allowed {low} to {high}")


class AttitudesMissing(NotSupported):
    """The attitudes do not support the model. attitudes: those to add, with their unit directions."""

    def __init__(self, reason: str, wanted: tuple[Attitude, ...]) -> None:
        super().__init__(reason, [a.words for a in wanted])
        self.attitudes = wanted


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Rests in units of gravity. raw, sd: (n, 3); target: (n,) norms, about 1; labels: (n,) attitudes."""

    raw: Array
    sd: Array
    target: Array
    labels: Array
    matrix: Array
    settings: AccelerometerSettings

    def only(self, mask: Array) -> _Problem:
        """Keep some rests, attitudes numbered anew."""
        labels = np.unique(self.labels[mask], return_inverse=True)[1]
        return replace(self, raw=self.raw[mask], sd=self.sd[mask], target=self.target[mask], labels=labels)

    def directions(self) -> Array:
        """Unit vectors of the attitudes, (m, 3), each the mean of its rests."""
        sums = [np.bincount(self.labels, column) for column in attitudes.directions(self.raw).T]
        return attitudes.directions(np.column_stack(sums))


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """A fit of some rests, in units of gravity. within, between: excess variances of rests and attitudes."""

    v: Array
    covariance: Array
    within: float
    between: float
    iterations: int
    converged: bool


def fit(
    forces: ArrayLike,
    uncertainties: ArrayLike | None,
    gravity: float | ArrayLike,
    gravity_uncertainty: float = 0.0,
    *,
    parameters: Parameters = "auto",
    form: Form = "symmetric",
    settings: AccelerometerSettings = AccelerometerSettings(),
) -> AccelerometerFit:
    """Fit bias and scale to rests of unknown attitude.

    forces: (n, 3) mean raw specific forces, m/s^2. uncertainties: (n, 3) standard uncertainties, or None to
    weigh all rests alike. gravity: m/s^2, one value or (n,) where the place changed; gravity_uncertainty:
    its standard uncertainty, common to all rests. parameters: "auto" takes the largest model that the
    attitudes support. Raises AttitudesMissing (a NotSupported) where they do not support it, or not even 6;
    NotSupported where the outcome is no phone's accelerometer; ValueError on arrays that do not fit.
    """
    problem, local = _problem(forces, uncertainties, gravity, form, settings)
    choices = (9, 6) if parameters == "auto" else (parameters,)
    refusal: AttitudesMissing | None = None
    for choice in choices:
        try:
            return _fit_model(problem, choice, form, local, gravity_uncertainty, spare=parameters == "auto")
        except AttitudesMissing as error:
            refusal = error
    assert refusal is not None
    raise refusal


def _problem(
    forces: ArrayLike,
    uncertainties: ArrayLike | None,
    gravity: float | ArrayLike,
    form: Form,
    settings: AccelerometerSettings,
) -> tuple[_Problem, Array]:
    """Check the arrays and put them in units of gravity; return with them local gravity, (n,) m/s^2."""
    raw = np.asarray(forces, dtype=np.float64)
    if raw.ndim != 2 or raw.shape[1] != 3:
        raise ValueError(f"forces have shape {raw.shape}: expected (n, 3)")
    sd = np.zeros_like(raw) if uncertainties is None else np.asarray(uncertainties, dtype=np.float64)
    if sd.shape != raw.shape:
        raise ValueError(f"uncertainties have shape {sd.shape}: expected {raw.shape}")
    local = np.broadcast_to(np.asarray(gravity, dtype=np.float64), len(raw))
    if not (np.isfinite(raw).all() and np.isfinite(sd).all() and (sd >= 0.0).all() and (local > 0.0).all()):
        raise ValueError(
            "forces and uncertainties must be finite, uncertainties not negative, gravity positive"
        )
    if len(raw) == 0:
        wanted = attitudes.missing_attitudes(raw, 6, settings.max_amplification, 6)
        raise AttitudesMissing("there is no rest", wanted)
    g = float(local.mean())
    _check_unit(raw, g)
    labels = attitude_labels(raw, settings.attitude_angle)
    return _Problem(raw / g, sd / g, local / g, labels, basis(9, form), settings), local


def _check_unit(raw: Array, gravity: float) -> None:
    norm = float(np.median(np.linalg.norm(raw, axis=1)))
    if 0.5 < norm < 2.0 < gravity:
        reason = f"the forces' norm is about {norm:.2f}: these look like multiples of g, not m/s^2"
        raise NotSupported(reason, ["the same rests in m/s^2 (multiply by 9.80665)"])


def _fit_model(
    problem: _Problem, parameters: int, form: Form, local: Array, gravity_uncertainty: float, spare: bool
) -> AccelerometerFit:
    """Fit one model or raise AttitudesMissing. 12 parameters: see `AccelerometerFit.form`."""
    own_form: Form = "symmetric" if parameters == 12 else form
    problem = replace(problem, matrix=basis(min(parameters, 9), own_form))
    _require_support(problem, parameters, spare)
    used, solution = _robust(problem)
    _require_plausible(problem, solution)
    found = _report(problem, solution, used, parameters, own_form, local, gravity_uncertainty)
    worst = found.worst_norm_uncertainty
    if worst > problem.settings.max_norm_sd:
        where = attitudes.most_helpful_attitude(problem.only(used).directions(), parameters)
        reason = (
            f"{parameters} parameters would leave {worst:.2g} m/s^2 open along the worst direction, more than "
            f"{problem.settings.max_norm_sd:g}"
        )
        raise AttitudesMissing(reason, (where,))
    return found


def _least_attitudes(parameters: int, spare: bool, settings: AccelerometerSettings) -> int:
    return min(parameters, 9) + (settings.spare_attitudes if spare and parameters > 6 else 0)


def _supported(problem: _Problem, parameters: int, spare: bool) -> bool:
    up = problem.directions()
    if len(up) < _least_attitudes(parameters, spare, problem.settings):
        return False
    return attitudes.amplification(up, parameters) <= problem.settings.max_amplification


def _require_support(problem: _Problem, parameters: int, spare: bool) -> None:
    if _supported(problem, parameters, spare):
        return
    limit, up = problem.settings.max_amplification, problem.directions()
    least = _least_attitudes(parameters, spare, problem.settings)
    reason = f"{len(up)} distinct attitudes do not support {parameters} parameters"
    if len(up) >= least:
        reason += (
            f": they leave the worst direction {attitudes.amplification(up, parameters):.3g} times less known"
        )
        reason += f" than a rest measures it, the limit is {limit:g}"
    raise AttitudesMissing(reason, attitudes.missing_attitudes(up, parameters, limit, least))


def _robust(problem: _Problem) -> tuple[Array, _Solution]:
    """Fit, drop what does not belong as long as the model stays supported, and fit again."""
    used = np.ones(len(problem.raw), dtype=bool)
    solution = _solve(problem, None)
    if problem.settings.outlier_level == 0.0:
        return used, solution
    for row in _suspects(problem, solution):
        fewer = used.copy()
        fewer[row] = False
        if _supported(problem.only(fewer), problem.matrix.shape[1], spare=False):
            used = fewer
    if used.all():
        return used, solution
    solution = _solve(problem.only(used), solution.v)
    readmitted = _readmitted(problem, solution, used)
    if readmitted.sum() > used.sum():
        used, solution = readmitted, _solve(problem.only(readmitted), solution.v)
    return used, solution


def _suspects(problem: _Problem, solution: _Solution) -> list[int]:
    residuals, jacobian = _norm_residuals(problem, problem.matrix @ solution.v)
    variances = _own_variances(problem, problem.matrix @ solution.v) + solution.within + solution.between
    most = int(problem.settings.max_outliers * len(residuals))
    return excess.outliers(
        residuals, jacobian @ problem.matrix, variances, most, problem.settings.outlier_level
    )


def _readmitted(problem: _Problem, solution: _Solution, used: Array) -> Array:
    """Take back rests that the others, with the scatter they show among themselves, do explain."""
    from scipy.special import stdtrit  # noqa: PLC0415 - the daemon stays light until it fits

    twelve = problem.matrix @ solution.v
    residuals, jacobian = _norm_residuals(problem, twelve)
    rows = jacobian @ problem.matrix
    variances = _own_variances(problem, twelve) + solution.within + solution.between
    variances = variances + np.einsum("ij,jk,ik->i", rows, solution.covariance, rows)
    free = max(int(used.sum()) - rows.shape[1], 1)
    limit = stdtrit(free, 1.0 - problem.settings.outlier_level / (2.0 * len(used)))
    return np.asarray(used | (np.abs(residuals) <= limit * np.sqrt(variances)))


def _solve(problem: _Problem, start: Array | None) -> _Solution:
    """Minimise and reweigh in turn until the weights settle."""
    v = np.linalg.lstsq(problem.matrix, _IDENTITY, rcond=None)[0] if start is None else start
    within = between = 0.0
    iterations = 0
    pooled = _pooling(problem.labels, np.ones(len(problem.raw)))
    root = np.ones(len(pooled))
    for _ in range(problem.settings.rounds):
        step = minimise(_whitened(problem, root[:, None] * pooled), v, problem.settings.damping)
        v, iterations = step.v, iterations + step.iterations
        twelve = problem.matrix @ v
        residuals, jacobian = _norm_residuals(problem, twelve)
        own = _own_variances(problem, twelve)
        within = excess.within_variance(residuals, problem.labels, own)
        pooled = _pooling(problem.labels, 1.0 / (own + within))
        group = 1.0 / np.bincount(problem.labels, 1.0 / (own + within))
        design = pooled @ jacobian @ problem.matrix
        between = excess.excess_variance(pooled @ residuals, design, group)
        new_root = 1.0 / np.sqrt(group + between)
        settled = np.allclose(new_root, root, rtol=1e-3)
        root = new_root
        if settled:
            break
    white = root[:, None] * design
    return _Solution(v, np.linalg.inv(white.T @ white), within, between, iterations, step.converged)


def _pooling(labels: Array, weights: Array) -> Array:
    """Return the (m, n) matrix that takes weighted means over each attitude's rests."""
    members = (labels[None, :] == np.arange(labels.max() + 1)[:, None]) * weights
    return np.asarray(members / members.sum(axis=1, keepdims=True))


def _whitened(problem: _Problem, whitening: Array) -> Callable[[Array], tuple[Array, Array]]:
    def residuals(v: Array) -> tuple[Array, Array]:
        values, jacobian = _norm_residuals(problem, problem.matrix @ v)
        return whitening @ values, whitening @ (jacobian @ problem.matrix)

    return residuals


def _norm_residuals(problem: _Problem, twelve: Array) -> tuple[Array, Array]:
    """Return Eq. 4 over twice the norm wanted, (n,), and its Jacobian on all twelve parameters, (n, 12)."""
    scale = twelve[3:].reshape(3, 3)
    shifted = problem.raw - twelve[:3]
    calibrated = shifted @ scale.T
    target = problem.target
    residuals = ((calibrated**2).sum(axis=1) - target**2) / (2.0 * target)
    unit = calibrated / target[:, None]
    products = unit[:, :, None] * shifted[:, None, :]
    return residuals, np.hstack((-unit @ scale, products.reshape(-1, 9)))


def _own_variances(problem: _Problem, twelve: Array) -> Array:
    """Return each rest's own variance of its calibrated norm, (n,), through the current model."""
    scale = twelve[3:].reshape(3, 3)
    slopes = attitudes.directions((problem.raw - twelve[:3]) @ scale.T) @ scale
    return np.maximum(((slopes * problem.sd) ** 2).sum(axis=1), _LEAST_SD**2)


def _require_plausible(problem: _Problem, solution: _Solution) -> None:
    settings = problem.settings
    twelve = problem.matrix @ solution.v
    bias = 9.80665 * float(np.abs(twelve[:3]).max())
    stretch = np.linalg.svd(twelve[3:].reshape(3, 3), compute_uv=False)
    error = float(np.abs(stretch - 1.0).max())
    if not solution.converged:
        raise NotSupported("the fit did not converge", ["rests in more attitudes"])
    if bias > settings.max_bias or error > settings.max_scale_error:
        reason = f"no phone's accelerometer: a bias of {bias:.2g} m/s^2 and a scale off by {error:.0%}"
        raise NotSupported(reason, ["rests in m/s^2 of a phone that lies still"])


def _report(
    problem: _Problem,
    solution: _Solution,
    used: Array,
    parameters: int,
    form: Form,
    local: Array,
    gravity_uncertainty: float,
) -> AccelerometerFit:
    """Put a solution in units of m/s^2 and beside it what a reader needs to judge it."""
    g = float(local.mean())
    kept = problem.only(used)
    twelve = problem.matrix @ solution.v
    units = np.r_[np.full(3, g), np.ones(9)]
    model = SensorModel.of(twelve[3:].reshape(3, 3), g * twelve[:3])
    norms = np.linalg.norm(model.apply(g * problem.raw), axis=1)
    residuals = norms - local
    spread = problem.matrix * units[:, None]
    full = spread @ solution.covariance @ spread.T
    back = np.linalg.pinv(basis(parameters, form))
    counts = np.bincount(kept.labels)
    shared = bool((counts > 1).any())
    cover = attitudes.coverage(kept.directions(), parameters, form)
    return AccelerometerFit(
        model=model,
        parameters=parameters,
        form=form,
        names=names(parameters, form),
        covariance=frozen(back @ full @ back.T),
        degrees_of_freedom=len(counts) - solution.covariance.shape[0],
        coverage=cover,
        residuals=frozen(residuals),
        rms_residual=float(np.sqrt(np.mean(residuals**2))),
        dropped=_dropped(residuals, used),
        n_rests=len(used),
        n_states=len(counts),
        repeatability=_repeatability(residuals[used], kept.labels) if shared else None,
        excess_rest=g * float(np.sqrt(solution.within)),
        excess_attitude=g * float(np.sqrt(solution.between)),
        gravity=g,
        gravity_uncertainty=gravity_uncertainty,
        iterations=solution.iterations,
    )


def _repeatability(residuals: Array, labels: Array) -> float:
    """Return the standard deviation of norms within an attitude, pooled over attitudes held more than once."""
    own = np.full(len(residuals), 0.0)
    return float(np.sqrt(excess.within_variance(residuals, labels, own)))


def _dropped(residuals: Array, used: Array) -> tuple[Dropped, ...]:
    return tuple(
        Dropped(int(row), f"its norm is {residuals[row]:+.3g} m/s^2 off what the other rests agree on")
        for row in np.flatnonzero(~used)
    )
