"""Held-out evidence: blocks of time predicted from the rest, with and without an effect.

Each fifth of the recording is predicted from the four others. Sizes of effects and the baseline are
integrated out over all views together, so that the log score of what was left out is exact:

    log p(left out | others) = log p(everything) - log p(others)

The covariance is that of the hypothesis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, Scene
from stillcal.calib_core.diagnosis.model.likelihood import Reduced, log_terms, residuals
from stillcal.calib_core.diagnosis.model.noise_models import families
from stillcal.calib_core.diagnosis.model.residuals import View

FOLDS = 5
DIFFUSE = 1e-6


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Sums over folds. log_score: nats; rmse: of left-out bins about the mean model, in the views' unit.

    The tangent view has no rmse: where a pose points, that other bins do not tell.
    """

    log_score: float
    rmse: float


@dataclass(frozen=True, slots=True, eq=False)
class Covariance:
    """A view's covariance (n, n), and by how much it is larger than its shape, what is absorbed too."""

    matrix: Array
    scale: float


def best_covariance(view: View, reduced: Reduced, h: int | None, beta: Array) -> Covariance:
    """Return the most probable covariance of a view under hypothesis `h` (None: no effect)."""
    residual = reduced.yy if h is None else residuals(reduced, h, beta)
    top = int(np.argmax(log_terms(reduced, residual)))
    shapes = [(family, g) for family in families(view) for g in range(family.strengths.size)]
    family, g = shapes[top]
    scale = (view.known + float(residual[top])) / reduced.dof
    return Covariance(family.covariance(g) * scale, scale)


def held_out(scene: Scene, covariances: Sequence[Covariance], effects: Sequence[Hypothesis]) -> HeldOut:
    """Predict each fold from the others, given the views' covariances and effects."""
    start, end = scene.bins.span
    parts = [
        _Part.of(view, b, covariance, [e.columns[i][b] * e.sizes for e in effects])
        for i, (view, covariance) in enumerate(zip(scene.views, covariances, strict=True))
        for b in range(len(view.y))
    ]
    fold = [_dealt(p.view.t, start, end) for p in parts]
    whole, _ = _evidence([p.sums(np.ones(p.y.size, dtype=bool)) for p in parts])
    score, misses = 0.0, [np.zeros(0)]
    for k in range(FOLDS):
        train = [f != k for f in fold]
        if not any(rows.sum() < rows.size for rows in train):
            continue
        sums = [p.sums(rows) for p, rows in zip(parts, train, strict=True)]
        known, size = _evidence(sums)
        score += whole - known
        misses += [
            p.missed(rows, s, size)
            for p, rows, s in zip(parts, train, sums, strict=True)
            if p.view.name != "tangent"
        ]
    left = np.concatenate(misses)
    return HeldOut(score, float(np.sqrt(np.mean(left**2))) if left.size else 0.0)


def _dealt(t: Array, start: float, end: float) -> NDArray[np.int64]:
    """Return the fold (n,) of bins at times t (n,)."""
    return np.clip((t - start) / (end - start) * FOLDS, 0, FOLDS - 1).astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """What some bins say. constant: log density with no effect, nats, baseline integrated out.

    information, target: (k, k) and (k,) of the effects' sizes; factor: (m, m), takes errors to white ones;
    white: (m, p + k + 1), baseline, effects and data so taken; own: (p, p), factor of the baseline's own.
    """

    constant: float
    information: Array
    target: Array
    factor: Array
    white: Array
    own: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """One block of a view: data (n,), its baseline (n, p), the effects' columns (n, k), covariance."""

    view: View
    y: Array
    baseline: Array
    effects: Array
    covariance: Covariance

    @classmethod
    def of(cls, view: View, block: int, covariance: Covariance, effects: list[Array]) -> _Part:
        baseline = view.baseline[block] / np.maximum(np.abs(view.baseline[block]).max(axis=0), 1e-300)
        columns = np.concatenate([np.zeros((view.y.shape[1], 0)), *effects], axis=1)
        return cls(view, view.y[block], baseline, columns, covariance)

    def sums(self, rows: NDArray[np.bool_]) -> _Sums:
        """Return what the bins `rows` say."""
        lower = np.linalg.cholesky(self.covariance.matrix[np.ix_(rows, rows)])
        both = np.column_stack([self.baseline, self.effects, self.y])[rows]
        white = np.linalg.solve(lower, both)
        p = self.baseline.shape[1]
        own = np.linalg.cholesky(white[:, :p].T @ white[:, :p] + DIFFUSE * np.eye(p))
        taken = np.linalg.solve(own, white[:, :p].T @ white[:, p:])
        left = white[:, p:].T @ white[:, p:] - taken.T @ taken
        logs = np.log(lower.diagonal()).sum() + np.log(own.diagonal()).sum()
        constant = -0.5 * float(left[-1, -1]) - float(logs) - 0.5 * len(white) * float(np.log(2.0 * np.pi))
        return _Sums(constant, left[:-1, :-1], left[:-1, -1], np.asarray(lower), white, np.asarray(own))

    def missed(self, rows: NDArray[np.bool_], sums: _Sums, size: Array) -> Array:
        """Return how far the bins that are not `rows` are from the mean model that `rows` tell.

        To the mean belongs what the baseline absorbs.
        """
        baseline, effects, y = np.split(sums.white, [self.baseline.shape[1], sums.white.shape[1] - 1], axis=1)
        white = y[:, 0] - effects @ size
        offset = np.linalg.solve(sums.own.T, np.linalg.solve(sums.own, baseline.T @ white))
        away = (self.y - self.effects @ size - self.baseline @ offset)[~rows]
        if self.view.absorbed is None:
            return np.asarray(away)
        known = np.linalg.solve(sums.factor, self.view.absorbed[rows])
        parameters = self.covariance.scale * (known.T @ (white - baseline @ offset))
        return np.asarray(away - self.view.absorbed[~rows] @ parameters)


def _evidence(sums: Sequence[_Sums]) -> tuple[float, Array]:
    """Return the log density of all parts with the effects' sizes integrated out, and the likeliest sizes."""
    information = np.asarray(sum(s.information for s in sums))
    target = np.asarray(sum(s.target for s in sums))
    lower = np.linalg.cholesky(information + np.eye(target.size))
    half = np.linalg.solve(lower, target)
    value = sum(s.constant for s in sums) + 0.5 * float(half @ half) - float(np.log(lower.diagonal()).sum())
    return value, np.asarray(np.linalg.solve(lower.T, half))
