"""A prior for an accelerometer, learnt from a fleet of calibrated ones, and a fit that starts from it.

It is empirical Bayes with two levels: a device's parameters scatter about the mean of its model, the models'
means about that of the fleet. The prior enters the fit of Grammenos et al. 2018, Eq. 5, as further terms of
the sum of squares, so that a first calibration is possible from any number of rests: parameters that the
rests do not show keep their prior values. Parameters are the nine of parameters.py, bias in m/s^2 first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stillcal.calib_core.accelerometer import observability
from stillcal.calib_core.accelerometer.equations import Norms, pooling
from stillcal.calib_core.accelerometer.parameters import basis, names, variances_along
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths.levenberg_marquardt import Damping, minimise
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import ATTITUDE_ANGLE, attitude_labels

NOMINAL = np.r_[np.zeros(3), np.ones(3), np.zeros(3)]
"""The parameters of an ideal sensor: bias, diagonal and cross-axis entries."""

_DATA_SHEET_SD = (0.4, 0.015, 0.005)
"""Standard deviations of bias (m/s^2), diagonal and cross-axis entries as data sheets of phones' parts give
them (MPU-6050, BMI160: 40 to 80 mg, 1 to 3 %, 1 to 2 % at most). Fifteen phones and watches of Stisen et al.
2015 have 0.23 m/s^2, 0.6 % and 0.3 % (rms)."""

_KINDS = np.repeat(np.arange(3), 3)  # kind of each parameter: bias, diagonal, cross-axis
CROSS_AXIS_SD = 0.005
"""Half of the 1 % of cross-axis sensitivity that data sheets of phones' parts give."""

_UNKNOWN = 1.0  # variance of a parameter that a device's fit did not estimate, far beyond any phone's
_ROUNDS, _SETTLED = 500, 1e-6  # most steps of expectation-maximisation, and the relative change that ends it
_REWEIGHED = 2  # fits with new weights: those of the second come from a fitted model and hardly change more
_SURPRISE_CHANCE = 1e-6  # probability of a false alarm for one device; a fleet has thousands


@dataclass(frozen=True, slots=True, eq=False)
class FleetPrior:
    """The parameters expected of a sensor before its first rest.

    mean: (9,). covariance: (9, 9). Both in m/s^2 and 1. scatter: m/s^2, standard deviation of norms at rest
    beyond the uncertainty of each rest. devices: number of devices that it was learnt from. model: the device
    model that it is for, empty for any. of_model: number of devices of that model among them.
    """

    mean: Array
    covariance: Array
    scatter: float = 0.01
    devices: int = 0
    model: str = ""
    of_model: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters' names, in order."""
        return names(9)


SOUND_PHONES = FleetPrior(NOMINAL, np.diag(np.repeat(_DATA_SHEET_SD, 3) ** 2))
"""What is known of any phone that is sound."""


@dataclass(frozen=True, slots=True, eq=False)
class Population:
    """A fleet with two levels of scatter.

    mean: (9,) of the fleet. within: (9, 9) covariance of devices about the mean of their model. between:
    (9, 9) covariance of models about `mean`. model_means: (models, 9). model_covariances: (models, 9, 9),
    uncertainty of these. devices: (models,) number of devices of each. scatter: see FleetPrior.
    """

    mean: Array
    within: Array
    between: Array
    model_means: Array
    model_covariances: Array
    devices: NDArray[np.intp]
    scatter: float = 0.01

    def prior(self, model: int | None = None, name: str = "") -> FleetPrior:
        """Return the prior for a new device of a model, given by its number, or of an unknown model."""
        total = int(self.devices.sum())
        if model is None:
            of_the_mean = self.between / len(self.devices)
            covariance = self.within + self.between + of_the_mean
            return FleetPrior(frozen(self.mean), frozen(covariance), self.scatter, total, name)
        covariance = self.within + self.model_covariances[model]
        mean, own = frozen(self.model_means[model]), int(self.devices[model])
        return FleetPrior(mean, frozen(covariance), self.scatter, total, name, own)


@dataclass(frozen=True, slots=True, eq=False)
class PriorFit:
    """A calibration from rests and a prior.

    values: (9,) and covariance: (9, 9) of the parameters. residuals: (n,) m/s^2, calibrated norm less
    gravity. squares: sum over attitudes of squared residuals over their variances. shown: (9,) the fraction
    by which the rests reduced each parameter's variance, from 0, all prior, to 1, all rests. iterations:
    number of Gauss-Newton steps tried. gravity: m/s^2, mean of those that were fitted to.
    """

    model: SensorModel
    values: Array
    covariance: Array
    residuals: Array
    squares: float
    shown: Array
    iterations: int
    gravity: float

    @property
    def worst_norm_uncertainty(self) -> float:
        """Standard uncertainty of the calibrated norm at rest along the worst direction, m/s^2."""
        up = observability.sphere()
        return float(np.sqrt(norm_variances(up, self.covariance, self.gravity).max()))


