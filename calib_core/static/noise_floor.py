"""The noise floor: how little a sensor scatters when nothing moves it, learnt and forgotten.

The paper keeps running minima: one freak quiet window and nothing is ever still again, none seen yet and
walking passes. Here the spreads of all windows go into a logarithmic histogram with forgetting, one per
octave of sampling rate (noise grows with bandwidth), and the floor is its lowest well-populated cluster.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.static.settings import DetectorSettings

Index = NDArray[np.intp]

_PER_OCTAVE = 4
_LOWEST = -18  # log2 of the lowest spread told apart: 4e-6 m/s^2 or rad/s
_BINS = 24 * _PER_OCTAVE
_RATES = 9  # octaves of sampling rate, from 2-4 Hz to 512 Hz and above


def _no_counts() -> Array:
    return frozen(np.zeros((_RATES, _BINS)))


def _no_floors() -> Array:
    return frozen(np.full(_RATES, np.inf))


@dataclass(slots=True)
class Floor:
    """One sensor's floor. past: decayed counts; fresh: counts not used yet; level: (rates,), inf unknown."""

    past: Array = field(default_factory=_no_counts)
    fresh: Array = field(default_factory=_no_counts)
    level: Array = field(default_factory=_no_floors)


def rate_class(rate: Array) -> Index:
    """Octave of the sampling rate (Hz) that a window belongs to, as an index."""
    octave: Index = (np.log2(np.maximum(rate, 1.0)) - 1.0).astype(np.intp)
    return octave.clip(0, _RATES - 1)


def counted(floor: Floor, classes: Index, spreads: Array) -> Floor:
    """Add windows' spreads to the counts; the level stays until `renewed`. Spreads of 0 do not count."""
    seen = spreads > 0
    if not seen.any():
        return floor
    octave = np.log2(spreads[seen]) - _LOWEST
    bins = np.clip(np.floor(octave * _PER_OCTAVE), 0, _BINS - 1).astype(np.intp)
    flat = np.bincount(classes[seen] * _BINS + bins, minlength=_RATES * _BINS)
    return Floor(floor.past, frozen(floor.fresh + flat.reshape(_RATES, _BINS)), floor.level)


def renewed(floor: Floor, settings: DetectorSettings) -> Floor:
    """Let the fresh counts in, forget by as many windows as came, and find the levels again."""
    if not floor.fresh.any():
        return floor
    came = floor.fresh.sum(axis=1, keepdims=True)
    keep = 0.5 ** (came * settings.window_s / settings.half_life_s)
    past = floor.past * keep + floor.fresh
    level = floor.level.copy()
    for i in np.flatnonzero(came[:, 0]):
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
