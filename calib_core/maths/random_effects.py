"""Random effects: the excess variance of residuals beyond their declared uncertainty, and outliers.

Rests scatter more than their own noise says (flicker noise, creep of what the phone lies on, nonlinearity of
the sensor). The excess is one variance that is added to the variance of every residual, so that intervals
keep their level. It is estimated as by DerSimonian and Laird (1986), iterated until the weighted sum of
squares equals its degrees of freedom (Paule and Mandel 1982), which for this model is close to REML.
Residuals are linear in the parameters. These functions work on plain arrays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths.student_t import quantile

_ROUNDS = 20  # most iterations; the estimate settles to a thousandth within these


def excess_variance(residuals: Array, design: Array, own: Array) -> float:
    """Return the variance to add to that of each residual; 0 where their own variances explain the scatter.

    residuals: (n,). design: (n, p), what a linear fit has taken out of them. own: (n,) variances. Where
    n <= p nothing can be said, and 0 is returned.
    """
    n, p = design.shape
    if n <= p:
        return 0.0
    excess = float("inf")
    for _ in range(_ROUNDS):
        weights = np.ones(n) if np.isinf(excess) else 1.0 / np.maximum(own + excess, 1e-300)
        unexplained, leverage = _fitted_out(residuals, design, weights)
        free = 1.0 - leverage
        estimate = float((weights @ unexplained**2 - weights @ (own * free)) / (weights @ free))
        estimate = max(estimate, 0.0)
        if abs(estimate - excess) <= 1e-3 * estimate or (estimate == 0.0 and excess == 0.0):
            return estimate
        excess = estimate
    return excess


def within_variance(residuals: Array, groups: NDArray[np.intp], own: Array) -> float:
    """Return the excess variance of residuals (n,) about the means of their groups.

    groups: (n,) numbers from 0. own: (n,) variances.
    """
    counts = np.bincount(groups)
    shared = counts[groups] > 1
    free = int(shared.sum() - (counts > 1).sum())
    if free == 0:
        return 0.0
    means = np.bincount(groups, residuals) / np.maximum(counts, 1)
    squares = float(((residuals - means[groups])[shared] ** 2).sum())
    expected = float((own * (1.0 - 1.0 / counts[groups]))[shared].sum())
    return max((squares - expected) / free, 0.0)


def outliers(residuals: Array, design: Array, variances: Array, most: int, level: float) -> list[int]:
    """Return outlying rows, worst first, by the generalised extreme Studentised deviate test.

    The test is Rosner's (1983), on residuals (n,) of a linear fit with design (n, p). Up to `most` rows are
    taken out one by one, and all up to the last significant one are outliers, so that two bad rows cannot
    hide each other. The other rows' residuals and leverage are updated for each row taken out (Cook and
    Weisberg 1982, 2.2) without a new fit. variances: (n,), of the residuals up to a common factor. level:
    probability of naming any row where none is bad.
    """
    n, p = design.shape
    white, basis = residuals / np.sqrt(variances), _orthonormal(design / np.sqrt(variances)[:, None])
    remaining, leverage, spread = white - basis @ (white @ basis), (basis**2).sum(axis=1), np.eye(p)
    removed: list[int] = []
    declared = 0
    for size in range(n, n - min(most, n - p - 2), -1):
        room, free = np.maximum(1.0 - leverage, 1e-9), size - p - 1
        deviates = _studentised(remaining, room, free, float(white @ white))
        worst = int(deviates.argmax())
        if deviates[worst] == 0.0:
            break
        removed.append(worst)
        if deviates[worst] > quantile(free, 1.0 - level / (2.0 * size)):
            declared = len(removed)
        toward = spread @ basis[worst]
        shared, step = basis @ toward, 1.0 / room[worst]
        remaining += shared * (remaining[worst] * step)
        leverage += shared * shared * step
        spread += toward[:, None] * (toward * step)
        remaining[worst] = white[worst] = basis[worst] = 0.0
    return removed[:declared]


def _studentised(residuals: Array, room: Array, free: int, total: float) -> Array:
    """Return each residual over its standard error by the other rows alone, (n,); 0 for rows removed.

    residuals: (n,). room: (n,), one less the leverage. free: degrees of freedom. total: sum of squares before
    the fit.
    """
    others = np.maximum(residuals @ residuals - residuals**2 / room, 0.0) / free
    values = np.abs(residuals) / np.sqrt(np.maximum(others, 1e-24 * max(total, 1e-280)) * room)
    return np.asarray(np.where(room > 1e-6, values, 0.0))


def _fitted_out(residuals: Array, design: Array, weights: Array) -> tuple[Array, Array]:
    """Return the residuals of a weighted linear fit, and each row's leverage on it; (n,) both."""
    root = np.sqrt(weights)
    q = _orthonormal(design * root[:, None])
    white = root * residuals
    return np.asarray((white - q @ (white @ q)) / root), np.asarray((q**2).sum(axis=1))


def _orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis (n, p) of the columns, by Cholesky, seven times as fast as QR for so few.

    Its error grows with the square of the condition number, that of QR with the number itself. Columns here
    are supported by the attitudes and have a condition below 1e3. Where Cholesky fails QR is used.
    """
    try:
        lower = np.linalg.cholesky(columns.T @ columns)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.qr(columns)[0])
    return np.asarray(columns @ np.linalg.inv(lower).T)
