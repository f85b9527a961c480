"""Power spectral densities by Welch's method (IEEE Trans. Audio Electroacoust. 15, 1967).

`scipy.signal.welch` gives the same; to import it takes most of a second, a quarter of a short diagnosis.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from stillcal.calib_core.arrays import Array


def densities(pieces: Sequence[Array], rate: float, segment: int) -> Array:
    """Return one-sided densities (P, segment // 2 + 1, k), unit^2/Hz, of pieces (n_i, k) at `rate` Hz.

    Each piece is of `segment` samples or more. Pieces of one length are transformed together.
    """
    sizes = np.array([len(p) for p in pieces])
    out = np.empty((len(pieces), segment // 2 + 1, pieces[0].shape[1]))
    for size in np.unique(sizes):
        alike = np.stack([p for p in pieces if len(p) == size])
        out[sizes == size] = _averaged(alike, rate, segment)
    return out


def _averaged(pieces: Array, rate: float, segment: int) -> Array:
    """Return densities of pieces (P, n, k): Hann windows that overlap by half, their means taken off."""
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(segment) / segment)
    by_axis = np.ascontiguousarray(pieces.swapaxes(1, 2))
    cut = sliding_window_view(by_axis, segment, axis=2)[:, :, :: segment - segment // 2]
    lines = np.fft.rfft((cut - cut.mean(axis=3, keepdims=True)) * window)
    power = (lines.real**2 + lines.imag**2).mean(axis=2).swapaxes(1, 2) / (rate * (window @ window))
    power[:, 1 : (segment + 1) // 2] *= 2.0  # all but the mean, and the last line of an even segment
    return np.asarray(power)
