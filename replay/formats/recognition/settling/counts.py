"""Raw counts: which of the sensitivities that chips have one count of a table's columns is.

An accelerometer's is told by the size of gravity, a gyroscope's by how far gravity's direction turns. Chips'
sensitivities are a tenth apart and more, and a scale is off by some per cent at most.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.replay.formats.checks.axes import Turning
from stillcal.replay.formats.checks.units import DEGREE

PER_G = (256.0, 2048.0, 4096.0, 8192.0, 16384.0)
"""Counts in g: of 13 bits at 16 g (data sheet of the ADXL345), and of 16 bits at 16 to 2 g (MPU-6050, BMI160;
those of the LSM6DS3 are within 0.1 %). What has about 1000 is in mg."""

PER_DEGREE = tuple(32768.0 / full for full in (125, 250, 500, 1000, 2000)) + tuple(
    1e3 / step for step in (8.75, 17.5, 35.0, 70.0, 140.0)
)
"""Counts in deg/s: of 16 bits at 125 to 2000 deg/s (MPU-6050, BMI160), and by mdeg/s of one count (LSM6DS3,
L3GD20; the ITG-3200's is within 1 % of the fourth)."""

NEAR_FORCE, NEAR_RATE = 0.15, 0.05
"""Relative difference from a sensitivity up to which it is the one: bias and scale of an accelerometer; scale
of a gyroscope, and what turns leave unsure of it."""

EXPLAINED = 0.1
"""Part of what gravity turns that rates of the right unit leave at most, squared."""

LEAST_TURNED = 0.3
"""rad, root of the sum of squares, that gravity has to turn."""


def counts_per_g(norms: Array) -> float | None:
    """Return the sensitivity by which sizes (n,) are gravity's, counts in g; None where none fits."""
    typical = float(np.median(norms)) if norms.size else 0.0
    return _nearest(typical, PER_G, NEAR_FORCE)


def counts_per_degree(spans: Iterable[Turning]) -> float | None:
    """Return how many counts are 1 deg/s, by spans whose rates are in counts; None where it is not clear."""
    squares = sum((span.squares for span in spans), np.zeros((2, 2)))
    if squares[0, 0] < LEAST_TURNED**2 or squares[1, 1] <= 0.0:
        return None
    # The factor k from counts to rad/s that leaves least of [1, k] squares [1, k].
    k = -squares[0, 1] / squares[1, 1]
    left = squares[0, 0] - squares[0, 1] ** 2 / squares[1, 1]
    if left > EXPLAINED * squares[0, 0]:
        return None
    return _nearest(DEGREE / k, PER_DEGREE, NEAR_RATE)


def _nearest(value: float, known: Iterable[float], within: float) -> float | None:
    best = min(known, key=lambda one: abs(value / one - 1.0))
    return best if abs(value / best - 1.0) < within else None