def expanded(values: ArrayLike, covariance: ArrayLike) -> tuple[Array, Array]:
    """Return a 6- or 9-parameter fit as nine parameters; those not estimated are 0, with a large variance."""
    own, spread = np.asarray(values, dtype=np.float64), np.asarray(covariance, dtype=np.float64)
    if own.shape not in {(6,), (9,)} or spread.shape != (own.size, own.size):
        raise ValueError(f"values {own.shape} and covariance {spread.shape}: expected 6 or 9 parameters")
    full, wide = np.zeros(9), _UNKNOWN * np.eye(9)
    full[: own.size] = own
    wide[: own.size, : own.size] = spread
    return full, wide


def learn(values: ArrayLike, covariances: ArrayLike, models: ArrayLike, scatter: float = 0.01) -> Population:
    """Learn a population from devices' parameters (n, 9), covariances (n, 9, 9) and models (n,) from 0 on.

    It is expectation-maximisation of the two-level normal model (Dempster, Laird and Rubin 1977). Each
    covariance is shrunk towards one variance for each kind of parameter, with the weight of nine further
    devices, so that few devices do not make parameters seem certain. Raises NotSupported with fewer than
    three devices.
    """
    y, own = np.asarray(values, dtype=np.float64), np.asarray(covariances, dtype=np.float64)
    group = np.asarray(models, dtype=np.intp)
    if len(y) < 3:
        raise NotSupported(f"{len(y)} calibrated devices", ("at least three",))
    member = (group[None, :] == np.arange(group.max() + 1)[:, None]).astype(np.float64)
    mean, within = y.mean(axis=0), _initial_covariance(y, own)
    between = 0.5 * within
    for _ in range(_ROUNDS):
        model_means, model_covariances = _model_means(
            y, np.asarray(np.linalg.inv(within + own)), member, mean, between
        )
        off = y - model_means[group]
        gain = within @ np.linalg.inv(within + own)
        second = off[:, :, None] * off[:, None, :] + model_covariances[group]
        left = gain @ second @ gain.transpose(0, 2, 1) + within - gain @ within
        apart = model_means - mean
        moved = _shrunk(left.sum(axis=0), len(y))
        mean = model_means.mean(axis=0)
        between = _shrunk(
            (apart[:, :, None] * apart[:, None, :] + model_covariances).sum(axis=0), len(model_means)
        )
        change = float(np.abs(np.diag(moved) / np.diag(within) - 1.0).max())
        within = moved
        if change < _SETTLED:
            break
    return Population(
        mean, within, between, model_means, model_covariances, member.sum(axis=1).astype(np.intp), scatter
    )


def _model_means(y: Array, precise: Array, member: Array, mean: Array, between: Array) -> tuple[Array, Array]:
    """Return each model's mean, (models, 9), and its covariance given the devices, (models, 9, 9).

    precise: (n, 9, 9) information of each device on its model's mean. member: (models, n), 1 where a device
    is of a model.
    """
    fixed = np.linalg.inv(between)
    model_covariances = np.linalg.inv(fixed + np.einsum("gi,ijk->gjk", member, precise))
    pulls = fixed @ mean + np.einsum("gi,ijk,ik->gj", member, precise, y)
    return np.einsum("gjk,gk->gj", model_covariances, pulls), model_covariances


def _initial_covariance(y: Array, own: Array) -> Array:
    """Return a covariance to start from, with datasheet values for parameters that no fit estimated."""
    scatter = np.cov(y.T) * (len(y) - 1)
    unknown = (np.diagonal(own, axis1=1, axis2=2) >= _UNKNOWN).all(axis=0)
    return _shrunk(scatter + np.diag(np.where(unknown, CROSS_AXIS_SD**2 * len(y), 0.0)), len(y) - 1)


def _shrunk(scatter: Array, count: int) -> Array:
    """Return a covariance from a sum of squares (9, 9) of `count` devices, shrunk by nine further ones."""
    diagonal = np.diag(scatter) / max(count, 1)
    kinds = np.array([diagonal[k == _KINDS].mean() for k in range(3)])
    return np.asarray((scatter + 9.0 * np.diag(np.maximum(kinds[_KINDS], 1e-14))) / (count + 9.0))


