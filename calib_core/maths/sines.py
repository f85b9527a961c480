"""Sines of known frequencies fitted to values and taken off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array

SINE_NUMBERS = 4
"""What is fitted for each sine: two amplitudes and how each changes, for it may fade or be off in pitch."""


STEADY_S = 20.0
"""Seconds in which a vibration keeps its amplitude and pitch, but for a straight change."""

LEAST_TOLD = 0.25
"""Part of these seconds that must tell the sines: with less, they are fitted with their neighbours."""


def without_vibrations(
    values: Array, t: Array, frequencies: Sequence[float], used: NDArray[np.bool_] | None = None
) -> Array:
    """Return values (n, k) at t (n,) s less sines of some frequencies, Hz, fitted anew every `STEADY_S`.

    used: (n,), the rows that tell the sines, None for all. Where they are too few in a part, it is joined
    with the next ones until they are enough; all rows tell the sines if these never are.
    """
    if not len(frequencies) or not t.size:
        return values
    parts = max(round(float(t[-1] - t[0]) / STEADY_S), 1)
    part = np.minimum((parts * (t - t[0]) / max(float(t[-1] - t[0]), 1e-9)).astype(np.int64), parts - 1)
    least = LEAST_TOLD * t.size / parts
    told = used if used is not None and used.sum() >= least else np.ones(t.size, dtype=np.bool_)
    part = _joined(np.asarray(np.bincount(part, told, parts), dtype=np.float64), least)[part]
    out = values.copy()
    for rows in np.split(np.arange(t.size), np.flatnonzero(np.diff(part)) + 1):
        if rows.size >= 2 * SINE_NUMBERS * len(frequencies):
            out[rows] = without_sines(values[rows], t[rows], frequencies, told[rows])
    return out


def _joined(told: NDArray[np.float64], least: float) -> NDArray[np.int64]:
    """Return for each part (n,) the first of those that are fitted together, with `least` rows or more."""
    first, since = np.zeros(told.size, dtype=np.int64), 0
    before = np.concatenate([[0.0], np.cumsum(told)])
    for k in range(told.size):
        first[k] = since
        if before[k + 1] - before[since] >= least and before[-1] - before[k + 1] >= least:
            since = k + 1
    return first


def without_sines(
    values: Array, t: Array, frequencies: Sequence[float], used: NDArray[np.bool_] | None = None
) -> Array:
    """Return values (n, k) at t (n,) less the least-squares sines of these frequencies, all fitted together.

    Frequencies are in turns per unit of t. Amplitude and phase change in proportion to time. used: (n,), the
    rows that are fitted, None for all. A straight line is fitted beside them, and stays; each run of rows
    that are fitted has a level of its own, as rests in several attitudes have.
    """
    phase = 2.0 * np.pi * np.outer(t - t[0], frequencies)
    steady = np.hstack([np.cos(phase), np.sin(phase)])
    along = np.linspace(-1.0, 1.0, t.size)[:, None]
    sines = np.hstack([steady, steady * along])
    rows = np.ones(t.size, dtype=np.bool_) if used is None else used
    run = np.cumsum(np.diff(rows, prepend=rows[:1]))[rows]
    levels = (run[:, None] == np.unique(run)).astype(np.float64)
    columns = np.hstack([sines[rows], along[rows], levels])
    fitted = np.linalg.lstsq(columns, values[rows], rcond=None)[0]
    return np.asarray(values - sines @ fitted[: sines.shape[1]])
