"""Likelihood of an effect with the noise refitted under it: averaged over covariance shapes.

Parameters are in units of their physical size and have a standard normal prior. A view is reduced once to
the few sums that every hypothesis needs; a hypothesis is then judged in milliseconds. docs/misfit.md, 3,
has the formulas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.misfit.shapes import shapes
from stillcal.calib_core.misfit.views import View
from stillcal.calib_core.samples import Array

PRIOR_DOF = 10.0
ITERATIONS = 25


@dataclass(frozen=True, slots=True, eq=False)
class Reduced:
    """A view under G shapes with M candidate columns.

    prior: (G,) log; constant: (G,) prior and determinants; yy: (G,); xy: (G, M); blocks: one (G, k, k) a
    hypothesis; columns: its column indices; dof: nu0 + n - p; walk: (G,) variance rate, 1/s, of random walks.
    """

    prior: Array
    constant: Array
    yy: Array
    xy: Array
    blocks: list[Array]
    columns: list[Array]
    dof: float
    family: tuple[str, ...]
    walk: Array


def reduce_view(view: View, design: Array, columns: list[Array], extra: Array | None = None) -> Reduced:
    """Whiten, project the baseline out, keep the sums. design: (b, n, M); columns[h]: (k,) of hypothesis h.

    extra: (b, n, q) columns of effects already found, projected out with the baseline over all blocks.
    """
    prior, constant, yy, xy, family, walk = [], [], [], [], [], []
    grams = []
    seen = np.abs(design).max(axis=(0, 1)) > 0.0
    for shape, weight in shapes(view):
        factor = np.linalg.cholesky(shape.covariance)
        y, visible, determinant = _whitened(
            np.asarray(factor, dtype=np.float64), view, design[:, :, seen], extra
        )
        x = np.zeros((y.size, seen.size))
        x[:, seen] = visible
        log_det = 2.0 * len(view.y) * float(np.log(factor.diagonal()).sum())
        prior.append(np.log(weight))
        constant.append(np.log(weight) - 0.5 * (log_det + determinant))
        yy.append(y @ y)
        xy.append(y @ x)
        grams.append(_grams(x, columns))
        family.append(shape.family)
        walk.append(shape.walk)
    baseline = view.parameters + (0 if extra is None else extra.shape[2])
    return Reduced(
        np.array(prior),
        np.array(constant),
        np.array(yy),
        np.array(xy).reshape(len(yy), -1),
        [np.array(b) for b in zip(*grams, strict=True)],
        columns,
        PRIOR_DOF + view.y.size - baseline,
        tuple(family),
        np.array(walk),
    )


def _grams(x: Array, columns: list[Array]) -> list[Array]:
    """Return the (k, k) inner products of each hypothesis' columns; those of one width are done together."""
    out: list[Array] = [np.empty(0)] * len(columns)
    for width in {c.size for c in columns}:
        rows = [i for i, c in enumerate(columns) if c.size == width]
        stacked = x[:, np.array([columns[i] for i in rows])].transpose(1, 2, 0)
        for i, gram in zip(rows, stacked @ stacked.transpose(0, 2, 1), strict=True):
            out[i] = gram
    return out