def fit(
    forces: ArrayLike,
    uncertainties: ArrayLike,
    gravity: ArrayLike,
    prior: FleetPrior,
    damping: Damping | None = None,
) -> PriorFit:
    """Fit nine parameters to any number of rests of unknown attitude, with a fleet's prior.

    forces, uncertainties: (n, 3) m/s^2, as for accelerometer.fit; n may be 0. gravity: m/s^2, one value or
    (n,). Rests that share an attitude count as one. Raises NotSupported where the fit does not converge.
    """
    raw = np.asarray(forces, dtype=np.float64).reshape(-1, 3)
    sd = np.asarray(uncertainties, dtype=np.float64).reshape(raw.shape)
    local = np.asarray(gravity, dtype=np.float64)
    g, matrix = float(local.mean()), basis(9)
    unit = np.r_[np.full(3, g), np.ones(6)]
    mean, covariance = prior.mean / unit, prior.covariance / np.outer(unit, unit)
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    labels = attitude_labels(raw, ATTITUDE_ANGLE)
    target = np.broadcast_to(local / g, len(raw))
    norms = Norms(raw / g, sd / g, target, labels, matrix)
    v, after, iterations, squares = mean, covariance, 0, 0.0
    for _ in range(_REWEIGHED if len(raw) else 0):
        whitening = _whitening(norms, v, prior.scatter / g)
        minimum = minimise(_posterior(norms, whitening, mean, root), v, damping or Damping())
        if not minimum.converged:
            raise NotSupported("the fit did not converge", ("rests, in m/s^2, of a phone that lies still",))
        v, iterations = minimum.v, iterations + minimum.iterations
        after = np.linalg.inv(minimum.jacobian.T @ minimum.jacobian)
        squares = float(((whitening @ norms.residuals(v)[0]) ** 2).sum())
    values = v * unit
    twelve = matrix @ values
    model = SensorModel.of(twelve[3:].reshape(3, 3), twelve[:3])
    residuals = np.linalg.norm(model.apply(raw), axis=1) - local
    shown = 1.0 - np.diag(after) / np.diag(covariance)
    return PriorFit(
        model,
        frozen(values),
        frozen(after * np.outer(unit, unit)),
        frozen(residuals),
        squares,
        frozen(shown),
        iterations,
        g,
    )


def _whitening(norms: Norms, v: Array, scatter: float) -> Array:
    """Return the matrix (attitudes, n) of means over each attitude's rests, in standard deviations."""
    weights = 1.0 / norms.own_variances(v)
    sd = np.sqrt(1.0 / np.bincount(norms.labels, weights) + scatter**2)
    return np.asarray(pooling(norms.labels, weights) / sd[:, None])


def _posterior(
    norms: Norms, whitening: Array, mean: Array, root: Array
) -> Callable[[Array], tuple[Array, Array]]:
    def residuals(v: Array) -> tuple[Array, Array]:
        values, jacobian = norms.residuals(v)
        return (
            np.concatenate((whitening @ values, root @ (v - mean))),
            np.concatenate((whitening @ jacobian, root)),
        )

    return residuals


@dataclass(frozen=True, slots=True)
class Surprise:
    """How far a fit is from its prior.

    squared: squared Mahalanobis distance. limit: the value that one fit in a million exceeds. parameter: the
    one farthest from the prior's mean, by `sds` of the prior's standard deviations.
    """

    squared: float
    limit: float
    parameter: str
    sds: float


def surprise(fitted: PriorFit, prior: FleetPrior) -> Surprise:
    """Return how far a fit is from its prior, with a limit that at most one fit in a million exceeds.

    The limit is Hotelling's (1931) for a covariance that was learnt, here from the prior's devices and the
    nine that `learn` shrinks it by. A fit is drawn towards its prior, so that fewer than that exceed it.
    """
    from scipy.stats import f  # noqa: PLC0415 - loaded when used: the daemon stays light

    off = fitted.values - prior.mean
    freedom = max(prior.devices, 1) + 9 - 1
    rest = freedom - 9 + 1
    limit = 9.0 * freedom / rest * float(f.isf(_SURPRISE_CHANCE, 9, rest))
    sds = off / np.sqrt(np.diag(prior.covariance))
    worst = int(np.abs(sds).argmax())
    return Surprise(distance(fitted, prior), limit, prior.names[worst], float(sds[worst]))


def distance(fitted: PriorFit, prior: FleetPrior) -> float:
    """Return the squared Mahalanobis distance of a fit from its prior's mean."""
    off = fitted.values - prior.mean
    return float(off @ np.linalg.solve(prior.covariance, off))


def norm_variances(up: Array, covariance: Array, gravity: float) -> Array:
    """Return the variance (n,) of the calibrated norm of gravity along unit vectors (n, 3), (m/s^2)^2."""
    products = gravity * up[:, :, None] * up[:, None, :]
    rows = np.hstack((-up, products.reshape(-1, 9))) @ basis(9)
    return variances_along(rows, covariance)
