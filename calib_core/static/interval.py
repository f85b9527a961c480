"""Runs of still windows, and the rests that they make.

A run collects still windows one after another as long as their means agree. A window whose mean differs from
the running mean by more than noise explains ends the run, so that a phone turned gently between two windows
does not join two attitudes. Running sums are strictly sequential (cumulative), hence the same however many
windows come at a time. `rest_from_windows` turns a closed run into a rest with its uncertainties, or into the
label that says why it is none. Rows are those of windows.py: accelerometer columns, then the gyroscope's.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.static.settings import DetectorSettings, Label
from stillcal.calib_core.static.windows import (
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
    no_rows,
)

Flags = NDArray[np.bool_]

_SUMS = 11  # per sensor: samples, degrees of freedom, samples x mean (3), squares (3), squared steps (3)
_MOTION = (Label.ACCEL_MOVING, Label.GYRO_MOVING, Label.STEPPED, Label.IMPLAUSIBLE)
# Student's t for a two-sided probability of 68.27 %, by degrees of freedom from 1 (JCGM 100:2008, Table G.2).
_STUDENT = np.array([1.84, 1.32, 1.20, 1.14, 1.11, 1.09, 1.08, 1.07, 1.06, 1.05])

_INFLATION = 10.0
"""Largest inflation of a mean's variance by correlated noise: that of a correlation of 0.82 from sample to
sample, as behind a first-order low-pass at 3 % of the sampling rate. Slower change counts as motion."""

_MIN_BATCHES = 4
"""The standard deviation of four batch means is uncertain by 40 %, that of fewer by more."""

_SIGNIFICANT = 4.0
"""Standard uncertainties beyond which a tilt is real: normal noise exceeds them in 1 rest of 16 000 at most,
where all of it is on one axis."""

_COVERAGE = 2.0
"""Standard uncertainties added to a bound, for 95 % coverage (JCGM 100:2008, 6.2)."""

_HELD_SHARE = 0.9
"""Share of windows without any change beyond which the sensor counts as stuck. A coarse sensor at rest still
changes its code now and then; a stuck one changes it only where it came to life."""

_TWO_CODES = 1.5
"""Steps of the quantiser: a range below this holds two neighbouring codes at most. They do not show how large
the noise is beneath them."""

_BY_PLACE = 0.05
"""In LSB^2. With noise of 0.15 LSB and more at least 93 % of intervals then hold, wherever the mean lies;
without it, of 0.25 LSB, in long rests nearly none where it lies near the middle between two codes."""

_NO_ROWS, _NO_SUMS = no_rows(2 * COLUMNS), frozen(np.zeros(2 * _SUMS))


@dataclass(slots=True)
class Run:
    """The windows of a run so far.

    rows: (windows, 2 COLUMNS) joint rows. sums: (2 _SUMS,) over them. after: what ended the run before.
    """

    rows: Array = field(default_factory=lambda: _NO_ROWS)
    sums: Array = field(default_factory=lambda: _NO_SUMS)
    after: Label = Label.STILL

    @property
    def cells(self) -> int:
        """The length so far in cells of the grid."""
        return int((self.rows[:, K_END] - self.rows[:, K]).sum()) if self.rows.shape[0] else 0


def contributions(rows: Array) -> Array:
    """Return what joint rows (n, 2 COLUMNS) add to a run's sums, (2 _SUMS, n)."""
    own = np.zeros((2 * _SUMS, rows.shape[0]))
    for i in range(2):
        half, out = rows[:, i * COLUMNS : (i + 1) * COLUMNS], own[i * _SUMS : (i + 1) * _SUMS]
        n = half[:, N]
        if i and not n.any():
            break  # no gyroscope
        out[0] = n
        np.maximum(n - 1.0, 0.0, out=out[1])
        np.multiply(n, half[:, MEAN].T, out=out[2:5])
        out[5:11] = half[:, M2.start : D2.stop].T
    return own


def _steps_off(rows: Array, before: Array, own: Array, factor: float, allowance: float) -> Flags:
    """Tell which windows' means differ from the mean of all windows before. before, own: sums, (_SUMS, n)."""
    n, n_own = before[0], own[0]
    pool = before + own
    squares, steps = pool[5] + pool[6] + pool[7], pool[8] + pool[9] + pool[10]
    variance = squares / np.maximum(pool[1], 1.0)
    variance *= correlation_inflation(squares, steps, _INFLATION)
    samples = np.maximum(n, 1.0)
    variance *= 1.0 / samples + 1.0 / np.maximum(n_own, 1.0)
    off = rows[:, MEAN].T - before[2:5] / samples
    off *= off
    distance = np.sqrt(off[0] + off[1] + off[2])
    return np.asarray((distance > factor * np.sqrt(variance) + allowance) & (n > 0) & (n_own > 0))


