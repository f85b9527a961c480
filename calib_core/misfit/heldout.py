"""Held-out evidence: blocks of time predicted from the rest, with and without an effect.

The covariance is that of the hypothesis; bins of the left-out block take no part in its coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.misfit.catalogue.entry import Hypothesis, Scene
from stillcal.calib_core.misfit.evidence import Reduced, log_terms, residuals
from stillcal.calib_core.misfit.shapes import families
from stillcal.calib_core.misfit.views import View
from stillcal.calib_core.samples import Array

FOLDS = 5
DIFFUSE = 1e-6


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Sums over folds. log_score: nats; rmse: of left-out bins about the mean model, in the view's unit."""

    log_score: float
    rmse: float


def best_covariance(view: View, reduced: Reduced, h: int | None, beta: Array) -> Array:
    """Return the most probable covariance (n, n) of a view under hypothesis `h` (None: no effect)."""
    residual = reduced.yy if h is None else residuals(reduced, h, beta)
    top = int(np.argmax(log_terms(reduced, residual)))
    shapes = [(family, g) for family in families(view) for g in range(family.strengths.size)]
    family, g = shapes[top]
    return np.asarray(family.covariance(g) * (view.known + residual[top]) / reduced.dof)


def held_out(scene: Scene, covariances: Sequence[Array], effects: Sequence[Hypothesis]) -> HeldOut:
    """Predict each of `FOLDS` blocks of time from the others, given the views' covariances and effects."""
    start, end = scene.bins.span
    edges = np.linspace(start, end, FOLDS + 1)
    score, square, count = 0.0, 0.0, 0
    for first, last in pairwise(edges):
        for i, view in enumerate(scene.views):
            test = (view.t >= first) & (view.t < last)
            if not 0 < test.sum() < test.size - 3:
                continue
            for b in range(len(view.y)):
                design = _design(view, b, [e.columns[i][b] * e.sizes for e in effects])
                gain, misses = _predict(view, b, design, covariances[i], test)
                score, square, count = score + gain, square + float(misses @ misses), count + misses.size
    return HeldOut(score, float(np.sqrt(square / max(count, 1))))


def _design(view: View, block: int, effects: list[Array]) -> tuple[Array, Array]:
    """Baseline and effect columns (n, p + k) of one block, and their prior precision (p + k,)."""
    baseline = view.baseline[block] / np.maximum(np.abs(view.baseline[block]).max(axis=0), 1e-300)
    columns = np.column_stack([baseline, *effects])
    precision = np.concatenate(
        [np.full(baseline.shape[1], DIFFUSE), np.ones(columns.shape[1] - baseline.shape[1])]
    )
    return columns, precision


def _predict(
    view: View, block: int, design: tuple[Array, Array], covariance: Array, test: NDArray[np.bool_]
) -> tuple[float, Array]:
    """Return the log density of the left-out bins and their distance from the mean model.

    To the mean belongs what the baseline absorbs, as the other bins tell it.
    """
    y, (columns, precision) = view.y[block], design
    train = ~test
    lower = np.linalg.cholesky(covariance[np.ix_(train, train)])
    shared = np.linalg.solve(lower, covariance[np.ix_(train, test)])
    seen, told = np.linalg.solve(lower, columns[train]), np.linalg.solve(lower, y[train])
    spread = np.linalg.inv(seen.T @ seen + np.diag(precision))
    beta = spread @ (seen.T @ told)
    left = columns[test] - shared.T @ seen
    away, known = y[test] - columns[test] @ beta, told - seen @ beta
    residual = away - shared.T @ known
    predicted = covariance[np.ix_(test, test)] - shared.T @ shared + left @ spread @ left.T
    factor = np.linalg.cholesky((predicted + predicted.T) / 2.0)
    white = np.linalg.solve(factor, residual)
    density = (
        -0.5 * (white @ white) - np.log(factor.diagonal()).sum() - 0.5 * white.size * np.log(2.0 * np.pi)
    )
    if view.absorbed is not None:
        away = away - view.absorbed[test] @ np.linalg.solve(lower, view.absorbed[train]).T @ known
    return float(density), away
