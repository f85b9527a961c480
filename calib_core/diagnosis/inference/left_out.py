"""Held-out evidence for what is measured directly: pieces of the recording predicted from the other pieces.

The pieces (rests, stretches, turns, parts of the stamps) are cut into `FOLDS` blocks in their order. A
hypothesis is fitted to four blocks, its scatter included, and predicts the fifth; without the effect the
scatter is fitted too, about the nearest that a sound phone may show. Of shares of samples many pieces are
dealt out: what lasts for some of them, and then no more, is in all folds, and what comes once is in one.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import FOLDS, HeldOut, Index
from stillcal.calib_core.maths.rms import rms

SHARE_PIECES = 400
"""Pieces that a share of samples is counted in: what lasts for 1 % of a recording is in four of them."""


LEAST = 1e-15
"""Spread that values have at least: stamps of whole milliseconds may be even to the last digit."""


def blocks(n: int) -> Index:
    """Return the fold (n,) of each of n pieces in their order."""
    return np.minimum(np.arange(n) * FOLDS // max(n, 1), FOLDS - 1).astype(np.int64)


def dealt(n: int) -> Index:
    """Return the fold (n,) of each of n pieces, dealt out by a fixed shuffle: in step with no period."""
    return np.asarray(np.random.default_rng(0).permutation(n) % FOLDS, dtype=np.int64)


def of_means(pieces: Array, sound: Array) -> HeldOut:
    """Predict pieces (n,) or (n, k) normally about the others' mean, and about `sound` (k,) or a number."""
    pieces = pieces.reshape(len(pieces), -1)
    fold, gain = blocks(len(pieces)), 0.0
    before, after = np.zeros_like(pieces), np.zeros_like(pieces)
    for k in np.unique(fold):
        train, test = pieces[fold != k], pieces[fold == k]
        if len(train) < 2:
            continue
        mean = train.mean(axis=0)
        gain += _normal(train, test, mean) - _normal(train, test, sound)
        before[fold == k], after[fold == k] = test - sound, test - mean
    return HeldOut(gain, rms(before), rms(after))


def _normal(train: Array, test: Array, about: Array) -> float:
    variance = ((train - about) ** 2).mean(axis=0) + 1e-30
    return float(-0.5 * (((test - about) ** 2 / variance) + np.log(variance)).sum())


def of_spread(values: Array, sound: float) -> HeldOut:
    """Predict the spread of zero-mean values (n,) from the others', against a spread of at most `sound`."""
    fold, gain, before, after = blocks(values.size), 0.0, [], []
    for k in np.unique(fold):
        test = values[fold == k]
        own = max(rms(values[fold != k]), LEAST)
        null, power = min(own, sound), float((test**2).sum())
        gain += test.size * np.log(null / own) + 0.5 * power * (1.0 / null**2 - 1.0 / own**2)
        seen = float(np.sqrt(power / test.size))
        before.append(seen - null)
        after.append(seen - own)
    return HeldOut(gain, rms(np.array(before)), rms(np.array(after)))


def of_shares(hits: Array, of: Array, sound: float) -> HeldOut:
    """Predict hits (n,) among `of` (n,) by their share in the others, against a share of at most `sound`."""
    fold, gain = dealt(hits.size), 0.0
    before, after = np.zeros(hits.size), np.zeros(hits.size)
    for k in np.unique(fold):
        test = fold == k
        share = float((hits[~test].sum() + 0.5) / (of[~test].sum() + 1.0))
        null = min(share, sound)
        yes, no = float(hits[test].sum()), float((of - hits)[test].sum())
        gain += yes * np.log(share / null) + no * np.log((1.0 - share) / (1.0 - null))
        rate = hits[test] / np.maximum(of[test], 1.0)
        before[test], after[test] = rate - null, rate - share
    return HeldOut(gain, rms(before), rms(after))
