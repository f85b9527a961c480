"""Held-out evidence: blocks of time predicted from the rest, with and without an effect.

The recording is cut into twenty stretches. Every fifth of them is left out in turn and predicted from the
others, so that an effect that comes once, such as a step, is left out in parts. Sizes of effects and the
baseline are integrated out over all views together, so that the log score of what was left out is exact:

    log p(left out | others) = log p(everything) - log p(others)

The covariance of each view and its scale are chosen anew on those others, among the shapes that are likely on
the whole recording. Over an effect's grid points the density is averaged, all of them alike beforehand: where
the moment of a step is left out itself, the others do not tell it, and to choose one would be a guess (it
lost up to 180 nats, and steps of d' 40 with them).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.bayes_factor import SIZES
from stillcal.calib_core.diagnosis.inference.likelihood import log_sum, log_terms
from stillcal.calib_core.diagnosis.inference.noise_models import families
from stillcal.calib_core.diagnosis.inference.reduction import Reduced
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.residuals import View

FOLDS = 5
STRETCHES = 4
"""Stretches in a fold: several, lest what comes once be left out whole; few, lest neighbours tell them."""

DIFFUSE = 1e-6

SHAPES = 6
"""Covariance shapes of a view that each fold chooses from: the likeliest ones of the whole recording."""


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Of each part of the views, the covariance shape (n, n) which a fold's other bins choose; its scale."""

    shapes: Sequence[Array]
    scales: Sequence[float]


@dataclass(frozen=True, slots=True)
class HeldOut:
    """What all folds say. log_score: nats; missed: (n,) left-out bins less the mean model, in view units.

    leverage: (n,) variance of that model there, as a part of the variance of the bin's white noise. training:
    log evidence of each fold's other bins, nats, by which an effect is chosen without what is left out. The
    tangent view has neither miss nor leverage: where a pose points, other bins do not tell. noise: of each
    fold, that of its other bins.
    """

    log_score: float
    missed: Array
    leverage: Array
    training: tuple[float, ...]
    noise: tuple[Noise, ...]

    def rmse(self, under: HeldOut) -> float:
        """Return the rms of the misses, every bin weighing as far as the others tell it.

        under: the model by whose leverage bins weigh: both models are judged by the bins that the one with
        more to estimate tells. An attitude like no other is told by none of the others. Missed by
        0.05 m/s^2, as was expected, one alone made the rms with a slope three times as large as without,
        where all other bins were three times nearer.
        """
        weight = 1.0 / (1.0 + under.leverage)
        return float(np.sqrt(weight @ self.missed**2 / weight.sum()))


def likely_shapes(view: View, reduced: Reduced, residual: Array) -> list[Array]:
    """Return the most probable covariance shapes (n, n) of a view at sums of squares `residual` (G,)."""
    shapes = [(family, g) for family in families(view) for g in range(family.strengths.size)]
    best = np.argsort(-log_terms(reduced, residual))[:SHAPES]
    return [shapes[i][0].covariance(shapes[i][1]) for i in best]


def held_out(
    residuals: SensorResiduals,
    shapes: Sequence[Sequence[Array]],
    candidates: Sequence[Sequence[Hypothesis]],
    noise: Sequence[Noise] = (),
) -> HeldOut:
    """Predict each fold from the others.

    shapes: for each view, the covariances (n, n) to choose from. candidates: sets of effects, one of which
    is true, such as one effect at several grid points beside others. noise: of each fold, that which another
    model has, to be judged in; by default each chooses its own of the `shapes`.
    """
    score, missed, leverage, training = 0.0, [np.zeros(0)], [np.zeros(0)], []
    used: list[Noise] = []
    shared = [] if residuals.shared is None else [residuals.shared]
    parts = [
        [
            _Part.of(view, b, [e.columns[i][b] * e.sizes for e in (*effects, *shared)])
            for i, view in enumerate(residuals.views)
            for b in range(len(view.y))
        ]
        for effects in candidates
    ]
    own = [effects[0].sizes.size if effects else 0 for effects in candidates]
    of_part = [] if noise else [shapes[i] for i, view in enumerate(residuals.views) for _ in view.y]
    fold = [_dealt(p.view.t, *residuals.bins.span) for p in parts[0]]
    for k in range(FOLDS):
        rows = [f != k for f in fold]
        if all(r.all() for r in rows):
            continue
        scales: Sequence[float | None] = [None] * len(rows)
        if noise:
            chosen, scales = noise[len(used)].shapes, noise[len(used)].scales
        else:
            # Shapes are chosen under the first candidate; grid points are weighed under these.
            chosen = [
                _likeliest(p, r, choice, own[0]) for p, r, choice in zip(parts[0], rows, of_part, strict=True)
            ]
        factors = [_factor(shape, r) for shape, r in zip(chosen, rows, strict=True)]
        known = [_known(each, rows, factors, scales, count) for each, count in zip(parts, own, strict=True)]
        used.append(Noise(chosen, [s.scale for s in known[0][2]]))
        values = np.array([value for value, _, _ in known])
        training.append(float(values.max()))
        whole = [_factor(shape, np.ones_like(r)) for shape, r in zip(chosen, rows, strict=True)]
        every = [
            _everything(each, whole, some, count)
            for each, (_, _, some), count in zip(parts, known, own, strict=True)
        ]
        score += log_sum(np.array(every)) - log_sum(values)
        weights = np.exp(values - log_sum(values))
        for i in range(len(rows)):
            if parts[0][i].view.name != "tangent":
                told = [
                    each[i].told(rows[i], some[i], x) for each, (_, x, some) in zip(parts, known, strict=True)
                ]
                missed.append(weights @ np.array([away for away, _ in told]))
                leverage.append(weights @ np.array([more for _, more in told]))
    return HeldOut(score, np.concatenate(missed), np.concatenate(leverage), tuple(training), tuple(used))


