"""Screening of dictionaries: many curves judged under a few covariances; the best of each are then fitted.

A rank among curves of one dictionary needs no refitted noise. The score of those that go on does, and pays
for all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.likelihood import explained, joint, log_terms
from stillcal.calib_core.diagnosis.inference.noise_models import families
from stillcal.calib_core.diagnosis.inference.reduction import Reduced, projected, stacked
from stillcal.calib_core.diagnosis.model.effect import BLOCKS_ACROSS, Dictionary, Effect
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.residuals import View
from stillcal.calib_core.diagnosis.slow.two_level import TwoLevelPath, grown

KEPT = 5
"""Curves of a dictionary that go on, under each covariance."""

SPREAD = 7
"""Courses between two levels are grown from one in so many of the best stretches: neighbours are alike."""

CHUNK = 400
MODERATE = "flicker"
"""A wander of middling strength that is tried beside white noise and the likeliest."""


def screened(
    residuals: SensorResiduals,
    effects: Sequence[Effect],
    reduced: Sequence[Reduced],
    found: Sequence[Hypothesis],
) -> list[Hypothesis]:
    """Return the hypotheses of dictionaries that go on. reduced: the residuals with `found` taken out."""
    choices = _choices(residuals, reduced)
    found = [*found, *([] if residuals.shared is None else [residuals.shared])]
    whitened = [_Whitened(v, choice, _extra(found, i)) for i, (v, choice) in enumerate(choices)]
    kept = []
    for effect in effects:
        many = effect.dictionary(residuals.moments)
        if many is None:
            continue
        if many.switching:
            kept += _switching(effect, residuals, whitened, many)
            continue
        best: set[int] = set()
        for c in range(len(whitened[0].diagonals)):
            gains = _gains(whitened, many, c, effect.parameters[0].size)
            best |= set(np.argsort(-gains)[:KEPT].tolist())
        kept += [hypothesis(effect, residuals, many, k) for k in sorted(best)]
    return kept


def hypothesis(effect: Effect, residuals: SensorResiduals, many: Dictionary, k: int) -> Hypothesis:
    """Return curve number `k` of a dictionary as a hypothesis, its curves on each axis one after another."""
    columns = tuple(_columns(v, many.curve(k)[None], many.driven) for v in residuals.views)
    return Hypothesis(effect, many.grids[k], columns, many.multiplicity)


def _switching(
    effect: Effect, residuals: SensorResiduals, whitened: Sequence[_Whitened], many: Dictionary
) -> list[Hypothesis]:
    """Return the likeliest courses between two levels, grown from the best stretches of each covariance."""
    assert many.pairs is not None
    courses: dict[bytes, TwoLevelPath] = {}
    for c in range(len(whitened[0].diagonals)):
        gram, target, power = _inner(whitened, many, c, effect.parameters[0].size)
        starts = np.argsort(-_gains_of_pairs(gram, target, many.pairs))[: KEPT * SPREAD : SPREAD]
        for first, last in many.pairs[starts]:
            course = grown(gram, target, power, int(first), int(last))
            if course is not None:
                courses[course.changes.tobytes()] = course
    made = []
    for course in courses.values():
        curve = np.tensordot(course.changes.astype(float), many.curves, 1)
        columns = tuple(_columns(v, curve[None]) for v in residuals.views)
        made.append(Hypothesis(effect, {}, columns, float(np.exp(course.log_trials))))
    return made


def _columns(view: View, curves: Array, driven: Array | None = None) -> Array:
    """Return columns (b, n, K q 3) of a bias by curves (K, q, N) on each axis; none where phones tilt.

    driven: (N, 3) what multiplies the curves on each axis.
    """
    if view.name in BLOCKS_ACROSS:
        return np.zeros((*view.y.shape, 3 * curves.shape[0] * curves.shape[1]))
    at = curves[:, :, view.bins].reshape(-1, view.bins.size).T
    project = view.project if driven is None else view.project * driven[view.bins]
    made = at[None, :, :, None] * project[:, :, None, :]
    return np.asarray(made.reshape(*view.y.shape, -1))


def _extra(found: Sequence[Hypothesis], i: int) -> Array | None:
    if not found:
        return None
    extra = np.concatenate([f.columns[i] * f.sizes for f in found], axis=2)
    seen = np.abs(extra).max(axis=(0, 1)) > 0.0
    return np.asarray(extra[:, :, seen]) if seen.any() else None


def _choices(residuals: SensorResiduals, reduced: Sequence[Reduced]) -> list[tuple[View, list[int]]]:
    """Return for each view the numbers of the shapes to screen under: white, likeliest, a moderate one."""
    _, weights = joint(reduced, [log_terms(r, r.left) for r in reduced])
    out = []
    for view, r, weight in zip(residuals.views, reduced, weights, strict=True):
        moderate = [i for i, name in enumerate(r.family) if name == MODERATE]
        middle = moderate[len(moderate) // 2 - 1] if moderate else 0
        out.append((view, [0, int(np.argmax(weight)), middle]))
    return out


class _Whitened:
    """A view under a few shapes: what whitens it, and its data so whitened."""

    def __init__(self, view: View, choice: list[int], extra: Array | None) -> None:
        shapes = [(f, g) for f in families(view) for g in range(f.strengths.size)]
        self.view, self.extra = view, extra
        self.rotations = [shapes[c][0].rotation for c in choice]
        self.diagonals = [np.sqrt(shapes[c][0].diagonals[shapes[c][1]])[:, None] for c in choice]

    def sums(self, columns: Array, c: int) -> tuple[Array, Array, float]:
        """Return y' x (M,), whitened x (b n, M) and the white scale left, under shape number `c`."""
        seen = np.abs(columns).max(axis=(0, 1)) > 0.0
        everything = stacked(self.view, columns[:, :, seen], self.extra)
        whitened = self.rotations[c] @ everything / self.diagonals[c]
        (y,), (part,) = projected(whitened[None], self.view.baseline.shape[2], int(seen.sum()))
        x = np.zeros((y.size, seen.size))
        x[:, seen] = part
        freedom = max(y.size - self.view.parameters, 1)
        # Values that never change leave nothing: the scale is then the least that its prior allows.
        least = self.view.known / (self.view.known + freedom)
        return y @ x, x, max(float(y @ y) / freedom, least)


