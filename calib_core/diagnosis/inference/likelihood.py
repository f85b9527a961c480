"""Likelihood of an effect with the noise refitted under it: averaged over covariance shapes.

Parameters are in units of their physical size and have a standard normal prior. A view is reduced once to
the few sums that every hypothesis needs; a hypothesis is then judged in milliseconds. docs/diagnosis.md, 3,
has the formulas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.noise_models import STRENGTHS, Family, families
from stillcal.calib_core.diagnosis.model.measurement import Index
from stillcal.calib_core.diagnosis.model.residuals import View

ITERATIONS = 25
ALONG = 1e-6
"""Part of a column's own length below which it lies along the baseline, or along other columns."""

ROUNDING = 1e-12
"""Part of a column's own square that is left at least when the baseline is taken from it."""

AT_ONCE = 2**20
"""Numbers that are held at once or kept for later, as few as fit a processor's memory close by (8 MiB)."""

NOTHING = -1
"""The last hypothesis of every reduced view: no effect."""

ALIKE = 0.95
"""Prior probability that the wander of a sensor's axes is of one kind and nearly one strength."""

NEARLY = (0.5, 0.35, 0.2, 0.1, 0.05)
"""Weights of an axis' strength 0, 1, ... quarter decades of variance off the strength that the axes share."""


@dataclass(frozen=True, slots=True, eq=False)
class Reduced:
    """A view under G shapes, with the inner products of every hypothesis' columns.

    prior: (G,) log; constant: (G,) prior and determinants; yy: (G,); pulls: one (G, k) a hypothesis, of its
    columns with the data; blocks: one (G, k, k) a hypothesis, of its columns with each other; dof:
    nu0 + n - p; power: (G,) variance of the wander; walk: (G,) variance rate, 1/s, of random walks; jump:
    (G,) variance of what is another in every rest; known: nu0.

    shared: how many parameters at the end of every hypothesis are not the effect's: what all views of a
    sensor share whatever else there is. Hypothesis `NOTHING` has these alone. settled: (c,) their
    likeliest values with no effect; left: (G,) sums of squares there.
    """

    prior: Array
    constant: Array
    yy: Array
    pulls: list[Array]
    blocks: list[Array]
    dof: float
    family: tuple[str, ...]
    power: Array
    walk: Array
    jump: Array
    known: float
    shared: int
    settled: Array
    left: Array

    def own(self, h: int) -> Array:
        """Return the inner products (G, k, k) of an effect's own columns."""
        k = self.blocks[h].shape[1] - self.shared
        return self.blocks[h][:, :k, :k]

    def with_parts(self, parts: Sequence[Sequence[Index]]) -> Reduced:
        """Return a view with every hypothesis but `NOTHING` followed by parts of it.

        parts: for each, the indices of the effect's own columns that each part has.
        """
        pulls, blocks = [], []
        for pull, block, chosen in zip(self.pulls, self.blocks, parts, strict=False):
            always = np.arange(block.shape[1] - self.shared, block.shape[1])
            rows = [np.concatenate([own, always]) for own in chosen]
            pulls += [pull, *(pull.take(r, axis=1) for r in rows)]
            blocks += [block, *(block.take(r, axis=1).take(r, axis=2) for r in rows)]
        return replace(self, pulls=[*pulls, self.pulls[NOTHING]], blocks=[*blocks, self.blocks[NOTHING]])