def absorb(
    run: Run, rows: Array, own: Array, coarse: tuple[float, float], settings: DetectorSettings
) -> tuple[Run, int]:
    """Add the leading rows that agree with the run; return the run and how many rows were added.

    own: the rows' `contributions`. coarse: standard uncertainty that coarse quantisation alone puts into a
    mean, m/s^2 and rad/s.
    """
    running = np.empty((2 * _SUMS, rows.shape[0] + 1))
    running[:, 0], running[:, 1:] = run.sums, own
    np.add.accumulate(running, axis=1, out=running)
    taken = rows.shape[0]
    allowances = (settings.force_step, settings.rate_step)
    for i, part in enumerate((slice(0, _SUMS), slice(_SUMS, 2 * _SUMS))):
        if i and not running[_SUMS, -1]:
            break  # no gyroscope, in the run or in these
        half = rows[:, i * COLUMNS : (i + 1) * COLUMNS]
        allowance = allowances[i] + settings.step_factor * coarse[i]
        off = _steps_off(half, running[part, :-1], own[part], settings.step_factor, allowance)
        taken = min(taken, int(off.argmax())) if off.any() else taken
    gathered = np.concatenate((run.rows, rows[:taken])) if run.rows.shape[0] else rows[:taken]
    return Run(gathered, frozen(running[:, taken].copy()), run.after), taken


def trimmed(run: Run, ended_by: Label) -> Array:
    """Return the rows without the windows next to motion, which may hold its first or last samples."""
    first = int(run.after in _MOTION)
    last = run.rows.shape[0] - int(ended_by in _MOTION)
    return run.rows[first : max(last, first)]


def drifted(run: Run, ended_by: Label) -> bool:
    """Tell whether the run began or ended because its mean drifted, rather than by motion."""
    return Label.STEPPED in (run.after, ended_by)


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """One sensor's windows of a rest, with the sums over them.

    columns: (COLUMNS, windows), a statistic's values lying side by side; n: samples; total: n x mean, (3,
    windows); mean, m2, d2: (3,), of all samples; m2: about the windows' own means.
    """

    columns: Array
    n: float
    total: Array
    mean: Array
    m2: Array
    d2: Array

    @classmethod
    def of(cls, rows: Array) -> _Sums:
        """Sum over rows (windows, COLUMNS)."""
        columns = np.ascontiguousarray(rows.T)
        n = float(np.add.reduce(columns[N]))
        total = columns[N] * columns[MEAN]
        squares = np.add.reduce(columns[M2.start : D2.stop], axis=1)
        return cls(columns, n, total, np.add.reduce(total, axis=1) / n, squares[:3], squares[3:])

    @property
    def freedom(self) -> float:
        """Degrees of freedom about the windows' own means, at least 1."""
        return float(max(self.n - self.columns.shape[1], 1.0))

    @property
    def variance(self) -> Array:
        """Variance of single samples about their windows' means, (3,)."""
        return self.m2 / self.freedom


def rest_from_windows(rows: Array, drifted: bool, settings: DetectorSettings) -> RestState | Label:
    """Return the rest that still windows make, or the label that says why they make none.

    rows: (windows, 2 COLUMNS) joint rows. drifted: the run began or ended without motion.
    """
    length = float(np.add.reduce(rows[:, K_END] - rows[:, K])) * settings.window_s
    if length < settings.w_min_s * (1 - 1e-9):
        return Label.SHORT
    if drifted and length < settings.settle_s:
        return Label.TILTING
    accel = _Sums.of(rows[:, :COLUMNS])
    if np.count_nonzero(~accel.columns[D2].any(axis=0)) > _HELD_SHARE * rows.shape[0]:
        return Label.FROZEN
    bias = _quantisation(accel)
    slope, uncertainty = _tilt(accel, bias)
    if slope > max(settings.max_tilt_rate, _SIGNIFICANT * uncertainty):
        return Label.TILTING
    gyro = rows[rows[:, COLUMNS + N] > 0, COLUMNS:]
    rates = _Sums.of(gyro) if 2 * gyro.shape[0] >= rows.shape[0] else None
    return _rest(accel, bias, rates, slope + _COVERAGE * uncertainty)


def _rest(accel: _Sums, bias: Array, gyro: _Sums | None, tilt_rate_limit: float) -> RestState:
    """Put the rest together. bias: (3,) m/s^2, what rounding leaves in the mean force."""
    columns = accel.columns
    temperature = float((columns[N] * columns[TEMP]).sum() / accel.n)
    return RestState(
        t_start=float(columns[T0, 0]),
        t_end=float(columns[T1, -1]),
        n=int(accel.n),
        specific_force=frozen(accel.mean),
        force_sd=frozen(np.sqrt(accel.variance)),
        force_uncertainty=frozen(_mean_uncertainty(accel, bias)),
        level=float(np.sqrt(columns[NORM_M2].sum() / accel.freedom)),
        tilt_rate_limit=tilt_rate_limit,
        temperature=temperature if np.isfinite(temperature) else None,
        **(_rate_fields(gyro, accel.mean) if gyro is not None else {}),
    )


