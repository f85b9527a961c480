"""A view reduced once to the few sums from which any hypothesis is judged, under every shape of its noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.noise_models import Family, families
from stillcal.calib_core.diagnosis.model.measurement import Index
from stillcal.calib_core.diagnosis.model.residuals import View

ALONG = 1e-6
"""Part of a column's own length below which it lies along the baseline, or along other columns."""

ROUNDING = 1e-12
"""Part of a column's own square that is left at least when the baseline is taken from it."""

AT_ONCE = 2**20
"""Numbers that are held at once or kept for later, as few as fit a processor's memory close by (8 MiB)."""

NOTHING = -1
"""The last hypothesis of every reduced view: no effect."""


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