def reduce_view(
    view: View,
    design: Array,
    columns: list[Array],
    extra: Array | None = None,
    shared: Array | None = None,
) -> Reduced:
    """Whiten, project the baseline out, keep the sums. design: (b, n, M); columns[h]: (k,) of hypothesis h.

    extra: (b, n, q) columns of effects already found, projected out with the baseline over all blocks.
    shared: (b, n, c) columns of parameters that go with every hypothesis, at one standard deviation.
    """
    made = families(view)
    always = np.zeros((*view.y.shape, 0)) if shared is None else shared
    last = np.arange(design.shape[2], design.shape[2] + always.shape[2])
    columns = [np.concatenate([own, last]) for own in [*columns, last[:0]]]
    design = np.concatenate([design, always], axis=2)
    seen = np.abs(design).max(axis=(0, 1)) > 0.0
    number = np.cumsum(seen) - 1
    blocks, groups = len(view.y), _grouped([number[own[seen[own]]] for own in columns])
    few, shown = stacked(view, design[:, :, :0], extra), design[:, :, seen]
    volume = -2.0 * blocks * float(np.linalg.slogdet(made[0].rotation)[1])
    ends = np.cumsum([0, *(len(family.diagonals) for family in made)])
    grams = [np.empty((len(own), ends[-1], *[own.shape[1]] * 2)) for _, own in groups]
    xy = np.zeros((ends[-1], seen.size))
    parts = []
    for family, (start, end) in zip(made, pairwise(ends), strict=True):
        root = 1.0 / np.sqrt(family.diagonals)
        own, determinant, y, found = _without_candidates(view, family, root, few)
        turned = family.rotation @ shown
        roots = np.tile(root, (1, blocks))
        flat = turned.reshape(y.shape[1], -1)
        by_block = np.swapaxes(own * root[:, None, :, None], -1, -2) @ turned
        lost = np.concatenate(
            [by_block.reshape(len(root), view.parameters, flat.shape[1]), (found * roots[:, None, :]) @ flat],
            axis=1,
        )
        log_det = blocks * np.log(family.diagonals).sum(axis=1) + volume
        for (_, which), gram in zip(groups, grams, strict=True):
            _fill(gram[:, start:end], turned.swapaxes(1, 2), 1.0 / family.diagonals, lost, which)
        xy[start:end, seen] = (y * roots) @ flat
        prior = np.log(family.weight)
        constant = prior - 0.5 * (log_det + determinant)
        parts.append((prior, constant, np.einsum("gn,gn->g", y, y)))
    prior, constant, yy = (np.concatenate(each) for each in zip(*parts, strict=True))
    baseline = view.parameters + (0 if extra is None else extra.shape[2])
    names = tuple(f.name for f in made for _ in f.strengths)
    return Reduced(
        prior,
        constant,
        yy,
        [xy[:, c] for c in columns],
        _apart(groups, grams, [seen[own] for own in columns]),
        view.known + view.y.size - baseline,
        names,
        np.concatenate([f.power for f in made]),
        np.concatenate([f.walk for f in made]),
        np.concatenate([f.jump for f in made]),
        view.known,
        last.size,
        np.zeros(last.size),
        yy,
    )


def with_shared_fitted(views: list[Reduced]) -> list[Reduced]:
    """Return the views of one sensor with what is left where no effect is: all that they share fitted."""
    if views[0].shared == 0:
        return views
    beta = maximum(views, NOTHING)[0]
    return [replace(v, settled=beta, left=squares_left(v, NOTHING, beta)) for v in views]


@cache
def _nearness() -> Array:
    """Return the probability (S, S) of strength j given the shared strength i: nearly the same."""
    apart = np.abs(np.subtract.outer(np.arange(STRENGTHS.size), np.arange(STRENGTHS.size)))
    weight = np.append(NEARLY, 0.0)[np.minimum(apart, len(NEARLY))]
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))


def _grouped(columns: list[Array]) -> list[tuple[list[int], Array]]:
    """Put hypotheses with as many columns together: which they are, and their columns (r, k)."""
    widths: dict[int, list[int]] = {}
    for i, c in enumerate(columns):
        widths.setdefault(c.size, []).append(i)
    return [(rows, np.array([columns[i] for i in rows])) for rows in widths.values()]


