"""How phones lie: the attitudes that supports give them, and poses spread evenly for a laboratory.

An attitude is a matrix (3, 3) from body to world; its third row is where the world's up points in body axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array


@dataclass(frozen=True, slots=True)
class Support:
    """What a phone lies on. lean: angle of the screen's normal from up, rad, drawn from the range.

    roll: direction in the screen's plane that rises when it leans, rad from +y (top edge) towards +x.
    tilt: standard deviation of unevenness (table, camera bump, case), rad about each axis.
    """

    lean: tuple[float, float]
    roll: tuple[float, ...]
    tilt: float


def _degrees(low: float, high: float, rolls: tuple[float, ...], tilt: float) -> Support:
    d = math.radians
    return Support((d(low), d(high)), tuple(d(r) for r in rolls), d(tilt))


SUPPORTS: Mapping[str, Support] = {
    "screen_up": _degrees(0.0, 3.0, (0.0, 180.0), 0.8),
    "screen_down": _degrees(178.0, 180.0, (0.0,), 0.8),
    "leaning": _degrees(50.0, 78.0, (0.0,), 3.0),
    "leaning_upside_down": _degrees(50.0, 78.0, (180.0,), 3.0),
    "stand_landscape": _degrees(55.0, 75.0, (90.0, 270.0), 2.0),
    "face_to_wall": _degrees(105.0, 125.0, (0.0, 90.0, 180.0, 270.0), 3.0),
    "on_long_edge": _degrees(86.0, 94.0, (90.0, 270.0), 4.0),
    "upright": _degrees(75.0, 97.0, (0.0,), 6.0),
    "upside_down": _degrees(80.0, 100.0, (180.0,), 6.0),
    "cushion": _degrees(8.0, 40.0, (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0), 8.0),
    "bag": _degrees(30.0, 150.0, (0.0, 90.0, 180.0, 270.0), 30.0),
}
"""Supports by the names that scenarios use: lean from and to, roll, unevenness, degrees. Assumed."""


def attitude_with(up: Array, heading: float) -> Array:
    """Return the attitude (3, 3) whose up direction in body axes is `up` (3,), turned by a heading in rad."""
    z = up / np.linalg.norm(up)
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    east = np.cross(helper, z)
    east /= np.linalg.norm(east)
    north = np.cross(z, east)
    c, s = math.cos(heading), math.sin(heading)
    return np.array([c * east - s * north, s * east + c * north, z])


def lying(support: Support, rng: np.random.Generator) -> Array:
    """Draw an attitude (3, 3) on a support, with any heading."""
    lean, roll = rng.uniform(*support.lean), support.roll[int(rng.integers(len(support.roll)))]
    up = np.array([math.sin(lean) * math.sin(roll), math.sin(lean) * math.cos(roll), math.cos(lean)])
    up = up + support.tilt * rng.standard_normal(3)
    return attitude_with(up, rng.uniform(-math.pi, math.pi))


def poses(count: int, rng: np.random.Generator) -> list[Array]:
    """Draw `count` attitudes for a calibration by hand: six faces, twelve edges, eight corners, then any.

    Each is off by a few degrees, as a hand is.
    """
    ring = [np.array(v, dtype=float) for v in np.ndindex(3, 3, 3)]
    directions = sorted((v - 1.0 for v in ring if (v != 1.0).any()), key=lambda v: float(v @ v))
    extra = max(0, count - len(directions))
    directions += list(rng.standard_normal((extra, 3)))
    chosen = [d / np.linalg.norm(d) + 0.05 * rng.standard_normal(3) for d in directions[:count]]
    order = rng.permutation(count)
    return [attitude_with(chosen[i], rng.uniform(-math.pi, math.pi)) for i in order]
