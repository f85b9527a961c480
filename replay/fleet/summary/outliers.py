"""Outlier devices: robust Mahalanobis distance from the other devices of the fleet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths.robust import MAD_TO_SD

LEVEL = 0.01
"""Probability that a fleet without outliers has any device named."""

_LEAST = 5  # devices per parameter below which a covariance is not to be had robustly


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """Distances of devices from the fleet.

    squared: (n,), each including its device's own uncertainty. limit: a larger one is an outlier.

    robust: whether the centre and covariance are of the half that agrees best, or, in a fleet too small for
    that, medians and median deviations of each parameter alone.
    """

    squared: Array
    limit: float
    robust: bool

    @property
    def outliers(self) -> Array:
        """Rows beyond the limit, farthest first."""
        outside = np.flatnonzero(self.squared > self.limit)
        return np.asarray(outside[np.argsort(-self.squared[outside])])


def distances(values: Array, covariances: Array, level: float = LEVEL) -> Distances:
    """Return distances of devices (n, p) with own covariances (n, p, p).

    Minimum covariance determinant (Rousseeuw and Van Driessen 1999) with the F limit of Hardin and Rocke
    (2005); in a fleet too small, medians, the limit widened until sound fleets of 16 and 25 stayed within it.
    level: for the fleet as a whole (Bonferroni).
    """
    from scipy.stats import chi2, f  # noqa: PLC0415 - only a fleet needs it

    n, p = values.shape
    tail = level / max(n, 1)
    if n >= _LEAST * p:
        from sklearn.covariance import MinCovDet  # noqa: PLC0415 - an extra

        estimate = MinCovDet(random_state=0).fit(values)
        freedom = max(_degrees_of_freedom(n, p), p + 1.0)
        limit = p * freedom / (freedom - p + 1.0) * float(f.isf(tail, p, freedom - p + 1.0))
        return Distances(_against(values, estimate.location_, estimate.covariance_, covariances), limit, True)
    centre = np.median(values, axis=0)
    sd = MAD_TO_SD * np.median(np.abs(values - centre), axis=0)
    squared = _against(values, centre, np.diag(np.maximum(sd, 1e-9) ** 2), covariances)
    return Distances(squared, float(chi2.isf(tail, p)) * (1.0 + 15.0 / max(n - p, 1)) ** 2, False)


def _against(values: Array, centre: Array, covariance: Array, own: Array) -> Array:
    off = values - centre
    return np.asarray(np.einsum("ij,ij->i", off, np.linalg.solve(covariance + own, off[:, :, None])[:, :, 0]))


def _degrees_of_freedom(n: int, p: int) -> float:
    """Return those of the Wishart that the MCD's covariance is like (Hardin and Rocke 2005, Eq. 3.3-3.4)."""
    from scipy.stats import chi2  # noqa: PLC0415 - only a fleet needs it

    h = (n + p + 1) // 2
    alpha = (n - h) / n
    q = float(chi2.ppf(1.0 - alpha, p))
    c_alpha = (1.0 - alpha) / float(chi2.cdf(q, p + 2))
    c2 = -float(chi2.cdf(q, p + 2)) / 2.0
    c3 = -float(chi2.cdf(q, p + 4)) / 2.0
    c4 = 3.0 * c3
    b1 = c_alpha * (c3 - c4) / (1.0 - alpha)
    b2 = 0.5 + c_alpha / (1.0 - alpha) * (c3 - q / p * (c2 + (1.0 - alpha) / 2.0))
    v1 = (1.0 - alpha) * b1**2 * (alpha * (c_alpha * q / p - 1.0) ** 2 - 1.0)
    v1 -= 2.0 * c3 * c_alpha**2 * (3.0 * (b1 - p * b2) ** 2 + (p + 2.0) * b2 * (2.0 * b1 - p * b2))
    v2 = n * (b1 * (b1 - p * b2) * (1.0 - alpha)) ** 2 * c_alpha**2
    asymptotic = 2.0 / (c_alpha**2 * v1 / v2)
    return float(asymptotic * np.exp(0.725 - 0.00663 * p - 0.0780 * np.log(n)))
