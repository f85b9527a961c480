"""What findings of lines have in common: of which kind they are, and at which frequency."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.records import Finding

TONE = "vibration_tone"
"""Name of a line that is steady."""

COMES_AND_GOES = "a vibration that comes and goes"
WANDERS = "a vibration whose frequency wanders"
"""Drivers of lines that have no name: a steady sine in their place would be no correction."""


def is_line(found: Finding) -> bool:
    """Whether a finding is of a line in the spectrum, steady or not."""
    return found.effect == TONE or found.where.driver in (COMES_AND_GOES, WANDERS)


def amplitude_of(power: Array, spread: Array) -> tuple[Array, Array]:
    """Return amplitudes and their standard errors of squared ones and theirs; each (3,)."""
    amplitude = np.sqrt(np.maximum(power, 0.0))
    return amplitude, np.minimum(spread / np.maximum(2.0 * amplitude, 1e-12), np.sqrt(spread))


def middle_hz(line: Finding) -> float:
    """Return the frequency of a line, Hz; the middle one of a line that wanders."""
    return float(np.asarray(line.parameters["frequency"].value))


def reach_hz(line: Finding) -> float:
    """Return how far on either side a line wanders, Hz; 0 for one that does not."""
    low, high = line.where.band_hz
    return (high - low) / 2.0 if line.where.driver == WANDERS else 0.0
