"""Findings that single samples and stamps give directly: a shared way to state them.

These effects have a measured number, its standard error from independent pieces, and a tolerance below which
the twin already allows for it. They are found where the number is outside its tolerance by many errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.records import (
    AXES,
    Alternative,
    Evidence,
    Finding,
    Number,
    Parameter,
    Where,
)

Index = NDArray[np.int64]

SIGNIFICANT = 5.0
"""Standard errors that a direct measurement must be from its tolerance: 6e-7 two-sided."""

TRIALS = 80
"""How many direct measurements a diagnosis makes: two sensors, three axes, some dozen effects."""

FOLDS = 5


@dataclass(frozen=True, slots=True)
class Measured:
    """A number with its standard error."""

    value: float
    error: float

    def beyond(self, low: float, high: float) -> float:
        """Return by how many standard errors the value is outside [low, high]; 0 inside."""
        excess = max(self.value - high, low - self.value, 0.0)
        return excess / max(self.error, 1e-300)

    def parameter(self, unit: str) -> Parameter:
        """Return value and 95 % interval."""
        return Parameter(self.value, [self.value - 1.96 * self.error, self.value + 1.96 * self.error], unit)


def mean_of(pieces: Array, floor: float = 0.0) -> Measured:
    """Robust mean of independent pieces (n,) with a standard error from their scatter, `floor` at least."""
    middle = float(np.median(pieces))
    scatter = 1.4826 * float(np.median(np.abs(pieces - middle)))
    keep = np.abs(pieces - middle) <= 4.0 * scatter + 1e-300
    kept = pieces[keep] if keep.sum() >= 3 else pieces
    error = float(kept.std(ddof=1)) / np.sqrt(kept.size) if kept.size > 1 else float("inf")
    return Measured(float(kept.mean()), max(error, floor))


def tail(sigmas: float) -> float:
    """Return the two-sided normal probability of a deviation."""
    from scipy.special import erfc  # noqa: PLC0415 - the daemon stays light

    return float(erfc(min(sigmas, 30.0) / np.sqrt(2.0)))


def vector(values: Array, errors: Array, unit: str) -> Parameter:
    """Return values (k,) with 95 % intervals."""
    ci = np.stack([values - 1.96 * errors, values + 1.96 * errors], axis=1)
    return Parameter(values.tolist(), ci.tolist(), unit)


@dataclass(frozen=True, slots=True)
class Seen:
    """What speaks for a direct finding.

    sigmas: standard errors outside its tolerance. gain: log score of pieces left out, with the effect less
    without it, nats; before, after: rms of what is left there, in the unit of what is predicted.
    """

    sigmas: float
    gain: float
    before: float
    after: float


def direct_finding(
    effect: str,
    sensor: str,
    axes: Sequence[int],
    where: Where,
    parameters: dict[str, Parameter],
    *,
    statement: str,
    seen: Seen,
    alternatives: Sequence[Alternative] = (),
) -> Finding:
    """Build a finding of a direct measurement."""
    evidence = Evidence(min(1.0, TRIALS * tail(seen.sigmas)), seen.before, seen.after, seen.gain, FOLDS)
    names = [AXES[a] for a in axes]
    return Finding(effect, sensor, names, where, parameters, evidence, list(alternatives), statement)


def unknown(
    sensor: str,
    axes: Sequence[int],
    where: Where,
    sizes: Mapping[str, tuple[Number, str]],
    *,
    statement: str,
    seen: Seen,
) -> Finding:
    """Build a finding that the catalogue has no name for. sizes: numbers, with units, that say how large."""
    parameters = {
        name: Parameter(value, np.stack([value, value], axis=-1).tolist(), unit)
        for name, (value, unit) in sizes.items()
    }
    return direct_finding("unknown", sensor, axes, where, parameters, statement=statement, seen=seen)
