"""Likelihood of an effect with the noise refitted under it: averaged over covariance shapes.

Parameters are in units of their physical size and have a standard normal prior. Views are reduced to sums
before (`reduction`); a hypothesis is then judged in milliseconds. docs/diagnosis.md, 3, has the formulas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.noise_models import STRENGTHS
from stillcal.calib_core.diagnosis.inference.reduction import NOTHING, Reduced, reduce_view
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals

ITERATIONS = 25
ALIKE = 0.95
"""Prior probability that the wander of a sensor's axes is of one kind and nearly one strength."""

NEARLY = (0.5, 0.35, 0.2, 0.1, 0.05)
"""Weights of an axis' strength 0, 1, ... quarter decades of variance off the strength that the axes share."""


def reduce_residuals(
    residuals: SensorResiduals,
    hypotheses: Sequence[Hypothesis] = (),
    found: Sequence[Hypothesis] = (),
    *,
    parts: bool = False,
) -> list[Reduced]:
    """Reduce every view for hypotheses, and for none of them; with `parts`, each is followed by its axes."""
    widths = [h.columns[0].shape[2] for h in hypotheses]
    ends = np.cumsum([0, *widths])
    index = [np.arange(a, b) for a, b in pairwise(ends)]
    reduced = []
    for i, view in enumerate(residuals.views):
        none = np.zeros((*view.y.shape, 0))
        design = np.concatenate([none, *(h.columns[i] * h.sizes for h in hypotheses)], axis=2)
        extra = np.concatenate([f.columns[i] * f.sizes for f in found], axis=2) if found else None
        always = None if residuals.shared is None else residuals.shared.columns[i] * residuals.shared.sizes
        reduced.append(reduce_view(view, design, index, _nonzero(extra), always))
    if parts:
        axes = [[np.flatnonzero(h.axis_of == a) for a in range(3)] for h in hypotheses]
        reduced = [view.with_parts(axes) for view in reduced]
    return _with_shared_fitted(reduced)


def _nonzero(extra: Array | None) -> Array | None:
    """Drop columns that a view does not see."""
    if extra is None:
        return None
    seen = np.abs(extra).max(axis=(0, 1)) > 0.0
    return extra[:, :, seen] if seen.any() else None


def null_log_likelihood(views: Sequence[Reduced]) -> float:
    """Return the log likelihood of the views with no effect."""
    return highest(views, NOTHING)


def joint(views: Sequence[Reduced], terms: list[Array]) -> tuple[float, list[Array]]:
    """Return the log likelihood of all views and each view's shape probabilities (G,), from their log terms.

    The axes of a sensor are made alike: with probability `ALIKE` they share a kind of wander and scatter
    about one strength, else each has its own. Views that do not have the same shapes are independent.
    """
    own = [log_sum(t) for t in terms]
    weights = [np.exp(t - s) for t, s in zip(terms, own, strict=True)]
    axes = _Axes.of(views, terms)
    if axes is None:
        return float(sum(own)), weights
    value = axes.log_likelihood(float(sum(own)))
    alike = float(np.exp(axes.together + np.log(ALIKE) - value))
    return value, [alike * n + (1.0 - alike) * w for n, w in zip(axes.weights(), weights, strict=True)]


def joint_log_likelihood(views: Sequence[Reduced], terms: list[Array]) -> float:
    """Return the log likelihood of all views alone, as `joint` does."""
    apart = float(sum(log_sum(t) for t in terms))
    axes = _Axes.of(views, terms)
    return apart if axes is None else axes.log_likelihood(apart)


