"""The gyroscope's bias from rests, and what rotation those rests may have hidden in it.

At rest a gyroscope reads its bias. What turns slowly and steadily reads as bias too: about a horizontal
axis gravity's direction betrays it, about the vertical nothing does (RestState.spin_admitted). Rests in
different attitudes put the vertical along different axes of the body and so bound it. A bias that
follows gravity (g-sensitivity) shows here as wander between attitudes, not as a bias of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import NotSupported
from stillcal.calib_core.model import SensorModel
from stillcal.calib_core.static.rest import RestState, forces

_OUTLIER = 4.5  # robust standard deviations; 1 in 150 000 normal draws lies beyond
_MAD_TO_SD = 1.4826  # of a normal distribution
_UNBOUNDED_SPIN = 1e3  # rad/s; stands for "nothing bounds it", far beyond any gyroscope's range


@dataclass(frozen=True, slots=True, eq=False)
class BiasEstimate:
    """Bias of a gyroscope. bias: (3,) raw rad/s. covariance: (3, 3) of that mean.

    wander: (3,) rad/s, how far the bias of single rests strays from it beyond their own uncertainty.
    admitted: (3,) rad/s, standard size of the error that slow rotation in the rests may have put into
    each axis unseen; inf where nothing bounds it. n_rests: rests with rates. outliers: indices of those
    left out, for having turned or jumped.
    """

    bias: Array
    covariance: Array
    wander: Array
    undetected_rotation_bound: Array
    n_rests: int
    outliers: tuple[int, ...] = ()


def bias_from_rests(rests: Sequence[RestState]) -> BiasEstimate:
    """Estimate the bias from rests' mean rates, weighted by their uncertainty plus the wander between.

    A random-effects mean (DerSimonian and Laird 1986) of the rests within 4.5 robust standard deviations
    of the median. What the wander adds to the covariance is widened as Student's t has it for few rests.
    Rests without rates are passed over. Raises NotSupported where none has any.
    """
    rates, variances = rest_rates(rests)
    kept = _near(rates, variances)
    n = int(kept.sum())
    wander = _wander(rates[kept], variances[kept])
    total = variances[kept] + wander**2 * (n - 1) / max(n - 3, 0.5)
    weights = 1.0 / total
    bias = (weights * rates[kept]).sum(axis=0) / weights.sum(axis=0)
    with_rates = [i for i, r in enumerate(rests) if r.rate is not None]
    used = [i for i, k in zip(with_rates, kept.tolist(), strict=True) if k]
    return BiasEstimate(
        bias=bias,
        covariance=np.diag(1.0 / weights.sum(axis=0)),
        wander=wander,
        undetected_rotation_bound=_undetected_rotation_bound([rests[i] for i in used], total),
        n_rests=len(rates),
        outliers=tuple(sorted(set(with_rates) - set(used))),
    )


def update_bias(
    model: SensorModel, rests: Sequence[RestState], known: BiasEstimate | None = None
) -> tuple[SensorModel, BiasEstimate]:
    """Renew the bias of a gyroscope's model from recent rests (Grammenos et al. 2018, 4.7).

    With a `known` bias the rests are weighed against it, it being uncertain by its covariance and its
    wander: a short rest then moves the bias less than a long one. Raises NotSupported without rates.

    >>> sd = np.full(3, 1e-4)
    >>> told = {"rate": np.array([0.01, -0.02, 0.0]), "rate_sd": sd, "rate_uncertainty": sd}
    >>> rest = RestState(0.0, 10.0, 500, np.array([0, 0, 9.8]), sd, sd, 1e-3, **told)
    >>> model, estimate = update_bias(SensorModel.identity(), [rest])
    >>> model.bias.tolist(), estimate.n_rests
    ([0.01, -0.02, 0.0], 1)
    """
    fresh = bias_from_rests(rests)
    if known is not None:
        fresh = _combined(known, fresh)
    return SensorModel.of(model.scale, fresh.bias), fresh


def _combined(known: BiasEstimate, fresh: BiasEstimate) -> BiasEstimate:
    """Weigh both; hidden rotation cannot have moved the bias by more than it moved."""
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
    """Stack the mean raw rates and their variances, (n, 3) each, of the rests that have any.

    Raises NotSupported where none has.
    """
    pairs = [(r.rate, r.rate_uncertainty) for r in rests if r.rate is not None]
    if not pairs:
        raise NotSupported("no rest has a gyroscope mean", ["a rest with the gyroscope on"])
    rates = np.array([rate for rate, _ in pairs], dtype=np.float64)
    sd = np.array([np.zeros(3) if u is None else u for _, u in pairs], dtype=np.float64)
    return rates, np.maximum(sd, 1e-9) ** 2


def _near(rates: Array, variances: Array) -> NDArray[np.bool_]:
    """Tell which rests lie near the median, by the median absolute deviation; of two, both do."""
    if len(rates) < 3:
        return np.full(len(rates), True)
    distance = np.abs(rates - np.median(rates, axis=0))
    scatter = np.maximum(_MAD_TO_SD * np.median(distance, axis=0), np.sqrt(variances))
    near: NDArray[np.bool_] = np.all(distance <= _OUTLIER * scatter, axis=1)
    return near


def _wander(rates: Array, variances: Array) -> Array:
    """Scatter of the rests beyond their own uncertainty, per axis, rad/s."""
    if len(rates) < 2:
        return np.zeros(3)
    scatter: Array = rates.var(axis=0, ddof=1) - variances.mean(axis=0)
    return np.sqrt(np.maximum(scatter, 0.0))


def _undetected_rotation_bound(rests: Sequence[RestState], variances: Array) -> Array:
    """Error that rotation hidden in the rests may leave in the bias, per axis, rad/s.

    Each rest tells the bias across its vertical up to tilt_rate_limit and along it up to spin_admitted;
    what that leaves open beyond the rests' own noise is what rotation may have put there.
    """
    up = forces(rests)
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    along = up[:, :, None] * up[:, None, :]
    bounds = [r.undetected_rotation_bound for r in rests]
    spin = np.array([_UNBOUNDED_SPIN if bound is None else bound for bound in bounds])
    tilt = np.array([r.tilt_rate_limit or 0.0 for r in rests])
    noise = variances.mean(axis=1)
    vertical, across = (1.0 / (noise + hidden**2) for hidden in (spin, tilt))
    information = np.einsum("k,kij->ij", vertical - across, along) + across.sum() * np.eye(3)
    values, vectors = np.linalg.eigh(information)
    with_rotation = vectors**2 @ (1.0 / np.maximum(values, _UNBOUNDED_SPIN**-2))
    undetected_rotation_bound = np.sqrt(np.maximum(with_rotation - 1.0 / (1.0 / noise).sum(), 0.0))
    return np.where(undetected_rotation_bound > 1e-2 * _UNBOUNDED_SPIN, np.inf, undetected_rotation_bound)
