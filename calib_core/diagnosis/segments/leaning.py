"""Slow accelerations of what carries the phone: a train that brakes, a car in a bend.

The force leans without the phone turning, and is longer than gravity by the square of the lean over two. A
bias across gravity does the same, but one that jumps does not jump across gravity alone each time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.orientation import GRAVITY
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

FASTEST = 100.0
"""m/s, 360 km/h: nothing on a rail, a road or a runway is faster, so a longer push is a bias."""

SUDDEN = 0.5
"""Part of a push by which the force leans within two bins as it starts or stops: what warms does not."""


def without_leaning(bins: Bins) -> Bins:
    """Return bins whose force is as long as gravity where it leans. Without a gyroscope a lean is a tilt.

    Rests in which it leans far, two times and more in all, are left out: there something carries the phone,
    and neither where gravity is nor a bias across it is known. What leans slowly, with the charger, or for so
    long that nothing is so fast is a bias.
    """
    if bins.rate is None or not len(bins):
        return bins
    size = np.linalg.norm(bins.force, axis=1, keepdims=True)
    lean = _without_plug(bins, _leaning(bins, bins.force / np.maximum(size, 1e-9), bins.rate))
    longer = np.sqrt(1.0 + (lean**2).sum(axis=1, keepdims=True))
    return _without_pushes(replace(bins, force=bins.force / longer), lean)


def _without_pushes(bins: Bins, lean: Array) -> Bins:
    """Return the bins of rests in which nothing pushes. lean: (n, 3) tangents without tilt and plug."""
    size, length = np.linalg.norm(lean, axis=1), np.linalg.norm(bins.force, axis=1)
    pushes, far = np.zeros(bins.rest[-1] + 1, dtype=np.int64), size > PUSH
    for r in np.unique(bins.rest[far]):
        own = bins.rest == r
        pushed, free = own & far, own & ~far
        if not free.any():
            continue
        change = length[pushed].mean() - length[free].mean()
        if abs(change) < ACROSS * float((length * size)[pushed].mean()):
            pushes[r] = _count(lean[own], bins.duration[own], far[own])
    return bins if pushes.sum() < OFTEN else bins.chosen(pushes[bins.rest] == 0)


def _without_plug(bins: Bins, lean: Array) -> Array:
    """Return the lean (n, 3) that the charger does not explain: it pushes nothing, a bias may follow it."""
    if bins.charging is None:
        return lean
    usual = np.maximum(np.bincount(bins.rest), 1)[bins.rest]
    plugged, own = (
        x - np.stack([np.bincount(bins.rest, c) for c in x.T], axis=1)[bins.rest] / usual[:, None]
        for x in (bins.charging[:, None], lean)
    )
    power = float((plugged**2).sum())
    if not power:
        return lean
    left = lean - bins.charging[:, None] * (plugged * own).sum(axis=0) / power
    for r in np.unique(bins.rest):
        left[bins.rest == r] -= np.median(left[bins.rest == r], axis=0)
    return np.asarray(left)


def _count(lean: Array, duration: Array, far: NDArray[np.bool_]) -> int:
    """Return how many runs of far bins in a rest are pushes: sudden, and none faster than anything is.

    lean: (k, 3) tangents; duration: (k,) s.
    """
    edges = np.flatnonzero(np.diff(far, prepend=False, append=False))
    change = np.linalg.norm(lean[2:] - lean[:-2], axis=1)
    count = 0
    for a, b in edges.reshape(-1, 2):
        speed = GRAVITY * np.linalg.norm((lean[a:b] * duration[a:b, None]).sum(axis=0))
        largest = float(np.linalg.norm(lean[a:b], axis=1).max())
        sudden = change[max(a - 2, 0) : b + 1].max(initial=0.0) > SUDDEN * largest
        count += bool(speed < FASTEST and sudden)
    return count


def _leaning(bins: Bins, up: Array, rate: Array) -> Array:
    """Return the tangents (n, 3) by which the force leans across gravity in its rest, no turn confirming it.

    up: (n, 3) directions of force. Of the rate at which these lean in a rest, the gyroscope's own rate has a
    share (least squares): so much of it is a tilt of the phone. Its bias is what most rests show: what tilts
    evenly all through one rest has no other rate in it.
    """
    out = np.zeros((len(bins), 3))
    size = np.maximum(np.bincount(bins.rest), 1)[:, None]
    means = np.stack([np.bincount(bins.rest, axis) for axis in rate.T], axis=1) / size
    bias = np.median(means, axis=0)
    for r in np.flatnonzero(np.bincount(bins.rest) >= FEWEST):
        rows = np.flatnonzero(bins.rest == r)
        middle = np.median(up[rows], axis=0)
        middle /= np.linalg.norm(middle)
        cosine = up[rows] @ middle
        if cosine.min() < STEEPEST:
            continue
        leaning = np.cross(np.gradient(up[rows], bins.t[rows], axis=0), up[rows])
        seen = rate[rows] - bias
        tilt = float((leaning * seen).sum()) / max(float((leaning**2).sum()), 1e-300)
        out[rows] = (up[rows] / cosine[:, None] - middle) * np.sqrt(1.0 - np.clip(tilt, 0.0, 1.0))
    return out