@dataclass(frozen=True, slots=True, eq=False)
class _Axes:
    """Views that share a kind of wander and nearly its strength.

    bare: (views, G) likelihoods, the largest of a view being about 1; near: (views, G) what they are about a
    shared shape; shared: (G,) log probabilities of that shape, but for their sum, which `together` has with
    the logarithms of what the views were divided by.
    """

    bare: Array
    near: Array
    shared: Array
    together: float

    @classmethod
    def of(cls, views: Sequence[Reduced], terms: list[Array]) -> _Axes | None:
        """Return views that have the same shapes; None where they do not."""
        if len(views) < 2 or any(v.family != views[0].family for v in views):
            return None
        prior, every = views[0].prior, np.array(terms)
        tops = every.max(axis=1, keepdims=True)
        bare = np.exp(np.maximum(every - prior - tops, -600.0))
        near = _blurred(bare, _nearness())
        shared = prior + np.log(near).sum(axis=0)
        total = log_sum(shared)
        return cls(bare, near, shared - total, total + float(tops.sum()))

    def log_likelihood(self, apart: float) -> float:
        """Return the log likelihood; apart: that of views which share nothing."""
        return float(np.logaddexp(self.together + np.log(ALIKE), apart + np.log(1.0 - ALIKE)))

    def weights(self) -> Array:
        """Return each view's shape probabilities (views, G)."""
        return np.asarray(self.bare * _blurred(np.exp(self.shared) / self.near, _nearness().T))


@cache
def _nearness() -> Array:
    """Return the probability (S, S) of strength j given the shared strength i: nearly the same."""
    apart = np.abs(np.subtract.outer(np.arange(STRENGTHS.size), np.arange(STRENGTHS.size)))
    weight = np.append(NEARLY, 0.0)[np.minimum(apart, len(NEARLY))]
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))


def _blurred(values: Array, nearness: Array) -> Array:
    """Return what lies about every shape of values (views, G): white noise is near itself alone."""
    out = values.copy()
    by_kind = values[:, 1:].reshape(-1, len(nearness))
    out[:, 1:] = (by_kind @ nearness.T).reshape(len(values), -1)
    return out


def log_terms(view: Reduced, residual: Array) -> Array:
    """Return log prior plus log likelihood (G,) of every shape at sums of squares `residual` (G,)."""
    return np.asarray(view.constant - 0.5 * view.dof * np.log(view.known + residual))


def log_sum(terms: Array) -> float:
    """Return the logarithm of the sum of exponentials."""
    top = float(terms.max())
    return top + float(np.log(np.exp(terms - top).sum()))


def gain_bound(views: Sequence[Reduced], h: int) -> float:
    """Return about the largest log likelihood that hypothesis `h` may have: every shape at its own best.

    It is an upper bound but for what all views share, which is held where it is with no effect: free for
    every view and shape, it would explain what no one vector can.
    """
    return joint_log_likelihood(views, [log_terms(v, _least(v, h)) for v in views])


def _least(view: Reduced, h: int) -> Array:
    """Return the least sum of squares (G,) under each shape, with what is shared held where it is settled."""
    gram = view.own(h)
    k = gram.shape[1]
    seen = gram[0].diagonal() > 0.0
    if not seen.any():
        return view.left
    xy = view.pulls[h][:, :k] - view.blocks[h][:, :k, k:] @ view.settled
    if not seen.all():
        gram, xy = gram[:, seen][:, :, seen], xy[:, seen]
    ridge = 1e-9 * (np.einsum("gii->g", gram)[:, None, None] + 1e-300) * np.eye(gram.shape[1])
    return np.asarray(np.maximum(view.left - explained(gram + ridge, xy), 0.0))


