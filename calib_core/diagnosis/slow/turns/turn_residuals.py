"""The view of turns: what gravity carried from rest to rest tells of the gyroscope's scale and linearity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.model.residuals import View
from stillcal.calib_core.diagnosis.model.rotation_alignment import LEAST_TURNS, Aligned
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.maths.robust import MAD_TO_SD

OUTLIER = 8.0
KNOWN = 2.0
"""Degrees of freedom with which the errors of turns are known beforehand."""

WAVES = 8
"""Of a bias that wanders: those left out have a fourteenth of a walk's variance."""


def turn_residuals(made: Aligned, bins: Bins, gravity: float) -> SensorResiduals | None:
    """Return the turns' residuals, one view, outliers dropped; None with fewer than `LEAST_TURNS` turns."""
    for _ in range(2):
        if len(made.turns) < LEAST_TURNS:
            return None
        # Waves of any size would go through few turns, and leave nothing to tell an outlier by.
        steady = turn_view(replace(made, wander=0.0), bins.rate_rounding)
        size = np.abs(steady.left()).reshape(-1, 2).max(axis=1)
        kept = [t for t, s in zip(made.turns, size, strict=True) if s < OUTLIER * np.median(size)]
        made = replace(made, turns=kept)
    if len(made.turns) < LEAST_TURNS:
        return None
    view = turn_view(made, bins.rate_rounding)
    return SensorResiduals("gyro", bins, (view,), gravity, None, tuple(made.turns))


def turn_view(made: Aligned, rounding: Array | None) -> View:
    """Two residuals a turn across gravity; the baseline is the nine numbers of scale and misalignment.

    The accelerometer's parameters may be off by as much as the norm of gravity leaves them unknown, its bias
    besides by how it wanders, and the rate's bias by what coarse steps do to it at rest, `rounding` (3,)
    rad/s, where the turn dithers them. What happens between two samples goes with the course of the rates, as
    a gyroscope's nonlinearity does: it is allowed for in all turns alike, and as much again in each.
    `duration` holds the angle turned through, with which errors may grow.
    """
    found = made.turns
    across = np.array([t.across() for t in found])
    y = np.einsum("kbi,ki->kb", across, np.array([t.miss for t in found])).ravel()
    n = y.size
    scale = np.einsum("kbi,kip->kbp", across, np.array([t.scale_columns() for t in found])).reshape(n, 9)
    unsure = np.einsum("kbi,kip->kbp", across, np.array([t.unsure for t in found])).reshape(n, 9)
    between = np.array([t.between for t in found])
    missed = np.einsum("kbi,ki->kb", across, between).reshape(n, 1)
    absorbed = np.hstack([unsure @ made.unsure, missed])
    if rounding is not None:
        still = np.array([t.columns(np.tile(np.eye(3) * rounding, (t.t.size, 1, 1))) for t in found])
        absorbed = np.hstack([absorbed, np.einsum("kbi,kip->kbp", across, still).reshape(n, 3)])
    rough = View(
        "turn",
        y[None],
        scale[None],
        np.ones(n),
        np.eye(n),
        across.reshape(1, n, 3),
        np.arange(n),
        np.repeat([t.end for t in found], 2),
        np.repeat([t.angle for t in found], 2),
        np.arange(n),
        absorbed=absorbed,
        known=KNOWN,
    )
    spread = max(MAD_TO_SD * float(np.median(np.abs(rough.left()))), 1e-6)
    waves = np.repeat(made.wander * _waves(np.array([t.end - t.duration / 2.0 for t in found])), 2, axis=0)
    wandering = (unsure[:, :3, None] * waves[:, None, :]).reshape(n, -1)
    apart = np.repeat((between**2).sum(axis=1) / 2.0, 2)
    return replace(rough, variance=spread**2 + apart, absorbed=np.hstack([absorbed, wandering]))


def _waves(t: Array) -> Array:
    """Return a random walk about its mean as independent waves (n, `WAVES`) of variance 1 together.

    The walk's Karhunen-Loeve expansion over the times t (n,): cosines of k half periods, sizes as 1 / k.
    """
    k = np.arange(1, WAVES + 1)
    phase = np.pi * (t - t.min()) / max(float(np.ptp(t)), 1e-9)
    return np.asarray(np.sqrt(12.0) / np.pi * np.cos(phase[:, None] * k) / k)