def _fill(gram: Array, turned: Array, weight: Array, lost: Array, columns: Array) -> None:
    """Write the inner products of the columns (r, k) of r hypotheses into gram (r, S, k, k).

    turned: (b, M, n) all columns in axes where the S shapes are diagonal, weight: (S, n) their inverse
    variances there. lost: (S, c, M) what of the columns lies along the c directions that are projected out.
    The products of columns are the same under all shapes, so one matrix product weighs them for all.
    """
    k = columns.shape[1]
    place = _places(k)
    at_once = max(AT_ONCE // max(weight.shape[1] * k * (k + 1) // 2, 1), 1)
    for first in range(0, len(columns), at_once):
        some = slice(first, first + at_once)
        pairs = _products(turned[:, columns[some]])
        part = pairs @ weight.T
        gram[some] = part[:, place].transpose(0, 3, 1, 2)
    away = lost[:, :, columns].transpose(2, 0, 3, 1)
    least = ROUNDING * np.einsum("...ii->...i", gram)
    gram -= away @ np.swapaxes(away, -1, -2)
    d = np.arange(k)
    gram[..., d, d] = np.maximum(gram[..., d, d], least)


def _products(columns: Array) -> Array:
    """Return the products (r, k (k + 1) / 2, n) of any two of each hypothesis' columns (b, r, k, n).

    They are summed over the b blocks; the order is that of `_places`.
    """
    r, k, n = columns.shape[1:]
    out = np.empty((r, k * (k + 1) // 2, n))
    first, *others = columns
    start = 0
    for apart in range(k):
        to = out[:, start : start + k - apart]
        np.multiply(first[:, : k - apart], first[:, apart:], out=to)
        for block in others:
            to += block[:, : k - apart] * block[:, apart:]
        start += k - apart
    return out


@cache
def _places(k: int) -> Index:
    """Return where the product of columns i and j lies (k, k): squares, then neighbours, and so on."""
    place = np.zeros((k, k), dtype=np.int64)
    start = 0
    for apart in range(k):
        i = np.arange(k - apart)
        place[i, i + apart] = place[i + apart, i] = start + i
        start += k - apart
    return place


def _apart(groups: list[tuple[list[int], Array]], grams: list[Array], seen: list[Array]) -> list[Array]:
    """Return the inner products (G, k, k) of each hypothesis under every shape.

    seen: for each, which of its k columns are not zero in this view; the groups have these alone.
    """
    of = {i: gram[j] for (rows, _), gram in zip(groups, grams, strict=True) for j, i in enumerate(rows)}
    return [_among_zeros(of[i], own) for i, own in enumerate(seen)]


def _among_zeros(gram: Array, seen: Array) -> Array:
    """Return inner products (G, k, k) from those of the columns that are not zero."""
    if seen.all():
        return gram
    out = np.zeros((len(gram), seen.size, seen.size))
    rows = np.flatnonzero(seen)
    out[:, rows[:, None], rows] = gram
    return out


def stacked(view: View, design: Array, extra: Array | None) -> Array:
    """Return (b, n, p + 1 + M + q): baseline, data, candidates, effects found already."""
    found = np.zeros((*view.y.shape, 0)) if extra is None else extra
    return np.concatenate([view.baseline, view.y[:, :, None], design, found], axis=2)


def projected(whitened: Array, width: int, candidates: int) -> tuple[Array, Array]:
    """Return y (S, b n) and design (S, b n, M) free of the baseline and what was found.

    whitened: (S, b, n, width + 1 + M + q), under S shapes, in the order of `stacked`.
    """
    few = np.delete(whitened, np.s_[width + 1 : width + 1 + candidates], axis=3)
    own, _ = _orthonormal(few[..., :width])
    y, found = _freed(few[..., width:], own)
    design = whitened[..., width + 1 : width + 1 + candidates]
    design = (design - own @ (np.swapaxes(own, -1, -2) @ design)).reshape(*y.shape, candidates)
    return y, design - np.swapaxes(found, -1, -2) @ (found @ design)


def _without_candidates(
    view: View, family: Family, root: Array, few: Array
) -> tuple[Array, Array, Array, Array]:
    """Return what `_own_baseline` and `_freed` make of a view; it keeps the last where that is small.

    root: (S, n) of the inverse variances of the family's shapes; few: (b, n, p + 1 + q) baseline, data and
    what was found: the same for all batches of candidates.
    """
    kept: dict[str, tuple[Array, tuple[Array, Array, Array, Array]]] = view.memo.setdefault("apart", {})
    last = kept.get(family.name)
    if last is not None and np.array_equal(last[0], few):
        return last[1]
    width = view.baseline.shape[2]
    whitened = (family.rotation @ few) * root[:, None, :, None]
    own, determinant = _own_baseline(view, family.name, whitened[..., :width])
    made = own, determinant, *_freed(whitened[..., width:], own)
    if sum(part.size for part in made) <= AT_ONCE // 8:  # there are twenty families
        kept[family.name] = few, made
    return made


def _own_baseline(view: View, family: str, whitened: Array) -> tuple[Array, Array]:
    """Return what `_orthonormal` makes of a view's own baseline; the view keeps it where it is small."""
    kept: dict[str, tuple[Array, Array]] = view.memo.setdefault("baselines", {})
    if family in kept:
        return kept[family]
    made = _orthonormal(whitened)
    if made[0].size <= AT_ONCE:
        kept[family] = made
    return made


def _orthonormal(whitened: Array) -> tuple[Array, Array]:
    """Return each block's whitened baseline (S, b, n, p), orthonormal, and log|B' C^-1 B| (S,)."""
    own, r = np.linalg.qr(whitened)
    return own, 2.0 * np.log(np.abs(np.einsum("...ii->...i", r)) + 1e-300).sum(axis=(-2, -1))


def _freed(rest: Array, own: Array) -> tuple[Array, Array]:
    """Return the data (S, b n) free of the baseline and what was found, and the directions of the latter.

    rest: (S, b, n, 1 + q) data and what was found, whitened under S shapes; own: the baseline, as
    `_orthonormal` has it. The second is (S, q, b n), over all blocks, orthonormal or nothing.
    """
    shapes, blocks, n = rest.shape[:3]
    before = np.sqrt((rest**2).sum(axis=(1, 2)))
    rest = (rest - own @ (np.swapaxes(own, -1, -2) @ rest)).reshape(shapes, blocks * n, -1)
    found, sizes, _ = np.linalg.svd(rest[:, :, 1:] / (before[:, None, 1:] + 1e-300), full_matrices=False)
    found = np.swapaxes(found * (sizes > ALONG)[:, None, :], -1, -2)
    y = rest[:, :, 0]
    y = y - np.einsum("sqn,sq->sn", found, np.einsum("sqn,sn->sq", found, y))
    return y, found


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A hypothesis at its maximum. beta: (k,); covariance: (k, k); log_likelihood over all views.

    every: (k + c,) the parameters with those that every hypothesis has.
    """

    beta: Array
    covariance: Array
    log_likelihood: float
    every: Array


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
