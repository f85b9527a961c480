"""The gyroscope's bias from rests, and a bound on the rotation that those rests may have hidden in it.

At rest a gyroscope reads its bias. Slow, steady rotation reads as bias too. About a horizontal axis gravity's
direction shows it; about the vertical nothing in a single rest does (RestState.undetected_rotation_bound).
Rests in different attitudes have the vertical along different axes of the body and so bound it together. A
bias that follows gravity (g-sensitivity) shows here as wander between attitudes, not as a bias of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.maths.robust import MAD_TO_SD
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState, attitude_labels, directions, forces

_OUTLIER = 4.5  # robust standard deviations; 1 in 150 000 normal draws lies beyond
_UNBOUNDED_SPIN = 1e3  # rad/s; stands for a rotation that nothing bounds, far beyond any gyroscope's range
_SAME_ATTITUDE = 0.1  # rad; rests whose verticals are nearer may share a rotation about it


@dataclass(frozen=True, slots=True, eq=False)
class BiasEstimate:
    """The bias of a gyroscope.

    bias: (3,) raw rad/s. covariance: (3, 3) of that mean. wander: (3,) rad/s, standard deviation of the bias
    of single rests about it, beyond their own uncertainty. undetected_rotation_bound: (3,) rad/s, standard
    size of the error that slow rotation in the rests may have put into each axis undetected; inf where
    nothing bounds it. n_rests: number of rests with rates. outliers: indices of the rests left out because
    the phone turned or the bias jumped.
    """

    bias: Array
    covariance: Array
    wander: Array
    undetected_rotation_bound: Array
    n_rests: int
    outliers: tuple[int, ...] = ()


def bias_from_rests(rests: Sequence[RestState]) -> BiasEstimate:
    """Estimate the bias from the mean rates of rests, weighted by their uncertainty and their wander.

    It is a random-effects mean (DerSimonian and Laird 1986) of the rests within 4.5 robust standard
    deviations of the median. What the wander adds to the covariance is widened for few rests as in Student's
    t. Rests without rates are left out. Raises NotSupported where no rest has a rate.
    """
    rates, variances = rest_rates(rests)
    near = _near(rates, variances)
    n = int(near.sum())
    wander = _wander(rates[near], variances[near])
    total = variances[near] + wander**2 * _few(n)
    weights = 1.0 / total
    bias = (weights * rates[near]).sum(axis=0) / weights.sum(axis=0)
    with_rates = [i for i, r in enumerate(rests) if r.rate is not None]
    used = [i for i, k in zip(with_rates, near.tolist(), strict=True) if k]
    return BiasEstimate(
        bias=bias,
        covariance=np.diag(1.0 / weights.sum(axis=0)),
        wander=wander,
        undetected_rotation_bound=_undetected_rotation_bound(
            [rests[i] for i in used], rates[near] - bias, total
        ),
        n_rests=len(rates),
        outliers=tuple(sorted(set(with_rates) - set(used))),
    )


def update_bias(
    model: SensorModel, rests: Sequence[RestState], known: BiasEstimate | None = None
) -> tuple[SensorModel, BiasEstimate]:
    """Update the bias of a gyroscope's model from recent rests (Grammenos et al. 2018, 4.7).

    This is a zero angular rate update (ZARU). With a `known` bias the two are averaged by their weights, the
    known one being uncertain by its covariance and its wander: a short rest then moves the bias less than a
    long one. Raises NotSupported where no rest has a rate.

    >>> sd = np.full(3, 1e-4)
    >>> rates = {"rate": np.array([0.01, -0.02, 0.0]), "rate_sd": sd, "rate_uncertainty": sd}
    >>> rest = RestState(0.0, 10.0, 500, np.array([0, 0, 9.8]), sd, sd, 1e-3, **rates)
    >>> model, estimate = update_bias(SensorModel.identity(), [rest])
    >>> model.bias.tolist(), estimate.n_rests
    ([0.01, -0.02, 0.0], 1)
    """
    fresh = bias_from_rests(rests)
    if known is not None:
        fresh = _combined(known, fresh)
    return SensorModel.of(model.scale, fresh.bias), fresh


def rotation_admitted(bias: Array, own_bound: Array, others: Sequence[RestState]) -> Array:
    """Return the error that undetected rotation may have put into a bias (3,), rad/s; inf where unbounded.

    own_bound: (3,) rad/s, by the rests that the bias was measured on, which may be of one attitude. others:
    rests in as many attitudes as are known, corrected for what the bias follows. Rotation cannot have moved
    the bias from theirs by more than it is away from that. Of each attitude the longest counts: hours in one
    of them would otherwise make outliers of all the others.
    """
    whole = bias_from_rests(_longest_by_attitude(others))
    return np.minimum(own_bound, whole.undetected_rotation_bound + np.abs(bias - whole.bias))


def _longest_by_attitude(rests: Sequence[RestState]) -> list[RestState]:
    """Return the longest of the rests of each attitude that have a rate."""
    longest: dict[int, RestState] = {}
    told = [r for r in rests if r.rate is not None]
    for rest, label in zip(
        told, attitude_labels(directions(forces(told)), _SAME_ATTITUDE).tolist(), strict=True
    ):
        if label not in longest or rest.duration > longest[label].duration:
            longest[label] = rest
    return list(longest.values())


def _combined(known: BiasEstimate, fresh: BiasEstimate) -> BiasEstimate:
    """Return the weighted mean of both; rotation cannot have moved the bias by more than it moved."""
    prior = known.covariance + np.diag(known.wander**2)
    gain = prior @ np.linalg.inv(prior + fresh.covariance)
    change = fresh.bias - known.bias
    bound = np.minimum(
        known.undetected_rotation_bound + np.abs(gain @ change), fresh.undetected_rotation_bound
    )
    return BiasEstimate(
        bias=known.bias + gain @ change,
        covariance=gain @ fresh.covariance,
        wander=np.maximum(known.wander, fresh.wander),
        undetected_rotation_bound=bound,
        n_rests=fresh.n_rests,
        outliers=fresh.outliers,
    )


def rest_rates(rests: Sequence[RestState]) -> tuple[Array, Array]:
    """Stack the mean raw rates, rad/s, and their variances, (n, 3) each, of the rests that have them.

    Raises NotSupported where no rest has a rate.
    """
    pairs = [(r.rate, r.rate_uncertainty) for r in rests if r.rate is not None]
    if not pairs:
        raise NotSupported("no rest has a gyroscope mean", ["a rest with the gyroscope on"])
    rates = np.array([rate for rate, _ in pairs], dtype=np.float64)
    sd = np.array([np.zeros(3) if u is None else u for _, u in pairs], dtype=np.float64)
    return rates, np.maximum(sd, 1e-9) ** 2


def _near(rates: Array, variances: Array) -> NDArray[np.bool_]:
    """Tell which rests are near the median, by the median absolute deviation.

    Of two, both are; and all are where none is, as in three attitudes that differ on one axis each.
    """
    if len(rates) < 3:
        return np.full(len(rates), True)
    distance = np.abs(rates - np.median(rates, axis=0))
    scatter = np.maximum(MAD_TO_SD * np.median(distance, axis=0), np.sqrt(variances))
    near: NDArray[np.bool_] = np.all(distance <= _OUTLIER * scatter, axis=1)
    return near if near.any() else np.full(len(rates), True)


def _wander(rates: Array, variances: Array) -> Array:
    """Return the standard deviation of the rests beyond their own uncertainty, (3,) rad/s."""
    if len(rates) < 2:
        return np.zeros(3)
    scatter: Array = rates.var(axis=0, ddof=1) - variances.mean(axis=0)
    return np.sqrt(np.maximum(scatter, 0.0))


def _few(n: int) -> float:
    """Return by how much the variance of n values is to be widened, as in Student's t."""
    return (n - 1) / max(n - 3, 0.5)


