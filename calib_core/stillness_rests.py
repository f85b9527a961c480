"""From a run of still windows to a rest with honest uncertainties, or to the reason why it is none.

Works on the joint rows of stillness_windows (accelerometer columns, then gyroscope's); no state.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stillcal.calib_core.rests import RestState
from stillcal.calib_core.samples import Array, frozen
from stillcal.calib_core.stillness_settings import DetectorSettings, Fate
from stillcal.calib_core.stillness_windows import (
    COLUMNS,
    D2,
    HIGH,
    K_END,
    LOW,
    LSB,
    M2,
    MEAN,
    NORM_M2,
    T0,
    T1,
    TEMP,
    K,
    N,
    correlation_inflation,
)

# Student's t for a two-sided probability of 68.27 %, by degrees of freedom from 1 (JCGM 100:2008, Table G.2).
_STUDENT = np.array([1.84, 1.32, 1.20, 1.14, 1.11, 1.09, 1.08, 1.07, 1.06, 1.05])
_MIN_BATCHES = 4
_FEW_CODES = 2.5  # a range below this many steps: at most three neighbouring codes
_HELD_SHARE = 0.9  # of windows that never changed, beyond which a rest is a stuck sensor's


def judged(rows: Array, drifted: bool, settings: DetectorSettings) -> RestState | Fate:
    """Return the rest that these still windows make, or why they make none.

    rows: joint rows, shape (windows, 2 COLUMNS). drifted: no motion parts them from a neighbour.
    """
    length = (rows[:, K_END] - rows[:, K]).sum() * settings.window_s
    if length < settings.w_min_s * (1 - 1e-9):
        return Fate.SHORT
    if drifted and length < settings.settle_s:
        return Fate.TILTING
    if (rows[:, D2].sum(axis=1) == 0).mean() > _HELD_SHARE:
        return Fate.FROZEN
    slope, uncertainty = tilt(rows[:, :COLUMNS])
    if slope > max(settings.max_tilt_rate, 4.0 * uncertainty):
        return Fate.TILTING
    return _rest(rows, slope + 2.0 * uncertainty)


def _rest(rows: Array, tilt_rate_limit: float) -> RestState:
    accel, gyro = rows[:, :COLUMNS], rows[rows[:, COLUMNS + N] > 0, COLUMNS:]
    force, force_sd = weighted_mean(accel), _sd(accel)
    temperature = float(np.average(accel[:, TEMP], weights=accel[:, N]))
    return RestState(
        t_start=float(accel[0, T0]),
        t_end=float(accel[-1, T1]),
        n=int(accel[:, N].sum()),
        specific_force=frozen(force),
        force_sd=frozen(force_sd),
        force_uncertainty=frozen(mean_uncertainty(accel)),
        level=float(np.sqrt(accel[:, NORM_M2].sum() / _freedom(accel))),
        tilt_rate_limit=tilt_rate_limit,
        temperature=temperature if np.isfinite(temperature) else None,
        **(_rate_fields(gyro, force) if 2 * gyro.shape[0] >= rows.shape[0] else {}),
    )


def _rate_fields(gyro: Array, force: Array) -> dict[str, Any]:
    """Return what a rest says of the rate. All of the rate about the vertical may be rotation, not bias."""
    rate, rate_sd, uncertainty = weighted_mean(gyro), _sd(gyro), mean_uncertainty(gyro)
    up = force / np.linalg.norm(force)
    return {
        "rate": frozen(rate),
        "rate_sd": frozen(rate_sd),
        "rate_uncertainty": frozen(uncertainty),
        "rate_level": float(np.sqrt((rate_sd**2).mean())),
        "spin_admitted": float(abs(rate @ up) + 2.0 * np.linalg.norm(uncertainty * up)),
    }


def _freedom(rows: Array) -> float:
    return float(max((rows[:, N] - 1).sum(), 1.0))


def _sd(rows: Array) -> Array:
    return np.asarray(np.sqrt(rows[:, M2].sum(axis=0) / _freedom(rows)))


def weighted_mean(rows: Array) -> Array:
    """Return the mean of all samples in the rows, shape (3,)."""
    n = rows[:, N : N + 1]
    return np.asarray((n * rows[:, MEAN]).sum(axis=0) / n.sum())


def mean_uncertainty(rows: Array) -> Array:
    """Return the standard uncertainty of the mean of all samples, shape (3,), honest for coloured noise.

    The largest of: white noise inflated by the samples' lag-one correlation, and the scatter of batch means
    at every batch length that leaves at least 4 batches (fewer, where the rest is that short), each widened
    by Student's t for so few batches. What the noise remembers for longer than about 1/25 of the rest cannot
    be seen from inside it and is not in here: the scatter between rests of one attitude tells. Then the
    quantiser's own bias on top, where few codes were seen.
    """
    n = rows[:, N].sum()
    between = rows[:, N : N + 1] * (rows[:, MEAN] - weighted_mean(rows)) ** 2
    squares = (rows[:, M2] + between).sum(axis=0)
    variance = squares / (n - 1) / n * correlation_inflation(squares, rows[:, D2].sum(axis=0), n)
    variance = np.maximum(variance, _batch_variance(rows[:, N], rows[:, MEAN]))
    return np.asarray(np.sqrt(variance + _quantisation(rows) ** 2))


def _batch_variance(n: Array, means: Array) -> Array:
    """Variance of the mean by the scatter of batch means, the largest over lengths of 1, 2, 4, ... rows."""
    totals, largest = n[:, None] * means, np.zeros(3)
    while n.size >= 2:
        means = totals / n[:, None]
        off = means - means.sum(axis=0) / n.size
        student = _STUDENT[min(n.size - 2, _STUDENT.size - 1)]
        scatter = (off * off).sum(axis=0) * (student**2 / (n.size * (n.size - 1)))
        largest = np.maximum(largest, scatter)
        pairs = n.size // 2
        if pairs < _MIN_BATCHES:
            break
        n = n[0 : 2 * pairs : 2] + n[1 : 2 * pairs : 2]
        totals = totals[0 : 2 * pairs : 2] + totals[1 : 2 * pairs : 2]
    return largest


def _quantisation(rows: Array) -> Array:
    """Return the standard uncertainty that rounding leaves in the mean, however long it is averaged.

    LSB / sqrt(12) on at most three codes. With more codes the noise dithers, and of the bias there remains
    LSB / (pi sqrt 2) exp(-2 pi^2 sd^2 / LSB^2), the first term of its Fourier
    series (Widrow and Kollar 2008).
    """
    lsb = rows[:, LSB].min(axis=0)
    known = np.isfinite(lsb)
    if not known.any():
        return np.zeros(3)
    lsb = np.where(known, lsb, lsb[known].max())  # an axis that never left its code: its step is the others'
    ratio = np.minimum(_sd(rows) / lsb, 10.0)
    dithered = lsb / (np.pi * np.sqrt(2.0)) * np.exp(-2.0 * np.pi**2 * ratio**2)
    few = rows[:, HIGH].max(axis=0) - rows[:, LOW].min(axis=0) < _FEW_CODES * lsb
    return np.asarray(np.where(few, lsb / np.sqrt(12.0), dithered))


def tilt(rows: Array) -> tuple[float, float]:
    """Return how fast gravity's direction turned, rad/s, and its standard uncertainty, by least squares."""
    mean = weighted_mean(rows)
    n = rows[:, N]
    t = 0.5 * (rows[:, T0] + rows[:, T1])
    t = t - (n * t).sum() / n.sum()
    lever = float((n * t * t).sum())
    if lever == 0.0:
        return 0.0, np.inf
    off = rows[:, MEAN] - mean
    slope = ((n * t)[:, None] * off).sum(axis=0) / lever
    left = off - t[:, None] * slope
    inflation = correlation_inflation(rows[:, M2].sum(axis=0), rows[:, D2].sum(axis=0), 10.0)
    scatter = (n[:, None] * left * left).sum(axis=0) / max(rows.shape[0] - 2, 1)
    variance = np.maximum(_sd(rows) ** 2 * inflation, scatter) + _quantisation(rows) ** 2 * n.mean()
    norm = max(float(np.linalg.norm(mean)), 1e-12)
    up = mean / norm
    across = slope - up * (up @ slope)
    return float(np.linalg.norm(across)) / norm, float(np.sqrt(variance.sum() / lever)) / norm
