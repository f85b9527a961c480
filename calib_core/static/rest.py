"""A rest of the phone, and the grouping of rests by attitude.

A `RestState` is the result of the static detector: the means over a span of time in which the phone lay
still, with their uncertainties. Grammenos et al. 2018, 4.4, store the means only; the uncertainty is the
rest's weight in every later fit.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array

ATTITUDE_ANGLE = 0.0872665
"""rad, 5 degrees: rests within this angle share an attitude. A phone laid down again in the same way comes
back to within a few degrees, and attitudes this close tell a fit no more than one of them."""


class RestState(msgspec.Struct, frozen=True, eq=False, rename={"undetected_rotation_bound": "spin_admitted"}):
    """One rest. Forces are raw m/s^2, rates raw rad/s, times s of the sensor's own stamp.

    specific_force, force_sd, force_uncertainty: (3,) mean, standard deviation of single samples, and
    standard uncertainty of the mean, with coloured noise and repeated samples allowed for. rate, rate_sd,
    rate_uncertainty: the same for the gyroscope, None without one. level: standard deviation of the force's
    norm (Algorithm 1, line 15), m/s^2. rate_level: standard deviation of the rate (line 16), rad/s, None
    without gyroscope. tilt_rate_limit: rad/s, the fastest rotation about a horizontal axis that the direction
    of gravity would not have shown. undetected_rotation_bound: rad/s, the rotation about the vertical that
    this rest alone cannot tell from gyroscope bias, None where nothing bounds it; saved states call it
    spin_admitted. temperature: degC or None. lagged: (k,) degC, temperatures of sensors that follow the
    thermometer late (temperature/thermometer.py), NaN where unknown; None where nothing is known. charged:
    (1 + k,) K, the same of the charger, which stands in for a thermometer (temperature/charger.py).
    """

    t_start: float
    t_end: float
    n: int
    specific_force: Array
    force_sd: Array
    force_uncertainty: Array
    level: float
    rate: Array | None = None
    rate_sd: Array | None = None
    rate_uncertainty: Array | None = None
    rate_level: float | None = None
    tilt_rate_limit: float | None = None
    undetected_rotation_bound: float | None = None
    temperature: float | None = None
    lagged: Array | None = None
    charged: Array | None = None

    @property
    def duration(self) -> float:
        """Length of the rest in s; 0 for a row of a rest table that does not say."""
        return self.t_end - self.t_start


def forces(rests: Sequence[RestState]) -> Array:
    """Stack the mean raw specific forces, shape (n, 3), m/s^2."""
    return np.array([r.specific_force for r in rests], dtype=np.float64).reshape(-1, 3)


def force_uncertainties(rests: Sequence[RestState]) -> Array:
    """Stack the standard uncertainties of the means, shape (n, 3), m/s^2."""
    return np.array([r.force_uncertainty for r in rests], dtype=np.float64).reshape(-1, 3)


def directions(forces: Array) -> Array:
    """Return the unit vectors of forces (n, 3)."""
    return np.asarray(forces / np.maximum(np.linalg.norm(forces, axis=1, keepdims=True), 1e-12))


def attitude_labels(raw: Array, angle: float) -> NDArray[np.intp]:
    """Return the number (n,) of each raw force's (n, 3) attitude, from 0 in order of appearance.

    A force belongs to the first attitude whose first member's direction is within `angle` (rad) of its own.
    """
    unit = directions(raw)
    labels, taken = np.full(len(unit), -1, dtype=np.intp), np.zeros(len(unit), dtype=bool)
    nearest, number = np.cos(angle), 0
    for first in range(len(unit)):
        if taken[first]:
            continue
        near = (unit @ unit[first] >= nearest) > taken
        near[first] = True
        labels[near] = number
        taken |= near
        number += 1
    return labels


def group_attitudes(rests: Sequence[RestState], angle: float) -> list[list[int]]:
    """Group rests whose raw gravity directions lie within `angle` (rad) of the group's first rest.

    "Nearby states are merged" (Grammenos et al. 2018, 4.4), so that one attitude held twice counts
    once. Groups keep the order of their first rest; indices point into `rests`.
    """
    labels = attitude_labels(forces(rests), angle)
    groups: list[list[int]] = [[] for _ in range(int(labels.max(initial=-1)) + 1)]
    for row, label in enumerate(labels.tolist()):
        groups[label].append(row)
    return groups
