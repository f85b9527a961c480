"""Tables of very many rests: rests that lie alike and follow one another are merged into one bin.

The slow diagnosis holds covariances of all bins with each other, so its memory grows with their square and
its work with their cube. A merged bin is as well known as its rests together. What is lost is what changes
between the rests of one bin.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.segments.rests.rest_edges import MOST_BINS, Index
from stillcal.calib_core.diagnosis.segments.static_bins import Bins

ALIKE = 0.02
"""rad between two rests that may be merged. Across such an angle the norm of a sensor with 2 % of scale error
departs from a straight line by 2 % * 0.02^2 / 2 of gravity, 4e-5 m/s^2: less than a table's least
uncertainty."""

MOST_ATTITUDES = 150
"""Attitudes that are looked for, the most frequent ones first: half of `MOST_BINS`, so that rests in each can
still be told apart by time."""

APART = 1e-3
"""s between two bins: rests of two attitudes may have the same mean time, and courses are differentiated."""


def merged(bins: Bins, most: int = MOST_BINS) -> Bins:
    """Return at most `most` bins: rests of one attitude and one part of the time are merged.

    bins: one a rest, with the columns that a table has. Up to `most` of them are returned as they are. Where
    attitudes are too many to merge, some rests are left out: of neighbours in time, those of the rarer
    attitudes.
    """
    if len(bins) <= most:
        return bins
    order = np.argsort(bins.t, kind="stable")
    attitude = _attitudes(bins.force)
    part = np.empty(len(bins), dtype=np.int64)
    part[order] = np.arange(len(bins))
    group = _grouped(attitude, part, most)
    return _means(bins, _most_frequent(group, part, most))


def _attitudes(force: Array) -> Index:
    """Return the attitude (n,) of each force (n, 3); one that is like no frequent one has its own number."""
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    cells, counts = np.unique(np.rint(up / ALIKE), axis=0, return_counts=True)
    found = np.full(len(up), -1, dtype=np.int64)
    for number, k in enumerate(np.argsort(-counts, kind="stable")[:MOST_ATTITUDES]):
        near = (found < 0) & (np.linalg.norm(up - cells[k] * ALIKE, axis=1) < ALIKE)
        found[near] = number
    alone = np.flatnonzero(found < 0)
    found[alone] = MOST_ATTITUDES + np.arange(alone.size)
    return found


def _grouped(attitude: Index, place: Index, most: int) -> Index:
    """Return the group (n,) of each rest: its attitude within the finest parts of time that give `most`.

    place: (n,), which in time each rest is.
    """
    n = attitude.size
    low, high = 1, most  # with one part there may be more than `most` groups
    while low < high:
        parts = (low + high + 1) // 2
        if np.unique(attitude * most + place * parts // n).size <= most:
            low = parts
        else:
            high = parts - 1
    return np.asarray(np.unique(attitude * most + place * low // n, return_inverse=True)[1], dtype=np.int64)


def _most_frequent(group: Index, place: Index, most: int) -> Index:
    """Return the group (n,) of each rest, -1 for those left out: of neighbours in time the smaller ones."""
    size = np.bincount(group)
    if size.size <= most:
        return group
    middle = np.bincount(group, weights=place.astype(np.float64)) / size
    parts = np.array_split(np.argsort(middle, kind="stable"), most)
    number = np.full(size.size, -1, dtype=np.int64)
    for i, members in enumerate(parts):
        number[members[np.argmax(size[members])]] = i
    return number[group]


def _means(bins: Bins, group: Index) -> Bins:
    """Return one bin a group, in time order, its rests weighed by how well each is known.

    A bin is as long as one of its rests: noise that wanders is not taken to average out between them.
    """
    kept = bins.chosen(group >= 0)
    at = np.unique(group[group >= 0], return_inverse=True)[1]
    weight = 1.0 / kept.force_variance.mean(axis=1)
    total = np.bincount(at, weights=weight)
    first = np.argsort(np.bincount(at, weights=weight * kept.t) / total, kind="stable")

    def mean(values: Array) -> Array:
        """Return weighted means (m,) or (m, k) of values (n,) or (n, k)."""
        columns = values.reshape(len(values), -1).T
        means = np.stack([np.bincount(at, weights=weight * c) / total for c in columns], axis=1)
        return np.asarray(means[first].reshape(-1, *values.shape[1:]))

    def variance(values: Array) -> Array:
        """Return the variances (m, 3) of these means of values with variances (n, 3)."""
        own = [np.bincount(at, weights=weight**2 * c) / total**2 for c in values.T]
        return np.asarray(np.stack(own, axis=1)[first])

    norm = mean(np.linalg.norm(kept.force, axis=1))
    force = mean(kept.force)
    return replace(
        kept,
        t=rising(mean(kept.t)),
        duration=mean(kept.duration),
        rest=np.arange(total.size),
        # The mean of directions that differ is short: its length is the mean of the lengths.
        force=force * (norm / np.linalg.norm(force, axis=1))[:, None],
        force_variance=variance(kept.force_variance),
        vibration=mean(kept.vibration),
        rate=None if kept.rate is None else mean(kept.rate),
        rate_variance=None if kept.rate_variance is None else variance(kept.rate_variance),
        temperature=None if kept.temperature is None else mean(kept.temperature),
    )


def rising(t: Array) -> Array:
    """Return times (m,) s, none of them earlier than `APART` after the one before."""
    steps = APART * np.arange(t.size)
    return np.asarray(np.maximum.accumulate(t - steps) + steps)
