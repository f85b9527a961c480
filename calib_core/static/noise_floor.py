"""The noise floor: the scatter of a sensor when nothing moves it, learnt while the detector runs.

The paper keeps running minima. With these, one freak quiet window makes every later window count as moving,
and before a quiet window was seen even walking counts as still. Here the standard deviations of all windows
go into a logarithmic histogram with forgetting, one for each octave of sampling rate (noise grows with
bandwidth), and the floor is the lowest cluster that holds enough windows.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.static.settings import DetectorSettings

Index = NDArray[np.intp]

_PER_OCTAVE = 4
"""Bins an octave: 19 % wide, as the spread of a window of 8 samples on three axes is uncertain by 15 %."""

_LOWEST = -18
"""log2 of the lowest spread told apart: 4e-6 m/s^2 or rad/s, far below any phone sensor's noise."""

_BINS = 24 * _PER_OCTAVE
"""Up to 2^6 = 64 m/s^2 or rad/s, beyond what any detector setting calls still."""

_RATES = 9
"""Octaves of sampling rate, from 2-4 Hz to 512 Hz and above."""


def _no_counts() -> Array:
    return frozen(np.zeros((_RATES, _BINS)))


def _no_floors() -> Array:
    return frozen(np.full(_RATES, np.inf))


@dataclass(slots=True)
class Floor:
    """One sensor's noise floor.

    past: (rates, bins) decayed counts. fresh: (rates, bins) counts not used yet. level: (rates,) the floor in
    m/s^2 or rad/s, inf where unknown.
    """

    past: Array = field(default_factory=_no_counts)
    fresh: Array = field(default_factory=_no_counts)
    level: Array = field(default_factory=_no_floors)


def rate_class(rate: Array) -> Index:
    """Return the octave of sampling rates (Hz), (n,), as an index."""
    octave: Index = (np.log2(np.maximum(rate, 1.0)) - 1.0).astype(np.intp)
    return octave.clip(0, _RATES - 1)


@lru_cache(maxsize=1024)
def octave_of(rate: float) -> int:
    """Return the octave of one sampling rate, Hz; rests are looked at again and again."""
    return int(rate_class(np.array([rate]))[0])


def counted(floor: Floor, classes: Index, spreads: Array) -> Floor:
    """Count spreads by octave of rate; the level stays until `renewed`. Spreads of 0 do not count."""
    positive = spreads > 0
    if not positive.any():
        return floor
    octave = np.log2(spreads[positive]) - _LOWEST
    bins = np.clip(np.floor(octave * _PER_OCTAVE), 0, _BINS - 1).astype(np.intp)
    flat = np.bincount(classes[positive] * _BINS + bins, minlength=_RATES * _BINS)
    return Floor(floor.past, frozen(floor.fresh + flat.reshape(_RATES, _BINS)), floor.level)


def renewed(floor: Floor, settings: DetectorSettings) -> Floor:
    """Add the fresh counts to the past ones, which decay by as many windows, and find the levels again."""
    if not floor.fresh.any():
        return floor
    n_fresh = floor.fresh.sum(axis=1, keepdims=True)
    decay = 0.5 ** (n_fresh * settings.window_s / settings.half_life_s)
    past = floor.past * decay + floor.fresh
    level = floor.level.copy()
    for i in np.flatnonzero(n_fresh[:, 0]):
        level[i] = lowest_cluster(past[i], settings)
    return Floor(frozen(past), _no_counts(), frozen(level))


def lowest_cluster(counts: Array, settings: DetectorSettings) -> float:
    """Return the centre of the lowest octave that holds enough windows, or inf where none does."""
    enough = max(settings.cluster_windows, settings.cluster_share * counts.sum())
    running = np.concatenate(([0.0], np.cumsum(counts)))
    octave = running[_PER_OCTAVE:] - running[:-_PER_OCTAVE]
    full = np.flatnonzero(octave >= enough)
    if full.size == 0:
        return np.inf
    reach = slice(full[0], full[0] + 2 * _PER_OCTAVE - 1)
    peak = int(full[0]) + int(np.argmax(counts[reach]))
    near = np.arange(max(peak - 2, 0), min(peak + 3, _BINS))
    centre = (counts[near] * (near + 0.5)).sum() / counts[near].sum()
    return float(2.0 ** (centre / _PER_OCTAVE + _LOWEST))