def explained(gram: Array, pull: Array) -> Array:
    """Return the sum of squares (G,) that columns explain. gram: (G, k, k); pull: (G, k), with the data.

    Columns are eliminated one by one, under all shapes at once: a solver takes the shapes one by one.
    """
    rest, target = np.moveaxis(gram, 0, -1).copy(), pull.T.copy()
    total = np.zeros(len(gram))
    for i in range(len(target)):
        total += target[i] ** 2 / rest[i, i]
        share = rest[i + 1 :, i] / rest[i, i]
        target[i + 1 :] -= share * target[i]
        rest[i + 1 :, i + 1 :] -= share[:, None] * rest[i, i + 1 :]
    return total


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A hypothesis at its maximum. beta: (k,); covariance: (k, k); log_likelihood over all views.

    every: (k + c,) the parameters with those that every hypothesis has.
    """

    beta: Array
    covariance: Array
    log_likelihood: float
    every: Array


def fit_hypothesis(views: Sequence[Reduced], h: int, top: Maximum | None = None) -> Fit:
    """Fit hypothesis `h` to all views at once, and tell how sure its parameters are.

    top: its maximum, where that is known already.
    """
    beta, value, weights = top or maximum(views, h)
    k = beta.size - views[0].shared
    return Fit(beta[:k], _covariance(views, h, beta, weights)[:k, :k], value, beta)


def highest(views: Sequence[Reduced], h: int) -> float:
    """Return the log likelihood of hypothesis `h` at its maximum."""
    return maximum(views, h)[1]


Maximum = tuple[Array, float, list[Array]]
"""Parameters (k,), their log likelihood, and the probabilities (G,) of the shapes in every view."""


def maximum(views: Sequence[Reduced], h: int) -> Maximum:
    """Return the better of two climbs, begun from the likely shapes and from white noise."""
    _, likely = joint(views, [log_terms(v, v.left) for v in views])
    informed = [w * v.dof / (v.known + v.left) for v, w in zip(views, likely, strict=True)]
    plain = [np.eye(len(v.yy))[0] for v in views]
    return max((_climb(views, h, start) for start in (informed, plain)), key=lambda c: c[1])


def _with_shared_fitted(views: list[Reduced]) -> list[Reduced]:
    """Return the views of one sensor with what is left where no effect is: all that they share fitted."""
    if views[0].shared == 0:
        return views
    beta = maximum(views, NOTHING)[0]
    return [replace(v, settled=beta, left=squares_left(v, NOTHING, beta)) for v in views]


def _climb(views: Sequence[Reduced], h: int, weights: list[Array]) -> Maximum:
    """Climb by expectation maximisation over shapes and scales: every step is a weighted least squares."""
    beta = _solve(views, h, weights)
    for _ in range(ITERATIONS):
        left = [squares_left(v, h, beta) for v in views]
        _, likely = joint(views, [log_terms(v, r) for v, r in zip(views, left, strict=True)])
        weights = [w * v.dof / (v.known + r) for v, w, r in zip(views, likely, left, strict=True)]
        previous, beta = beta, _solve(views, h, weights)
        if (np.abs(previous - beta) <= 1e-9 + 1e-5 * np.abs(beta)).all():
            break
    terms = [log_terms(v, squares_left(v, h, beta)) for v in views]
    value, likely = joint(views, terms)
    return beta, value - 0.5 * float(beta @ beta), likely


def squares_left(view: Reduced, h: int, beta: Array) -> Array:
    """Return the whitened sum of squares (G,) under every shape with hypothesis `h` at `beta`."""
    linear = view.pulls[h] @ beta
    quadratic = _flat(view, h) @ np.outer(beta, beta).ravel()
    return np.asarray(np.maximum(view.yy - 2.0 * linear + quadratic, 0.0))


def _solve(views: Sequence[Reduced], h: int, weights: list[Array]) -> Array:
    information = sum(_expected(v, h, w) for v, w in zip(views, weights, strict=True))
    target = sum(w @ v.pulls[h] for v, w in zip(views, weights, strict=True))
    linear = np.asarray(target)
    return np.asarray(
        np.linalg.solve(np.asarray(information) + np.eye(linear.size), linear), dtype=np.float64
    )


def _covariance(views: Sequence[Reduced], h: int, beta: Array, likely: list[Array]) -> Array:
    """Return the covariance (k, k) of a fit, its mean and spread under every shape taken together.

    A shape weighs by its likelihood with the parameters integrated out (Laplace), the other views held at
    their expected information: one that leaves a parameter uncertain has more room for it than the curvature
    at the maximum knows of. By that, 95 % intervals held the true rate of a gyroscope's drift in 62 %
    of 24 cases.
    """
    likeliest = _likeliest_precisions(views, h, beta)
    expected = [_expected(v, h, r * w) for v, r, w in zip(views, likeliest, likely, strict=True)]
    left = _left_of_precision(views, expected)
    rates = [part * r for part, r in zip(left, likeliest, strict=True)]
    expected = [part * own for part, own in zip(left, expected, strict=True)]
    pulls = [r[:, None] * (v.pulls[h] - v.blocks[h] @ beta) for v, r in zip(views, rates, strict=True)]
    pulled = sum(w @ p for w, p in zip(likely, pulls, strict=True)) - beta
    whole = sum(expected) + np.eye(beta.size)
    inverses, steps, terms = [], [], []
    for v, rate, pull, own, weight in zip(views, rates, pulls, expected, likely, strict=True):
        precision = whole - own + rate[:, None, None] * v.blocks[h]
        force = pulled - weight @ pull + pull
        inverse = np.linalg.inv(precision)
        step = np.einsum("gij,gj->gi", inverse, force)
        room = 0.5 * (np.einsum("gi,gi->g", force, step) - np.linalg.slogdet(precision)[1])
        inverses.append(inverse)
        steps.append(step)
        terms.append(log_terms(v, squares_left(v, h, beta)) + room)
    _, weights = joint(views, terms)
    new = [_expected(v, h, r * w) for v, r, w in zip(views, rates, weights, strict=True)]
    total = np.linalg.inv(sum(new) + np.eye(beta.size))
    for own, now, inverse, step, weight in zip(expected, new, inverses, steps, weights, strict=True):
        mixed = np.einsum("g,gij->ij", weight, inverse) + np.einsum("g,gi,gj->ij", weight, step, step)
        total = total + mixed - np.linalg.inv(whole - own + now)
    return np.asarray(total, dtype=np.float64)


def _likeliest_precisions(views: Sequence[Reduced], h: int, beta: Array) -> list[Array]:
    """Return one over the likeliest variance of each view's noise (G,), under every shape."""
    return [v.dof / (v.known + squares_left(v, h, beta)) for v in views]