def _gains(views: Sequence[_Whitened], many: Dictionary, c: int, size: float) -> Array:
    """Return about the gain of every hypothesis of a dictionary in log likelihood under shape number `c`."""
    if many.pairs is not None:
        return _gains_of_pairs(*_inner(views, many, c, size)[:2], many.pairs)
    out = []
    width = 3 * many.curves.shape[1]
    for first in range(0, len(many.curves), CHUNK):
        curves = many.curves[first : first + CHUNK]
        gram, target = np.zeros((len(curves), width, width)), np.zeros((len(curves), width))
        for view in views:
            xy, x, scale = view.sums(_columns(view.view, curves, many.driven) * size, c)
            parts = x.reshape(len(x), len(curves), width)
            gram += parts.transpose(1, 2, 0) @ parts.transpose(1, 0, 2) / scale
            target += xy.reshape(len(curves), width) / scale
        out.append(_least_squares(gram, target))
    return np.concatenate(out)


def _inner(views: Sequence[_Whitened], many: Dictionary, c: int, size: float) -> tuple[Array, Array, float]:
    """Return inner products of single curves (K, 3, K, 3), those with the data (K, 3), its power."""
    count = len(many.curves)
    gram, target, power = np.zeros((count, 3, count, 3)), np.zeros((count, 3)), 0.0
    for view in views:
        xy, x, scale = view.sums(_columns(view.view, many.curves, many.driven) * size, c)
        power += len(x)
        gram += (x.T @ x).reshape(count, 3, count, 3) / scale
        target += xy.reshape(count, 3) / scale
    return gram, target, power


def _gains_of_pairs(gram: Array, target: Array, pairs: NDArray[np.int64]) -> Array:
    """Return the same for differences of single curves, from the curves' own inner products."""
    a, b = pairs.T
    crossed = gram[a, :, b, :]
    both = gram[a, :, a, :] + gram[b, :, b, :] - crossed - crossed.transpose(0, 2, 1)
    return _least_squares(both, target[a] - target[b])


def _least_squares(gram: Array, target: Array) -> Array:
    """Gain (K,) of K least-squares fits whose parameters have unit prior variance."""
    # Beside the sums of a recording without noise one is lost: 1e-12 of them keeps the system solvable.
    prior = 1.0 + 1e-12 * np.trace(gram, axis1=1, axis2=2)
    return 0.5 * explained(gram + prior[:, None, None] * np.eye(gram.shape[1]), target)