def _known(
    parts: Sequence[_Part],
    rows: Sequence[NDArray[np.bool_]],
    factors: Sequence[Array],
    scales: Sequence[float | None],
    own: int,
) -> tuple[float, Array, list[_Sums]]:
    """Return the log evidence of the bins `rows`, the effects' mean sizes, and the bins' sums."""
    every = zip(parts, rows, factors, scales, strict=True)
    sums = [p.sums(r, factor, scale) for p, r, factor, scale in every]
    return (*_evidence(sums, own), sums)


def _everything(parts: Sequence[_Part], factors: Sequence[Array], known: Sequence[_Sums], own: int) -> float:
    """Return the log evidence of all bins, at the scales that `known` has."""
    sums = [
        p.sums(np.ones(p.y.size, dtype=bool), factor, k.scale)
        for p, factor, k in zip(parts, factors, known, strict=True)
    ]
    return _evidence(sums, own)[0]


def _likeliest(part: _Part, rows: NDArray[np.bool_], shapes: Sequence[Array], own: int) -> Array:
    """Return the shape under which the bins `rows` of a part are likeliest."""
    return max(shapes, key=lambda shape: _evidence([part.sums(rows, _factor(shape, rows))], own)[0])


def _factor(shape: Array, rows: NDArray[np.bool_]) -> Array:
    """Return the Cholesky factor (m, m) of the bins `rows` of a shape (n, n)."""
    return np.asarray(np.linalg.cholesky(shape[np.ix_(rows, rows)]))


def _whitened(lower: Array, columns: Array) -> Array:
    """Return columns (m, k) with errors of the covariance that `lower` (m, m) factorises made white."""
    from scipy.linalg import solve_triangular  # noqa: PLC0415 - the daemon stays light

    return np.asarray(solve_triangular(lower, columns, lower=True, check_finite=False))