def _left_of_precision(views: Sequence[Reduced], told: Sequence[Array]) -> list[float]:
    """Return the expected precision of each view's noise beside a fit, as a part of the likeliest one.

    told: (k, k) of each view, its information about the fitted numbers at that. These leave less than the
    noise, as far as a view and not their prior tells them. Its scale is unknown: the numbers have Student's
    distribution, whose variance is that of the expected variance.
    """
    whole = np.linalg.inv(sum(told) + np.eye(len(told[0])))
    return [
        max(v.dof - float(np.einsum("ij,ji->", own, whole)) - 2.0, 1.0) / v.dof
        for v, own in zip(views, told, strict=True)
    ]


def expected_information(views: Sequence[Reduced], h: int, beta: Array, likely: Sequence[Array]) -> Array:
    """Return the information (k, k) about hypothesis `h` at `beta`, over all views.

    likely: the probabilities (G,) of the shapes there, view by view.
    """
    rates = _likeliest_precisions(views, h, beta)
    parts = [_expected(v, h, w * r) for v, w, r in zip(views, likely, rates, strict=True)]
    return np.asarray(np.sum(parts, axis=0))


def _expected(view: Reduced, h: int, weight: Array) -> Array:
    k = view.blocks[h].shape[1]
    return np.asarray((weight @ _flat(view, h)).reshape(k, k))


def _flat(view: Reduced, h: int) -> Array:
    """Return the inner products of a hypothesis' columns as (G, k k), to be summed by one product."""
    return view.blocks[h].reshape(len(view.yy), -1)
