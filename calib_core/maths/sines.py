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
"""Part of these seconds that tells a straight change of the whole: beyond it a line is drawn out fourfold."""


def without_vibrations(
    values: Array, t: Array, frequencies: Sequence[float], used: NDArray[np.bool_] | None = None
) -> Array:
    """Return values (n, k) at t (n,) s less sines of some frequencies, Hz, fitted anew every `STEADY_S`.

    used: (n,), the rows that tell the sines, None for all; where they are too few of a part, all of it do.
    """
    if not len(frequencies) or not t.size:
        return values
    parts = max(round(float(t[-1] - t[0]) / STEADY_S), 1)
    part = np.minimum((parts * (t - t[0]) / max(float(t[-1] - t[0]), 1e-9)).astype(np.int64), parts - 1)
    out = values.copy()
    for rows in np.split(np.arange(t.size), np.flatnonzero(np.diff(part)) + 1):
        told = None if used is None or used[rows].mean() < LEAST_TOLD else used[rows]
        if rows.size >= 2 * SINE_NUMBERS * len(frequencies):
            out[rows] = without_sines(values[rows], t[rows], frequencies, told)
    return out


def without_sines(
    values: Array, t: Array, frequencies: Sequence[float], used: NDArray[np.bool_] | None = None
) -> Array:
    """Return values (n, k) at t (n,) less the least-squares sines of these frequencies, all fitted together.

    Frequencies are in turns per unit of t. Amplitude and phase change in proportion to time. used: (n,), the
    rows that are fitted, None for all. A straight line is fitted beside them, and stays.
    """
    phase = 2.0 * np.pi * np.outer(t - t[0], frequencies)
    steady = np.hstack([np.cos(phase), np.sin(phase)])
    along = np.linspace(-1.0, 1.0, t.size)[:, None]
    sines = np.hstack([steady, steady * along])
    columns = np.hstack([sines, np.ones_like(along), along])
    rows = slice(None) if used is None else used
    fitted = np.linalg.lstsq(columns[rows], values[rows], rcond=None)[0]
    return np.asarray(values - sines @ fitted[: sines.shape[1]])