def _whitened(factor: Array, view: View, design: Array, extra: Array | None) -> tuple[Array, Array, float]:
    """Return y (b n,) and design (b n, M), whitened and free of the baseline, and log|B' C^-1 B|."""
    from scipy.linalg import solve_triangular  # noqa: PLC0415 - the daemon stays light

    blocks_y, blocks_x, blocks_e, determinant = [], [], [], 0.0
    for b in range(len(view.y)):
        found = np.zeros((view.y.shape[1], 0)) if extra is None else extra[b]
        width = view.baseline.shape[2]
        everything = np.column_stack([view.baseline[b], view.y[b], design[b], found])
        everything = solve_triangular(factor, everything, lower=True, check_finite=False)
        q, r = np.linalg.qr(everything[:, :width])
        stacked = everything[:, width:]
        determinant += 2.0 * float(np.log(np.abs(r.diagonal()) + 1e-300).sum())
        stacked -= q @ (q.T @ stacked)
        blocks_y.append(stacked[:, 0])
        blocks_x.append(stacked[:, 1 : 1 + design.shape[2]])
        blocks_e.append(stacked[:, 1 + design.shape[2] :])
    y, x = np.concatenate(blocks_y), np.concatenate(blocks_x)
    if extra is not None:
        q, _ = np.linalg.qr(np.concatenate(blocks_e))
        y, x = y - q @ (q.T @ y), x - q @ (q.T @ x)
    return y, x, determinant


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A hypothesis at its maximum. beta: (k,); covariance: (k, k); log_likelihood over all views."""

    beta: Array
    covariance: Array
    log_likelihood: float


def null_log_likelihood(views: Sequence[Reduced]) -> float:
    """Return the log likelihood of the views with no effect."""
    return joint(views, [log_terms(v, v.yy) for v in views])[0]


def joint(views: Sequence[Reduced], terms: list[Array]) -> tuple[float, list[Array]]:
    """Return the log likelihood of all views and each view's shape probabilities (G,), from their log terms.

    The axes of a sensor are made alike: with probability one half they share one shape, else each has its
    own. Views that do not have the same shapes are independent.
    """
    own = [log_sum(t) for t in terms]
    apart, weights = float(sum(own)), [np.exp(t - s) for t, s in zip(terms, own, strict=True)]
    if len(views) < 2 or any(v.family != views[0].family for v in views):
        return apart, weights
    shared = sum((t - v.prior for t, v in zip(terms, views, strict=True)), views[0].prior)
    together = log_sum(np.asarray(shared))
    value = float(np.logaddexp(together, apart) - np.log(2.0))
    alike = float(np.exp(together - np.log(2.0) - value))
    common = np.exp(shared - together)
    return value, [alike * common + (1.0 - alike) * w for w in weights]


def log_terms(view: Reduced, residual: Array) -> Array:
    """Return log prior plus log likelihood (G,) of every shape at sums of squares `residual` (G,)."""
    return np.asarray(view.constant - 0.5 * view.dof * np.log(PRIOR_DOF + residual))


def log_sum(terms: Array) -> float:
    """Return the logarithm of the sum of exponentials."""
    top = float(terms.max())
    return top + float(np.log(np.exp(terms - top).sum()))


def posterior_weights(view: Reduced) -> Array:
    """Return the posterior probability (G,) of each shape with no further effect."""
    terms = log_terms(view, view.yy)
    return np.asarray(np.exp(terms - log_sum(terms)))


def gain_bound(views: Sequence[Reduced], h: int) -> float:
    """Return an upper bound of the log likelihood of hypothesis `h`: every shape at its own best."""
    return joint(views, [log_terms(v, _least(v, h)) for v in views])[0]


def _least(view: Reduced, h: int) -> Array:
    gram, xy = view.blocks[h], view.xy[:, view.columns[h]]
    ridge = gram + 1e-9 * (np.einsum("gii->g", gram)[:, None, None] + 1e-300) * np.eye(gram.shape[1])
    solved = np.linalg.solve(ridge, xy[:, :, None])[:, :, 0]
    return np.asarray(np.maximum(view.yy - np.einsum("gi,gi->g", xy, solved), 0.0))


def fit_hypothesis(views: Sequence[Reduced], h: int) -> Fit:
    """Fit hypothesis `h` to all views at once; the better of two starts (likely shapes, and white noise)."""
    _, likely = joint(views, [log_terms(v, v.yy) for v in views])
    informed = [w * v.dof / (PRIOR_DOF + v.yy) for v, w in zip(views, likely, strict=True)]
    plain = [np.eye(len(v.yy))[0] for v in views]
    fits = [_climb(views, h, start) for start in (informed, plain)]
    return max(fits, key=lambda f: f.log_likelihood)


def _climb(views: Sequence[Reduced], h: int, weights: list[Array]) -> Fit:
    """Climb by expectation maximisation over shapes and scales: every step is a weighted least squares."""
    beta = _solve(views, h, weights)
    for _ in range(ITERATIONS):
        left = [residuals(v, h, beta) for v in views]
        _, likely = joint(views, [log_terms(v, r) for v, r in zip(views, left, strict=True)])
        weights = [w * v.dof / (PRIOR_DOF + r) for v, w, r in zip(views, likely, left, strict=True)]
        previous, beta = beta, _solve(views, h, weights)
        if np.allclose(previous, beta, rtol=1e-5, atol=1e-9):
            break
    terms = [log_terms(v, residuals(v, h, beta)) for v in views]
    value, likely = joint(views, terms)
    return Fit(beta, _covariance(views, h, beta, likely), value - 0.5 * float(beta @ beta))


def residuals(view: Reduced, h: int, beta: Array) -> Array:
    """Return the whitened sum of squares (G,) under every shape with hypothesis `h` at `beta`."""
    linear = view.xy[:, view.columns[h]] @ beta
    quadratic = np.einsum("i,gij,j->g", beta, view.blocks[h], beta)
    return np.asarray(np.maximum(view.yy - 2.0 * linear + quadratic, 0.0))


def _solve(views: Sequence[Reduced], h: int, weights: list[Array]) -> Array:
    information = sum(np.einsum("g,gij->ij", w, v.blocks[h]) for v, w in zip(views, weights, strict=True))
    target = sum(w @ v.xy[:, v.columns[h]] for v, w in zip(views, weights, strict=True))
    linear = np.asarray(target)
    return np.asarray(
        np.linalg.solve(np.asarray(information) + np.eye(linear.size), linear), dtype=np.float64
    )


def _covariance(views: Sequence[Reduced], h: int, beta: Array, likely: list[Array]) -> Array:
    """Return the inverse observed information of the shape-averaged likelihood (Louis, JRSS B 44, 1982)."""
    expected = np.zeros((beta.size, beta.size))
    missing = np.zeros_like(expected)
    for v, weight in zip(views, likely, strict=True):
        rate = v.dof / (PRIOR_DOF + residuals(v, h, beta))
        score = rate[:, None] * (v.xy[:, v.columns[h]] - v.blocks[h] @ beta)
        mean = weight @ score
        expected += np.einsum("g,gij->ij", weight * rate, v.blocks[h])
        missing += np.einsum("g,gi,gj->ij", weight * (1.0 + 2.0 / v.dof), score, score) - np.outer(mean, mean)
    observed = expected - missing
    # Where the shapes disagree so much that the curvature is lost, the expected information is all there is.
    curvature = observed if np.linalg.eigvalsh(observed).min() > 0 else expected
    return np.asarray(np.linalg.inv(curvature + np.eye(beta.size)), dtype=np.float64)
