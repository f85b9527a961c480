"""The simulated world's gravity and rotation at a place; shares no formula with calib_core."""

from __future__ import annotations

import math

EARTH_RATE = 7.292115e-5
"""Rotation of the Earth, rad/s (WGS 84)."""


def gravity_at(latitude: float, altitude: float) -> float:
    """Return gravity in m/s^2 at a geodetic latitude in degrees and an altitude in m.

    Series form of the 1980 International Gravity Formula (Moritz 2000, "Geodetic Reference System
    1980", J. Geodesy 74, normal gravity series, error below 1 um/s^2) with the second-order height
    correction of Hinze et al. 2005, "New standards for reducing gravity data", Geophysics 70, J25.
    """
    s2 = math.sin(math.radians(latitude)) ** 2
    series = 0.0052790414 * s2 + 0.0000232718 * s2**2 + 0.0000001262 * s2**3 + 0.0000000007 * s2**4
    at_sea = 9.7803267715 * (1.0 + series)
    with_height = (3.087691e-6 - 4.398e-9 * s2) * altitude - 7.2125e-13 * altitude**2
    return at_sea - with_height


def earth_rotation_at(latitude: float) -> tuple[float, float, float]:
    """Return the Earth's rotation in rad/s in east, north, up axes at a latitude in degrees."""
    angle = math.radians(latitude)
    return (0.0, EARTH_RATE * math.cos(angle), EARTH_RATE * math.sin(angle))