def _rate_fields(gyro: _Sums, force: Array) -> dict[str, Any]:
    """Return a rest's fields on the rate. All of the rate about the vertical may be rotation, not bias."""
    rate, uncertainty = gyro.mean, _mean_uncertainty(gyro, _quantisation(gyro))
    up = force / np.linalg.norm(force)
    return {
        "rate": frozen(rate),
        "rate_sd": frozen(np.sqrt(gyro.variance)),
        "rate_uncertainty": frozen(uncertainty),
        "rate_level": float(np.sqrt(gyro.variance.mean())),
        "undetected_rotation_bound": float(abs(rate @ up) + _COVERAGE * np.linalg.norm(uncertainty * up)),
    }


def _mean_uncertainty(sums: _Sums, bias: Array) -> Array:
    """Return the standard uncertainty of the mean of all samples, (3,), with coloured noise allowed for.

    It is the largest of two estimates: white noise inflated by the samples' lag-one correlation, and the
    scatter of batch means at every batch length that leaves at least 4 batches (fewer where the rest is that
    short), each widened by Student's t for so few batches. Noise with a memory longer than about 1/25 of the
    rest cannot be seen from inside it and is not included; the scatter between rests of one attitude shows
    it. `bias`, (3,), what rounding leaves in the mean, is added in square.
    """
    off, n = sums.columns[MEAN] - sums.mean[:, None], sums.n
    squares = sums.m2 + np.add.reduce(sums.columns[N] * off * off, axis=1)
    variance = squares / (n - 1) / n * correlation_inflation(squares, sums.d2, n)
    variance = np.maximum(variance, _batch_variance(sums.columns[N], sums.columns[MEAN], sums.total))
    return np.asarray(np.sqrt(variance + bias * bias))


def _batch_variance(n: Array, means: Array, totals: Array) -> Array:
    """Return the largest variance of the mean by the scatter of batch means of 1, 2, 4, ... windows.

    n: (windows,); means, totals: (3, windows), totals = n x means.
    """
    largest = np.zeros(3)
    while n.size >= 2:
        off = means - np.add.reduce(means, axis=1, keepdims=True) / n.size
        student = _STUDENT[min(n.size - 2, _STUDENT.size - 1)]
        scatter = np.add.reduce(off * off, axis=1) * (student**2 / (n.size * (n.size - 1)))
        largest = np.maximum(largest, scatter)
        end = n.size // 2 * 2
        if end < 2 * _MIN_BATCHES:
            break
        n = n[0:end:2] + n[1:end:2]
        totals = totals[:, 0:end:2] + totals[:, 1:end:2]
        means = totals / n
    return largest


def _quantisation(sums: _Sums) -> Array:
    """Return the standard uncertainty that rounding leaves in the mean, however long it is averaged.

    On one or two codes it is LSB / sqrt(12). On more the noise acts as dither, and the bias that remains is
    LSB / (pi sqrt 2) exp(-2 pi^2 sd^2 / LSB^2), the first term of its Fourier series (Widrow and Kollar 2008,
    Quantization Noise). sd is that of the noise before rounding, at the least: by Sheppard's correction, less
    what the variance may owe to where the mean lies between two codes.
    """
    columns = sums.columns
    lsb = np.minimum.reduce(columns[LSB], axis=1)
    known = np.isfinite(lsb)
    if not known.any():
        return np.zeros(3)
    if not known.all():
        lsb = np.where(
            known, lsb, lsb[known].max()
        )  # an axis that never changed has no step: take the others'
    before_rounding = np.clip(sums.variance / lsb**2 - 1.0 / 12.0 - _BY_PLACE, 0.0, 10.0)
    dithered = lsb / (np.pi * np.sqrt(2.0)) * np.exp(-2.0 * np.pi**2 * before_rounding)
    reach = np.maximum.reduce(columns[HIGH], axis=1) - np.minimum.reduce(columns[LOW], axis=1)
    return np.asarray(np.where(reach < _TWO_CODES * lsb, lsb / np.sqrt(12.0), dithered))


def _tilt(sums: _Sums, bias: Array) -> tuple[float, float]:
    """Return how fast gravity's direction turned, and its standard uncertainty, rad/s, by least squares."""
    n, windows = sums.columns[N], sums.columns.shape[1]
    t = 0.5 * (sums.columns[T0] + sums.columns[T1])
    t = t - (n * t).sum() / sums.n
    weighted = n * t
    lever = float((weighted * t).sum())
    if lever == 0.0:
        return 0.0, np.inf
    off = sums.columns[MEAN] - sums.mean[:, None]
    slope = np.add.reduce(weighted * off, axis=1) / lever
    left = off - t * slope[:, None]
    inflation = correlation_inflation(sums.m2, sums.d2, _INFLATION)
    scatter = np.add.reduce(n * left * left, axis=1) / max(windows - 2, 1)
    variance = np.maximum(sums.variance * inflation, scatter) + bias * bias * (sums.n / windows)
    norm = max(float(np.linalg.norm(sums.mean)), 1e-12)
    up = sums.mean / norm
    across = slope - up * (up @ slope)
    return float(np.linalg.norm(across)) / norm, float(np.sqrt(variance.sum() / lever)) / norm
