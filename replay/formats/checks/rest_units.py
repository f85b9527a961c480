"""Checks whether a rest table can be in m/s^2 and rad/s: by gravity, and by the Earth's rotation.

Nothing turns in a table of rests, so the unit of rates cannot follow from how gravity turns. A gyroscope at
rest shows its bias and the Earth's rotation. In deg/s that is 0.0042, the same part of it along gravity at
every rest; in rad/s it is 57 times smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.daemon.system.files import short_name
from stillcal.replay.formats.checks.units import multiples_of
from stillcal.replay.formats.errors import TraceError

_OTHER_FORCE = 'give m/s^2 with gravity in it, or say the unit in the names of the columns, as "ax [g]"'
_OTHER_RATE = 'say the unit in the names of the columns, as "gx [deg/s]" or "gx [rad/s]"'

_GRAVITY = (4.0, 16.0)
"""m/s^2: the median size of the means, with room for bias and scale."""

_TEMPERATURE = (-100.0, 200.0)
"""degC: no sensor works beyond."""

_LARGEST_BIAS = 0.5
"""rad/s, 29 deg/s: no gyroscope that calibrates has a larger bias; most read 0.1 to 5 deg/s at rest."""

_EARTH = 7.2921e-5 * 180.0 / np.pi
"""The Earth's rotation, deg/s."""

_FEWEST = 12
"""Rests that show it."""

_CLEARLY = 6.0
"""Standard errors of the part of the Earth's rotation along gravity."""

_MORE = 8
"""By so many numbers a matrix is more than one part along gravity, the same on all axes."""

_ALIKE = 2.5
"""F of these numbers that noise exceeds in one of a hundred tables."""

_NOT_MORE = 1.2
"""The part along gravity is at most the whole rotation, and its error."""

_LEAST_ACROSS, _MOST_ACROSS = 0.7, 4.0
"""What is left varies by the part across gravity at least, and noise does not bury it."""


def judge_forces(path: Path, force: Array) -> None:
    """Raise TraceError where mean forces (n, 3) cannot be m/s^2."""
    size = np.linalg.norm(force, axis=1)
    middle = float(np.median(size))
    if not force.any():
        raise TraceError(path, "all rests read zero", "give the means in ax, ay, az")
    if unit := multiples_of(size):
        raise TraceError(path, f"the forces seem to be in {unit}", _OTHER_FORCE)
    if not _GRAVITY[0] < middle < _GRAVITY[1]:
        what = f"the forces are about {middle:.4g} in size where m/s^2 would give 9.8"
        raise TraceError(path, what, _OTHER_FORCE)


def judge_temperatures(path: Path, celsius: Array, lines: Sequence[int]) -> None:
    """Raise TraceError where a temperature (n,), NaN where there is none, cannot be a sensor's in degC."""
    wrong = np.flatnonzero((celsius < _TEMPERATURE[0]) | (celsius > _TEMPERATURE[1]))
    if wrong.size:
        what = f"{celsius[wrong[0]]:.4g} degC is no temperature of a sensor"
        remedy = (
            'leave the cell empty where it is not known, or name the column "temperature [K]" if it is in K'
        )
        raise TraceError(path, what, remedy, int(lines[wrong[0]]))


def judge_rates(path: Path, force: Array, rate: Array) -> list[str]:
    """Return what is to be said of mean rates (n, 3) that are taken as rad/s; force: (n, 3).

    Raises TraceError where they cannot be rad/s.
    """
    size = float(np.median(np.linalg.norm(rate, axis=1)))
    if size > _LARGEST_BIAS:
        what = f"the rates at rest are about {size:.2g}: no gyroscope's bias in rad/s, but one's in deg/s"
        raise TraceError(path, what, _OTHER_RATE)
    if _hold_the_earth(force, rate):
        what = "the rates seem to be in deg/s: they hold the Earth's rotation, 0.0042 deg/s"
        raise TraceError(path, what, _OTHER_RATE)
    scatter = float(np.sqrt(np.mean(np.sum((rate - rate.mean(axis=0)) ** 2, axis=1))))
    if scatter < _EARTH / 2.0:
        return []
    say = f"the rates are taken as rad/s and differ by {scatter:.2g} from rest to rest"
    return [f"{short_name(path)}: {say}; if they are deg/s, name them gx [deg/s], gy [deg/s], gz [deg/s]"]


def _hold_the_earth(force: Array, rate: Array) -> bool:
    """Whether rates hold the Earth's rotation in deg/s: a part along gravity, and the rest across at random.

    Headings are not known. What a force adds to a rate by g-sensitivity is not the same on all axes.
    """
    n, up = len(rate), force / np.linalg.norm(force, axis=1, keepdims=True)
    if n < _FEWEST:
        return False
    off, about = rate - rate.mean(axis=0), up - up.mean(axis=0)
    spread = float(np.sum(about**2))
    along = float(np.sum(about * off)) / spread if spread else 0.0
    left = float(np.sum((off - along * about) ** 2))
    by_matrix = off - about @ np.linalg.lstsq(about, off, rcond=None)[0]
    gain = (left - float(np.sum(by_matrix**2))) / _MORE
    noise = float(np.sum(by_matrix**2)) / (3 * n - 3 - 9)
    across = np.sqrt(max(_EARTH**2 - along**2, 0.0))
    error = np.sqrt(left / (3 * n - 4) / spread) if spread else np.inf
    alike = gain < _ALIKE * noise
    return bool(
        _CLEARLY * error < abs(along) < _NOT_MORE * _EARTH
        and alike
        and _LEAST_ACROSS * across < np.sqrt(left / n) < _MOST_ACROSS * _EARTH
    )
