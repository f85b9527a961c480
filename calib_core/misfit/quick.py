"""Findings that single samples and stamps give directly: a shared way to state them.

These effects have a measured number, its standard error from independent pieces, and a tolerance below which
the twin already allows for it. They are found where the number is outside its tolerance by many errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.misfit.catalogue.entry import AXES
from stillcal.calib_core.misfit.records import Evidence, Finding, Parameter, Where
from stillcal.calib_core.samples import Array

SIGNIFICANT = 5.0
"""Standard errors that a direct measurement must be from its tolerance: 6e-7 two-sided, for some 40 tests."""


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

    return float(erfc(sigmas / np.sqrt(2.0)))


def direct_finding(
    effect: str,
    sensor: str,
    axes: list[int],
    where: Where,
    parameters: dict[str, Parameter],
    *,
    statement: str,
    sigmas: float,
    rmse: tuple[float, float] = (float("nan"), float("nan")),
) -> Finding:
    """Build a finding of a direct measurement. sigmas: how far outside its tolerance it is."""
    bounded = min(sigmas, 30.0)
    before, after = (0.0 if np.isnan(x) else x for x in rmse)
    evidence = Evidence(tail(bounded), before, after, bounded**2 / 2.0, 0)
    return Finding(effect, sensor, [AXES[a] for a in axes], where, parameters, evidence, [], statement)
