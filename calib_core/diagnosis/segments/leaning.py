"""Slow accelerations of what carries the phone: a train that brakes, a car in a bend.

The force leans without the phone turning, and is longer than gravity by the square of the lean over two. A
bias across gravity does the same, but one that jumps does not jump across gravity alone each time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.static_bins import Bins

FEWEST = 3
"""Bins of a rest whose median direction is gravity's own."""

STEEPEST = float(np.cos(0.3))
"""Cosine of a lean beyond which the phone was turned: no train or bus pushes by a third of gravity."""

PUSH = 0.02
"""rad, 0.2 m/s^2: a bias hardly steps so far twice, and a train pushes so hard when it starts or stops."""

ACROSS = 0.25
"""Part of a push by which the force may get longer besides: what a bias jumps by has any direction."""

OFTEN = 2
"""Pushes from which on something is taken to carry the phone."""


def without_leaning(bins: Bins) -> Bins:
    """Return bins whose force is as long as gravity where it leans. Without a gyroscope a lean is a tilt.

    Rests in which it leans far, two times and more in all, are left out: there something carries the phone,
    and neither where gravity is nor a bias across it is known.
    """
    if bins.rate is None or not len(bins):
        return bins
    size = np.linalg.norm(bins.force, axis=1, keepdims=True)
    square = _leaning(bins, bins.force / np.maximum(size, 1e-9), bins.rate)
    bins = replace(bins, force=bins.force / np.sqrt(1.0 + square)[:, None])
    return _without_pushes(bins, np.sqrt(np.maximum(square, 0.0)))


def _without_pushes(bins: Bins, lean: Array) -> Bins:
    """Return the bins of rests in which nothing pushes. lean: (n,) tangents that are no tilt of the phone."""
    length, pushes = np.linalg.norm(bins.force, axis=1), np.zeros(bins.rest[-1] + 1, dtype=np.int64)
    far = lean > PUSH
    for r in np.unique(bins.rest[far]):
        own = bins.rest == r
        pushed, free = own & far, own & ~far
        if not free.any():
            continue
        change = length[pushed].mean() - length[free].mean()
        if abs(change) < ACROSS * float((length * lean)[pushed].mean()):
            pushes[r] = np.count_nonzero(np.diff(far[own], prepend=False) & far[own])
    return bins if pushes.sum() < OFTEN else bins.chosen(pushes[bins.rest] == 0)


def _leaning(bins: Bins, up: Array, rate: Array) -> Array:
    """Return the square (n,) of the tangent by which the force leans in its rest, no turn confirming it.

    up: (n, 3) directions of force. Of the rate at which these lean in a rest, the gyroscope's own rate has a
    share (least squares): so much of it is a tilt of the phone. Its bias is what most rests show: what tilts
    evenly all through one rest has no other rate in it.
    """
    out = np.zeros(len(bins))
    size = np.maximum(np.bincount(bins.rest), 1)[:, None]
    means = np.stack([np.bincount(bins.rest, axis) for axis in rate.T], axis=1) / size
    bias = np.median(means, axis=0)
    for r in np.flatnonzero(np.bincount(bins.rest) >= FEWEST):
        rows = np.flatnonzero(bins.rest == r)
        middle = np.median(up[rows], axis=0)
        cosine = up[rows] @ (middle / np.linalg.norm(middle))
        if cosine.min() < STEEPEST:
            continue
        leaning = np.cross(np.gradient(up[rows], bins.t[rows], axis=0), up[rows])
        seen = rate[rows] - bias
        tilt = float((leaning * seen).sum()) / max(float((leaning**2).sum()), 1e-300)
        out[rows] = (1.0 / cosine**2 - 1.0) * (1.0 - np.clip(tilt, 0.0, 1.0))
    return out
