"""What residuals scatter beyond their declared uncertainty, and which of them do not belong.

Rests wander more than their own noise says (flicker, creep of what the phone lies on, a sensor that is not
quite linear). The excess is one variance added to every residual's own, so that intervals stay honest; it is
estimated as DerSimonian and Laird do, iterated until the weighted sum of squares equals its degrees of
freedom (Paule and Mandel 1982), which for this model is close to REML. Residuals are linear in the
parameters here. Works on plain arrays; knows no sensor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths.student_t import quantile

_ROUNDS = 20


def excess_variance(residuals: Array, design: Array, own: Array) -> float:
    """Return the variance to add to each residual's own; 0 where their own explains the scatter.

    residuals: (n,); design: (n, p), what a linear fit may still take out of them; own: (n,) variances.
    Nothing can be said, and 0 is returned, where n <= p.
    """
    n, p = design.shape
    if n <= p:
        return 0.0
    excess = float("inf")
    for _ in range(_ROUNDS):
        weights = np.ones(n) if np.isinf(excess) else 1.0 / np.maximum(own + excess, 1e-300)
        left, leverage = _fitted_out(residuals, design, weights)
        free = 1.0 - leverage
        found = float((weights @ left**2 - weights @ (own * free)) / (weights @ free))
        found = max(found, 0.0)
        if abs(found - excess) <= 1e-3 * found or (found == 0.0 and excess == 0.0):
            return found
        excess = found
    return excess


def within_variance(residuals: Array, groups: NDArray[np.intp], own: Array) -> float:
    """Return the excess variance of residuals that share a group, (n,) numbered from 0, about its mean."""
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
    """Return the rows that do not belong, worst first: the generalised extreme Studentised deviate test.

    (Rosner 1983, on residuals of a linear fit.) Up to `most` rows are taken out one by one, and as many
    declared outliers as the last significant one, so that two bad rows cannot hide each other. What is left
    of the others and their leverage follow from the row that goes (Cook and Weisberg 1982, 2.2), unfitted.
    level: chance of naming any row where none is bad. variances: (n,), relative to each other is enough.
    """
    n, p = design.shape
    white, basis = residuals / np.sqrt(variances), _orthonormal(design / np.sqrt(variances)[:, None])
    left, leverage, spread = white - basis @ (white @ basis), (basis**2).sum(axis=1), np.eye(p)
    gone: list[int] = []
    declared = 0
    for size in range(n, n - min(most, n - p - 2), -1):
        room, free = np.maximum(1.0 - leverage, 1e-9), size - p - 1
        deviates = _studentised(left, room, free, float(white @ white))
        worst = int(deviates.argmax())
        if deviates[worst] == 0.0:
            break
        gone.append(worst)
        if deviates[worst] > quantile(free, 1.0 - level / (2.0 * size)):
            declared = len(gone)
        toward = spread @ basis[worst]
        shared, step = basis @ toward, 1.0 / room[worst]
        left += shared * (left[worst] * step)
        leverage += shared * shared * step
        spread += toward[:, None] * (toward * step)
        left[worst] = white[worst] = basis[worst] = 0.0
    return gone[:declared]


def _studentised(left: Array, room: Array, free: int, given: float) -> Array:
    """Return each residual over its standard error as the other rows alone give it; rows gone have 0.

    left: (n,), what the fit leaves; room: (n,), one less the leverage; given: sum of squares before the fit.
    """
    rest = np.maximum(left @ left - left**2 / room, 0.0) / free
    values = np.abs(left) / np.sqrt(np.maximum(rest, 1e-24 * max(given, 1e-280)) * room)
    return np.asarray(np.where(room > 1e-6, values, 0.0))


def _fitted_out(residuals: Array, design: Array, weights: Array) -> tuple[Array, Array]:
    """Return what a weighted linear fit leaves of the residuals, and each row's leverage on it; (n,) both."""
    root = np.sqrt(weights)
    q = _orthonormal(design * root[:, None])
    white = root * residuals
    return np.asarray((white - q @ (white @ q)) / root), np.asarray((q**2).sum(axis=1))


def _orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis (n, p) of the columns: by Cholesky, seven times as fast as a QR of so few.

    It loses the square of the columns' condition where QR loses the condition; what comes here is supported
    by the attitudes, below 1e3. Where even Cholesky fails QR is asked.
    """
    try:
        lower = np.linalg.cholesky(columns.T @ columns)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.qr(columns)[0])
    return np.asarray(columns @ np.linalg.inv(lower).T)