def _undetected_rotation_bound(rests: Sequence[RestState], away: Array, variances: Array) -> Array:
    """Return the error that undetected rotation in the rests may leave in the bias, (3,) rad/s.

    Each rest shows the bias across its vertical up to tilt_rate_limit and along it up to its
    undetected_rotation_bound. Rests of one attitude may share their rotation, as on a chair that goes on
    turning, so their number does not make it smaller. What this leaves uncertain beyond the rests' own noise
    is what rotation may have put there, and so is what attitudes differ by beyond the wander of their rests.
    away: (n, 3) rad/s, their rates off the mean, with `variances` (n, 3).
    """
    up = directions(forces(rests))
    bounds = [r.undetected_rotation_bound for r in rests]
    spin = np.array([_UNBOUNDED_SPIN if bound is None else bound for bound in bounds])
    tilt = np.array([r.tilt_rate_limit or 0.0 for r in rests])
    noise = variances.mean(axis=1)
    in_time = np.argsort([r.t_start for r in rests], kind="stable")
    attitude = np.empty(len(rests), dtype=np.intp)
    attitude[in_time] = attitude_labels(up[in_time], _SAME_ATTITUDE)
    information = np.zeros((3, 3))
    for rows in (attitude == label for label in np.unique(attitude)):
        vertical, across = (_told(noise[rows], rotation[rows]) for rotation in (spin, tilt))
        along = (up[rows].T @ up[rows]) / rows.sum()
        information += (vertical - across) * along + across * np.eye(3)
    values, vectors = np.linalg.eigh(information)
    with_rotation = vectors**2 @ (1.0 / np.maximum(values, _UNBOUNDED_SPIN**-2))
    admitted = np.maximum(with_rotation - 1.0 / (1.0 / noise).sum(), 0.0)
    undetected_rotation_bound = np.sqrt(admitted + _between_attitudes(attitude, away, variances))
    return np.where(undetected_rotation_bound > 1e-2 * _UNBOUNDED_SPIN, np.inf, undetected_rotation_bound)


def _between_attitudes(attitude: NDArray[np.intp], away: Array, variances: Array) -> Array:
    """Return the variance (3,) that the mean has where rests of one attitude err alike, beyond that stated.

    It is the cluster-robust variance of a weighted mean (Liang and Zeger, Biometrika 73, 1986).
    """
    labels, index = np.unique(attitude, return_inverse=True)
    if len(labels) < 2:
        return np.zeros(3)
    weights = 1.0 / variances
    whole = weights.sum(axis=0)
    pulls = np.stack([np.bincount(index, (weights * away)[:, a]) for a in range(3)], axis=1)
    clusters = len(labels) / (len(labels) - 1) * _few(len(labels))
    return np.asarray(np.maximum(clusters * (pulls**2).sum(axis=0) / whole**2 - 1.0 / whole, 0.0))


def _told(noise: Array, rotation: Array) -> float:
    """Return the information, s^2/rad^2, of rests with noise variances (n,) that share a rotation.

    rotation: (n,) rad/s, standard size that each admits. Rests that admit more than others are left out
    where that tells more.
    """
    order = np.argsort(rotation)
    precision = np.cumsum(1.0 / noise[order])
    return float(np.max(1.0 / (1.0 / precision + rotation[order] ** 2)))
