"""Gravity carried from rest to rest by the integrated gyroscope: the view of its scale and linearity.

The error of the gyroscope is first order: an error d(t) of the rate moves gravity, as predicted at the end of
a turn, by (R_end' sum R(t) d(t) dt) x up_end, with R(t) from the body at t to the body at the start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.misfit.bins import Bins
from stillcal.calib_core.misfit.catalogue.drivers import LEAST_SPAN
from stillcal.calib_core.misfit.catalogue.entry import Entry, Hypothesis, Linear, Scene, moves, no_hypotheses
from stillcal.calib_core.misfit.views import View
from stillcal.calib_core.rotation import attitudes, matrix
from stillcal.calib_core.samples import Array, Samples

LEAST_TURNS = 9
LONGEST_TURN = 60.0
LEAST_ANGLE = 0.2
SHARPEST = 0.2
"""rad from sample to sample, beyond which what happens between samples is not known from them."""

OUTLIER = 8.0
KNOWN = 2.0
"""Degrees of freedom with which the errors of turns are known beforehand."""

MARGIN = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """One turn. t: (n,) s; rate: (n, 3), bias off; carried: (n, 3, 3) R_end' R(t) dt; up, miss: (3,)."""

    end: float
    duration: float
    t: Array
    rate: Array
    carried: Array
    up: Array
    miss: Array
    temperature: float

    def column(self, term: Array) -> Array:
        """Return what an error of the rate `term` (n, 3) does to gravity's direction at the end, (3,) rad."""
        return np.cross(np.einsum("nij,nj->i", self.carried, term), self.up)


def turns(gyroscope: Samples, bins: Bins, up: Array) -> list[Turn]:
    """Cut the turns between successive rests; up: (N, 3) unit gravity in every bin, calibrated."""
    if bins.rate is None:
        return []
    last = np.flatnonzero(np.diff(bins.rest) > 0)
    found = [_turn(gyroscope, bins, up, int(i)) for i in last]
    return [t for t in found if t is not None]


def _turn(gyroscope: Samples, bins: Bins, up: Array, i: int) -> Turn | None:
    """Cut the turn from bin i to bin i + 1, of different rests."""
    start = float(bins.t[i] + bins.duration[i] / 2) - MARGIN
    end = float(bins.t[i + 1] - bins.duration[i + 1] / 2) + MARGIN
    part = gyroscope.between(start, end)
    if end - start > LONGEST_TURN or len(part) < 10 or np.diff(part.t).max() > 0.5:
        return None
    if np.linalg.norm(part.xyz, axis=1).max() * np.median(np.diff(part.t)) > SHARPEST:
        return None
    assert bins.rate is not None
    rate = part.xyz - (bins.rate[i] + bins.rate[i + 1]) / 2.0
    R = matrix(attitudes(part.t, rate))
    if np.linalg.norm(np.gradient(part.t)[:, None] * rate, axis=1).sum() < LEAST_ANGLE:
        return None
    carried = np.einsum("ki,nkj->nij", R[-1], R) * np.gradient(part.t)[:, None, None]
    warm = 0.0 if bins.temperature is None else float(bins.temperature[i] + bins.temperature[i + 1]) / 2.0
    return Turn(end, end - start, part.t, rate, carried, up[i + 1], up[i + 1] - R[-1].T @ up[i], warm)


def _columns(found: list[Turn], term: Callable[[Turn], Array]) -> Array:
    """Stack columns (K, 3, k) of an error with parameters: term gives (n, 3, k) a turn."""
    return np.array([np.stack([t.column(c) for c in np.moveaxis(term(t), 2, 0)], axis=1) for t in found])


def _axiswise(values: Array) -> Array:
    """One parameter an axis: (n, 3) to (n, 3, 3) with the axis' own value on it."""
    return values[:, :, None] * np.eye(3)[None]


def turn_scene(gyroscope: Samples, bins: Bins, up: Array, gravity: float) -> tuple[Scene, list[Turn]] | None:
    """Return the turns as a scene of one view, outliers dropped; None with fewer than `LEAST_TURNS` turns."""
    found = turns(gyroscope, bins, up)
    for _ in range(2):
        if len(found) < LEAST_TURNS:
            return None
        view = turn_view(found)
        size = np.abs(_left(view)).reshape(-1, 2).max(axis=1)
        found = [t for t, s in zip(found, size, strict=True) if s < OUTLIER * np.median(size)]
    if len(found) < LEAST_TURNS:
        return None
    return Scene("gyro", bins, (turn_view(found),), gravity, None), found


