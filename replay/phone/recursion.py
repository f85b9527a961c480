"""First-order recursions over many samples: what low-passes and Gauss-Markov processes are made of."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array


def decaying(driven: Array, keep: float, before: Array | float = 0.0) -> Array:
    """Return y with y[i] = keep y[i - 1] + driven[i] along the first axis; driven: (n,) or (n, k), n >= 1.

    before: y before the first sample, () or (k,). The recursion is a system of equations with two diagonals,
    which BLAS solves. It gives the same bits in one piece and in blocks that follow each other.
    `scipy.signal.lfilter` gives the same to rounding; to import it takes most of a second.

    >>> decaying(np.array([1.0, 0.0, 0.0]), 0.5).tolist()
    [1.0, 0.5, 0.25]
    """
    from scipy.linalg.blas import dtbsv  # noqa: PLC0415 - the daemon stays light

    n = len(driven) + 1
    diagonals = np.stack([np.ones(n), np.full(n, -keep)])
    out = np.empty((n, *driven.shape[1:]), order="F")
    out[0], out[1:] = before, driven
    for column in out.reshape(n, -1, order="F").T:
        column[:] = dtbsv(1, diagonals, column, lower=1, diag=1)
    return out[1:]
