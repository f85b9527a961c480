"""What numbers from outside may be: wider than any phone's, narrow enough to calculate with.

A stamp, a reading or a place beyond these is a fault of whoever sent it. Within them no square, no sum of
squares and no difference of stamps overflows, and a stamp still resolves 2 microseconds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array

STAMP_S = 1e10
"""Largest stamp either way, s: 317 years. A 64-bit counter of nanoseconds ends at 9.2e9 s."""

READING = 1e9
"""Largest reading of a sensor either way, m/s^2 or rad/s: far beyond any sensor, its eighth power finite."""

TEMPERATURE_C = (-273.15, 1000.0)

RANGES: dict[str, tuple[float, float]] = {
    "t": (-STAMP_S, STAMP_S),
    "until": (-STAMP_S, math.inf),
    "celsius": TEMPERATURE_C,
    "latitude": (-90.0, 90.0),
    "longitude": (-360.0, 360.0),
    "altitude": (-12_000.0, 1e6),
    "on_time": (0.0, STAMP_S),
    "wakeups": (0.0, 2.0**32 - 1.0),
    "hz": (0.0, 1e6),
}
"""Lowest and highest value of each field of an event or a message that is a number, by its name. SI."""


def within(name: str, value: float) -> bool:
    """Say whether a number may stand in the field of this name; NaN may not."""
    low, high = RANGES[name]
    return low <= value <= high


def check_ranges(fields: Mapping[str, Any]) -> None:
    """Raise ValueError for the first number that may not stand in its field; None stands for none."""
    for name, value in fields.items():
        if name in RANGES and value is not None and not within(name, value):
            raise ValueError(f"{name} = {value!r} is out of range")


def usable(t: Array, xyz: Array) -> NDArray[np.bool_]:
    """Say which rows of t (n,) in s and xyz (n, 3) in SI units can be used: finite and within limits."""
    stamps: NDArray[np.bool_] = np.abs(t) <= STAMP_S
    return stamps & (np.abs(xyz) <= READING).all(axis=1)


def plausible_temperature(celsius: Array) -> NDArray[np.bool_]:
    """Say which of these temperatures (n,), degC, can be one."""
    low, high = TEMPERATURE_C
    return (celsius >= low) & (celsius <= high)
