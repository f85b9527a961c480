"""How a bias wanders: flicker, a bank of Gauss-Markov processes, and a random walk."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stillcal.calib_core.arrays import Array

FLICKER_TAUS_S = (30.0, 240.0, 1920.0, 15360.0, 122880.0)
"""Correlation times of the flicker's bank, s."""


@dataclass(frozen=True, slots=True)
class Wander:
    """How a bias wanders. white: of single rests; flicker: of each process of the bank; walk: per sqrt(s).

    declared: the share of a rest's own stated uncertainty that it has. Rests state theirs on the safe side,
    and what they overstate would be taken off the flicker.
    """

    white: float
    flicker: float
    walk: float
    declared: float = 1.0

    def covariance(self, t: Array, other: Array) -> Array:
        """Return the covariance of the wander at times (n,) and (m,), s: (n, m); it begins at t = 0."""
        apart = np.abs(t[:, None] - other)
        return self.flicker**2 * _flicker(apart) + self.walk**2 * np.minimum(t[:, None], other)

    def over(self, spans: Spans) -> Array:
        """Return the covariance of the wander at the times of rests: (n, n)."""
        return self.flicker**2 * spans.flicker_since + self.walk**2 * spans.walk

    def growth(self, age_s: float) -> float:
        """Return the variance by which the bias changes within a time, s."""
        apart = np.array(max(age_s, 0.0))
        gone = len(FLICKER_TAUS_S) - float(_flicker(apart))
        return 2.0 * self.flicker**2 * gone + self.walk**2 * float(apart)


def _flicker(apart: Array) -> Array:
    """Return the covariance of a flicker of size 1 at two times that are `apart` (any shape), s."""
    total = np.zeros(np.shape(apart))
    for tau in FLICKER_TAUS_S:  # one after the other, for little memory
        total += np.exp(-apart / tau)
    return total


class Spans:
    """What a regression needs of the times of rests alone: t (n,) s, oldest first.

    A check fits the same rests some twenty times, so that each is made once, where it is first asked for.
    """

    def __init__(self, t: Array) -> None:
        self.since = t - float(t[0]) if t.size else t
        self._t = t

    @cached_property
    def flicker(self) -> Array:
        """The covariance (n, n) of a flicker of size 1."""
        return _flicker(np.abs(self._t[:, None] - self._t))

    @cached_property
    def flicker_since(self) -> Array:
        """The same by times that count from the first rest, rounded otherwise."""
        return _flicker(np.abs(self.since[:, None] - self.since))

    @cached_property
    def walk(self) -> Array:
        """The covariance (n, n) of a walk of size 1 that begins at the first rest."""
        return np.minimum(self.since[:, None], self.since)
