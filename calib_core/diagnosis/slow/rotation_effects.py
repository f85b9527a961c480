"""The view of turns: what gravity carried from rest to rest tells of the gyroscope's scale and linearity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model import settings as thresholds
from stillcal.calib_core.diagnosis.model.hypothesis import (
    Entry,
    Hypothesis,
    Linear,
    Scene,
    moves,
    no_hypotheses,
)
from stillcal.calib_core.diagnosis.model.residuals import View
from stillcal.calib_core.diagnosis.model.rotation_alignment import LEAST_TURNS, Aligned, Turn
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow import unnamed as generic
from stillcal.calib_core.diagnosis.slow.regressors import LEAST_SPAN

OUTLIER = 8.0
KNOWN = 2.0
"""Degrees of freedom with which the errors of turns are known beforehand."""


def _columns(found: list[Turn], term: Callable[[Turn], Array]) -> Array:
    """Stack columns (K, 3, k) of an error with parameters: term gives (n, 3, k) a turn."""
    return np.array([np.stack([t.column(c) for c in np.moveaxis(term(t), 2, 0)], axis=1) for t in found])


def _axiswise(values: Array) -> Array:
    """One parameter an axis: (n, 3) to (n, 3, 3) with the axis' own value on it."""
    return values[:, :, None] * np.eye(3)[None]


def turn_scene(made: Aligned, bins: Bins, gravity: float) -> tuple[Scene, list[Turn]] | None:
    """Return the turns as a scene of one view, outliers dropped; None with fewer than `LEAST_TURNS` turns."""
    for _ in range(2):
        if len(made.turns) < LEAST_TURNS:
            return None
        size = np.abs(turn_view(made, bins.rate_rounding).left()).reshape(-1, 2).max(axis=1)
        kept = [t for t, s in zip(made.turns, size, strict=True) if s < OUTLIER * np.median(size)]
        made = replace(made, turns=kept)
    if len(made.turns) < LEAST_TURNS:
        return None
    return Scene("gyro", bins, (turn_view(made, bins.rate_rounding),), gravity, None), made.turns


def turn_view(made: Aligned, rounding: Array | None) -> View:
    """Two residuals a turn across gravity; the baseline is the nine numbers of scale and misalignment.

    The accelerometer's parameters may be off by as much as the norm of gravity leaves them unknown, and the
    rate's bias by what coarse steps do to it at rest, `rounding` (3,) rad/s, where the turn dithers them.
    `duration` holds the angle turned through, with which errors may grow.
    """
    found = made.turns
    across = np.array([t.across() for t in found])
    y = np.einsum("kbi,ki->kb", across, np.array([t.miss for t in found])).ravel()
    n = y.size
    scale = np.einsum("kbi,kip->kbp", across, np.array([t.scale_columns() for t in found])).reshape(n, 9)
    absorbed = (
        np.einsum("kbi,kip->kbp", across, np.array([t.unsure for t in found])).reshape(n, 9) @ made.unsure
    )
    if rounding is not None:
        still = _columns(found, lambda t: np.broadcast_to(np.eye(3) * rounding, (*t.rate.shape, 3)))
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
    spread = max(1.4826 * float(np.median(np.abs(rough.left()))), 1e-6)
    return replace(rough, variance=np.full(n, spread**2))


SCALE = Entry(
    "gyro_scale_temperature",
    "gyro",
    "temperature x rate of turn",
    no_hypotheses,
    (Linear("slope", "1/K", 3, 1e-3),),
    "The gyroscope's scale changes with temperature on {axes}.",
    ("gyro_bias_temperature",),
    "turn the phone about every axis, cold and warm",
)
SAY = "The gyroscope is nonlinear on {axes}."
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

SAY_NAMELESS = generic.SAY.replace("bias", "gain")
AGEING = replace(
    SCALE,
    effect="unknown",
    follows="time x rate of turn",
    parameters=(Linear("gain", "1", 3, 0.02),),
    sentence=SAY_NAMELESS + "time.",
    handicap=thresholds.UNKNOWN_HANDICAP,
)
LOPSIDED = replace(
    AGEING,
    follows="size of the rate of turn",
    sentence=SAY_NAMELESS + "the direction of rotation.",
    handicap=HANDICAP + thresholds.UNKNOWN_HANDICAP,
)


def turn_entries(found: list[Turn], scene: Scene) -> list[Entry]:
    """Return what turns can show: nonlinearity, and scale against temperature where it was recorded.

    Without a name, a scale that changes with time or with the sense of the turn.
    """
    across = scene.views[0].project.reshape(-1, 2, 3)

    def seen(entry: Entry, *terms: Callable[[Turn], Array]) -> Entry:
        def propose(self: Entry, _scene: Scene) -> list[Hypothesis]:
            columns = [np.einsum("kbi,kip->kbp", across, _columns(found, term)) for term in terms]
            flat = np.concatenate(columns, axis=2).reshape(1, across.shape[0] * 2, -1)
            return [Hypothesis(self, {}, (flat,))]

        return replace(entry, propose=propose)

    def square(t: Turn) -> Array:
        return _axiswise(t.rate**2)

    start, end = scene.bins.span
    proposed = [
        seen(QUADRATIC, square),
        seen(CUBIC, square, lambda t: _axiswise(t.rate**3)),
        seen(LOPSIDED, lambda t: _axiswise(np.abs(t.rate))),
        seen(AGEING, lambda t: _axiswise(t.rate * ((t.end - start) / (end - start) - 0.5))),
    ]
    warm = np.array([t.temperature for t in found])
    if scene.bins.temperature is not None and moves(warm, LEAST_SPAN):
        middle = float(warm.mean())
        proposed.append(seen(SCALE, lambda t: _axiswise(t.rate * (t.temperature - middle))))
    return proposed