def _dealt(t: Array, start: float, end: float) -> NDArray[np.int64]:
    """Return the fold (n,) of bins at times t (n,): stretches of the recording, dealt in turn."""
    stretches = FOLDS * STRETCHES
    at = np.clip((t - start) / (end - start) * stretches, 0, stretches - 1).astype(np.int64)
    return np.asarray(at % FOLDS)


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """What some bins say. constant: log density with no effect, nats, baseline integrated out.

    information, target: (k, k) and (k,) of the effects' sizes; factor: (m, m), takes errors to white ones;
    white: (m, p + k + 1), baseline, effects and data so taken; own: (p, p), factor of the baseline's own;
    scale: by how much the covariance is larger than its shape.
    """

    constant: float
    information: Array
    target: Array
    factor: Array
    white: Array
    own: Array
    scale: float


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """One block of a view: data (n,), its baseline (n, p), the effects' columns (n, k)."""

    view: View
    y: Array
    baseline: Array
    effects: Array

    @classmethod
    def of(cls, view: View, block: int, effects: list[Array]) -> _Part:
        baseline = view.baseline[block] / np.maximum(np.abs(view.baseline[block]).max(axis=0), 1e-300)
        columns = np.concatenate([np.zeros((view.y.shape[1], 0)), *effects], axis=1)
        return cls(view, view.y[block], baseline, columns)

    def sums(self, rows: NDArray[np.bool_], lower: Array, scale: float | None = None) -> _Sums:
        """Return what the bins `rows` say. lower: (m, m) factor of their shape; scale: theirs by default."""
        both = np.column_stack([self.baseline, self.effects, self.y])[rows]
        white = _whitened(lower, both)
        p = self.baseline.shape[1]
        own = np.linalg.cholesky(white[:, :p].T @ white[:, :p] + DIFFUSE * np.eye(p))
        taken = np.linalg.solve(own, white[:, :p].T @ white[:, p:])
        left = white[:, p:].T @ white[:, p:] - taken.T @ taken
        if scale is None:
            scale = self._scale(left, len(white) - p)
        logs = np.log(lower.diagonal()).sum() + np.log(own.diagonal()).sum()
        freedom = (len(white) - p) * float(np.log(scale)) + len(white) * float(np.log(2.0 * np.pi))
        constant = -0.5 * float(left[-1, -1]) / scale - float(logs) - 0.5 * freedom
        information, target = left[:-1, :-1] / scale, left[:-1, -1] / scale
        return _Sums(constant, information, target, lower, white, np.asarray(own), scale)

    def _scale(self, left: Array, freedom: int) -> float:
        """Return the likeliest scale; left: (k + 1, k + 1) inner products of the effects and the data."""
        gram, pull = left[:-1, :-1], left[:-1, -1]
        explained = float(pull @ np.linalg.solve(gram + np.eye(pull.size), pull)) if pull.size else 0.0
        return float((self.view.known + max(left[-1, -1] - explained, 0.0)) / (self.view.known + freedom))

    def told(self, rows: NDArray[np.bool_], sums: _Sums, size: Array) -> tuple[Array, Array]:
        """Return how far the bins that are not `rows` are from the mean model that `rows` tell, and leverage.

        To the mean belongs what the baseline absorbs. size: (k,) of the effects, from all parts.
        """
        baseline, effects, y = np.split(sums.white, [self.baseline.shape[1], sums.white.shape[1] - 1], axis=1)
        white = y[:, 0] - effects @ size
        offset = np.linalg.solve(sums.own.T, np.linalg.solve(sums.own, baseline.T @ white))
        away = (self.y - self.effects @ size - self.baseline @ offset)[~rows]
        there = np.column_stack([self.baseline, self.effects])[~rows]
        columns = sums.white[:, :-1]
        prior = np.repeat([DIFFUSE, 1.0], [baseline.shape[1], effects.shape[1]])
        unknown = np.linalg.inv(columns.T @ columns / sums.scale + np.diag(prior))
        variance = 0.0
        if self.view.absorbed is not None:
            known, absorbed = _whitened(sums.factor, self.view.absorbed[rows]), self.view.absorbed[~rows]
            away = away - absorbed @ (known.T @ (white - baseline @ offset))
            there = there - absorbed @ (known.T @ columns)
            free = np.eye(known.shape[1]) - known.T @ known
            variance = sums.scale * np.einsum("ij,jk,ik->i", absorbed, free, absorbed)
        variance = variance + np.einsum("ij,jk,ik->i", there, unknown, there)
        return np.asarray(away), np.asarray(variance / (sums.scale * self.view.variance[~rows]))


def _evidence(sums: Sequence[_Sums], own: int) -> tuple[float, Array]:
    """Return the log density of all parts with the effects' sizes integrated out, and their mean sizes.

    Nobody knows beforehand how large the first effect is, with `own` parameters: its prior is the mixture of
    the Bayes factor's. An effect with many parameters must not lose to one with few for its prior's width.
    """
    information = np.asarray(sum(s.information for s in sums))
    target = np.asarray(sum(s.target for s in sums))
    constant = sum(s.constant for s in sums)
    sizes = SIZES if own else SIZES[:1]
    widths = np.where(np.arange(target.size) < own, sizes[:, None], 1.0)
    precision = widths[:, :, None] * information * widths[:, None, :] + np.eye(target.size)
    lower = np.linalg.cholesky(precision)
    half = np.linalg.solve(lower, (widths * target)[:, :, None])[:, :, 0]
    logs = np.log(lower.diagonal(axis1=1, axis2=2)).sum(axis=1)
    values = constant + 0.5 * (half**2).sum(axis=1) - logs
    total = log_sum(values)
    means = widths * np.linalg.solve(lower.transpose(0, 2, 1), half[:, :, None])[:, :, 0]
    return total - float(np.log(len(values))), np.asarray(np.exp(values - total) @ means)
