"""Sines of known frequencies fitted to values and taken off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array

SINE_NUMBERS = 4
"""What is fitted for each sine: two amplitudes and how each changes, for it may fade or be off in pitch."""


def without_sines(values: Array, t: Array, frequencies: Sequence[float]) -> Array:
    """Return values (n, k) at t (n,) less the least-squares sines of these frequencies, all fitted together.

    Frequencies are in turns per unit of t. Amplitude and phase change in proportion to time.
    """
    phase = 2.0 * np.pi * np.outer(t - t[0], frequencies)
    steady = np.hstack([np.cos(phase), np.sin(phase)])
    columns = np.hstack([steady, steady * np.linspace(-1.0, 1.0, t.size)[:, None]])
    return np.asarray(values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0])
