"""Power spectral densities by Welch's method (IEEE Trans. Audio Electroacoust. 15, 1967)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array


def densities(pieces: Sequence[Array], rate: float, segment: int) -> Array:
    """Return one-sided densities (P, segment // 2 + 1, k), unit^2/Hz, of pieces (n_i, k) at `rate` Hz.

    Each piece is of `segment` samples or more. Pieces of one length go through one call.
    """
    from scipy.signal import welch  # noqa: PLC0415 - the daemon stays light

    sizes = np.array([len(p) for p in pieces])
    out = np.empty((len(pieces), segment // 2 + 1, pieces[0].shape[1]))
    for size in np.unique(sizes):
        alike = np.stack([p for p in pieces if len(p) == size])
        out[sizes == size] = welch(alike, fs=rate, nperseg=segment, axis=1)[1]
    return out