def turn_view(found: list[Turn]) -> View:
    """Two residuals a turn across gravity; the nine numbers of scale and misalignment are the baseline.

    `duration` holds the angle turned through, with which errors may grow.
    """
    across = np.array([_tangents(t.up) for t in found])
    scale = _columns(found, lambda t: np.einsum("ai,nj->naij", np.eye(3), t.rate).reshape(len(t.rate), 3, 9))
    y = np.einsum("kbi,ki->kb", across, np.array([t.miss for t in found])).ravel()
    baseline = np.einsum("kbi,kip->kbp", across, scale).reshape(y.size, 9)
    n = y.size
    angles = np.repeat([np.linalg.norm(np.gradient(t.t)[:, None] * t.rate, axis=1).sum() for t in found], 2)
    rough = View(
        "turn",
        y[None],
        baseline[None],
        np.ones(n),
        np.eye(n),
        across.reshape(1, n, 3),
        np.arange(n),
        np.repeat([t.end for t in found], 2),
        angles,
        np.arange(n),
        known=KNOWN,
    )
    spread = max(1.4826 * float(np.median(np.abs(_left(rough)))), 1e-6)
    return replace(rough, variance=np.full(n, spread**2))


def _left(view: View) -> Array:
    coefficients = np.linalg.lstsq(view.baseline[0], view.y[0], rcond=None)[0]
    return np.asarray(view.y[0] - view.baseline[0] @ coefficients)


def _tangents(up: Array) -> Array:
    first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first)])


SCALE = Entry(
    "gyro_scale_temperature",
    "gyro",
    "temperature x rate of turn",
    no_hypotheses,
    (Linear("slope", "1/K", 3, 1e-3),),
    "The gyroscope's scale follows temperature on {axes}.",
    ("gyro_bias_temperature",),
    "turn the phone about every axis, cold and warm",
)
SAY = "The gyroscope is not linear on {axes}."
HANDICAP = 0.6
"""Score that nonlinearity gives away: errors of turns have longer tails than those of rests."""

QUADRATIC = Entry(
    "gyro_nonlinearity",
    "gyro",
    "rate of turn",
    no_hypotheses,
    (Linear("quadratic", "1/(rad/s)", 3, 0.02),),
    SAY,
    ("gyro_saturation",),
    "turn at several speeds, both ways",
    handicap=HANDICAP,
)
CUBIC = Entry(
    "gyro_nonlinearity",
    "gyro",
    "rate of turn",
    no_hypotheses,
    (Linear("quadratic", "1/(rad/s)", 3, 0.02), Linear("cubic", "1/(rad/s)^2", 3, 0.01)),
    SAY,
    ("gyro_saturation",),
    "turn at several speeds, both ways",
    handicap=HANDICAP,
)


def turn_entries(found: list[Turn], scene: Scene) -> list[Entry]:
    """Return what turns can show: nonlinearity, and scale against temperature where it was recorded."""
    across = scene.views[0].project.reshape(-1, 2, 3)

    def seen(entry: Entry, *terms: Callable[[Turn], Array]) -> Entry:
        def propose(self: Entry, _scene: Scene) -> list[Hypothesis]:
            columns = [np.einsum("kbi,kip->kbp", across, _columns(found, term)) for term in terms]
            flat = np.concatenate(columns, axis=2).reshape(1, across.shape[0] * 2, -1)
            return [Hypothesis(self, {}, (flat,))]

        return replace(entry, propose=propose)

    def square(t: Turn) -> Array:
        return _axiswise(t.rate**2)

    proposed = [seen(QUADRATIC, square), seen(CUBIC, square, lambda t: _axiswise(t.rate**3))]
    warm = np.array([t.temperature for t in found])
    if scene.bins.temperature is not None and moves(warm, LEAST_SPAN):
        middle = float(warm.mean())
        proposed.append(seen(SCALE, lambda t: _axiswise(t.rate * (t.temperature - middle))))
    return proposed
