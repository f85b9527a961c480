"""Optical truth beside the gyroscope: what cameras say of it, where they watched (BROAD, Laidig et al. 2021).

Over every second the gyroscope's turn is held against the cameras'. What is left is fitted with a bias and
nine numbers of scale and misalignment, then with squares of the rate as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.maths.rotation import attitudes, matrix
from stillcal.replay.real_data.sources import Source

WINDOW_S = 1.0
"""Length of the windows that are compared, s."""


@dataclass(frozen=True, slots=True)
class OpticalComparison:
    """Over `seconds` windows: rms of what is left of a turn, degrees, as it is and with each model off."""

    seconds: int
    raw: float
    affine: float
    squares: float


def compare_with_cameras(source: Source) -> OpticalComparison | None:
    """Compare a recording's gyroscope with its cameras, None where there were none."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - heavy, and only here

    gyroscope = source.recording.gyroscope
    if source.optical is None or gyroscope is None:
        return None
    known = np.asarray(np.isfinite(source.optical).all(axis=1))
    n = round(WINDOW_S / float(np.median(np.diff(gyroscope.t))))
    misses, designs = [], []
    for first in range(0, len(gyroscope) - n, n):
        rows = slice(first, first + n + 1)
        if not known[rows].all():
            continue
        t, rate = gyroscope.t[rows], gyroscope.xyz[rows]
        start, end = Rotation.from_quat(source.optical[[first, first + n]][:, [1, 2, 3, 0]])
        turn = matrix(attitudes(t, rate))
        watched = (start.inv() * end).as_matrix()
        misses.append(Rotation.from_matrix(turn[-1].T @ watched).as_rotvec())
        designs.append(_columns(turn, t, rate))
    y, design = np.array(misses), np.array(designs)
    if len(y) < design.shape[2]:
        return None
    residuals = (y, _residual(y, design[:, :, :12]), _residual(y, design))
    raw, affine, squares = (float(np.degrees(np.sqrt((x**2).sum() / len(y)))) for x in residuals)
    return OpticalComparison(len(y), raw, affine, squares)


def _columns(turn: Array, t: Array, rate: Array) -> Array:
    """Return what bias, scale and misalignment, and squares do to a turn at its end, (3, 3 + 9 + 3) rad."""
    propagated = np.einsum("ki,nkj->nij", turn[-1], turn) * np.gradient(t)[:, None, None]
    # The mean step at either end counts half: a window's turn is from its first to its last sample.
    propagated[[0, -1]] /= 2.0
    bias = propagated.sum(axis=0)
    scale = np.einsum("nia,nb->iab", propagated, rate).reshape(3, 9)
    return np.concatenate([bias, scale, np.einsum("nia,na->ia", propagated, rate**2)], axis=1)


def _residual(y: Array, design: Array) -> Array:
    flat = design.reshape(y.size, -1)
    size = np.linalg.norm(flat, axis=0)
    return np.asarray(y.ravel() - flat @ (np.linalg.lstsq(flat / size, y.ravel(), rcond=None)[0] / size))
