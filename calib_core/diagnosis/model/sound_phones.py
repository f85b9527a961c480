"""What sound phones commonly show: the population that a measured number is held against.

`sound_phones.toml` holds, quantity by quantity, either the numbers of real devices, one each, or a range that
a standard or a datasheet gives, with the source. The first kind is made anew from recordings by
`python -m stillcal.replay.real_data.sound_phones --learn`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from stillcal.calib_core.arrays import Array

WIDTHS = np.geomspace(0.02, 1.0, 30)
"""Widths of a kernel that are tried, in standard deviations of the population."""


@dataclass(frozen=True, slots=True, eq=False)
class Usual:
    """One quantity among sound phones.

    devices: (n,) sorted numbers of real devices, of none where `between` (low, high) is stated instead.
    faulty: (low, high), the range in which a fault puts it; where it reaches below the usual numbers too, a
    fault may make it too small. source: where the numbers come from. width: of the normal kernel that stands
    for each device.
    """

    devices: Array
    between: tuple[float, float]
    faulty: tuple[float, float]
    source: str
    width: float = 0.0

    @classmethod
    def of(cls, devices: Array, faulty: tuple[float, float], source: str) -> Usual:
        """Return the population that real devices (n,) stand for."""
        return cls(np.sort(devices), (0.0, 0.0), faulty, source, kernel_width(devices))

    @property
    def middle(self) -> float:
        """The median among sound phones."""
        return (
            float(np.median(self.devices)) if self.devices.size else 0.5 * (self.between[0] + self.between[1])
        )

    @property
    def highest(self) -> float:
        """The largest number that a sound phone shows."""
        return float(self.devices[-1]) if self.devices.size else self.between[1]

    @property
    def side(self) -> int:
        """Where faults are: above the usual numbers (1), below them (-1), or on both sides (0)."""
        below, above = self.middle - self.faulty[0], self.faulty[1] - self.middle
        if min(below, above) > 0.5 * max(below, above):
            return 0
        return 1 if above > below else -1

    def log_sound(self, value: float, error: float) -> float:
        """Return the log density of a measured value among sound phones, its normal error included.

        It is a mean of normal kernels at the devices' numbers, or a uniform density. Where faults are on one
        side only, it does not rise towards them: less than what a sound phone shows is sound.
        """
        if self.devices.size == 0:
            return _log_uniform(value, error, *self.between)
        sigma = float(np.hypot(self.width, error))
        worse = self.devices[self.side * (self.devices - value) > 0.0]
        apart = np.subtract.outer(np.append(worse, value), self.devices) / sigma
        densities = [log_mean_exp(-0.5 * row**2) for row in apart]
        return max(densities) - float(np.log(sigma * np.sqrt(2.0 * np.pi)))

    def log_faulty(self, value: float, error: float) -> float:
        """Return the log density of a measured value among faulty phones: uniform over `faulty`."""
        return _log_uniform(value, error, *self.faulty)

    def at_least(self, value: float) -> int:
        """Return how many of the real devices show as much, or more."""
        side = self.side or (1 if value >= self.middle else -1)
        return int(np.sum(side * (self.devices - value) >= 0.0))

    def rarity(self, value: float) -> str:
        """Say how many of the real devices show as much; "" where the population is a stated range."""
        n = self.devices.size
        if n == 0:
            return ""
        beyond = self.at_least(value)
        count = "None" if beyond == 0 else str(beyond)
        return f"({count} of {n} real devices shows as much.)"


def _log_uniform(value: float, error: float, low: float, high: float) -> float:
    """Return the log density at `value` of a uniform number in [low, high] plus a normal error."""
    from scipy.special import log_ndtr  # noqa: PLC0415 - the daemon stays light

    ends = (low - value) / error, (high - value) / error
    # Phi(high) - Phi(low), taken in the lower tail, where neither rounds to one.
    lower, upper = ends if ends[0] < 0.0 else (-ends[1], -ends[0])
    tail = float(log_ndtr(upper))
    rest = float(log_ndtr(lower)) - tail
    return tail + float(np.log(-np.expm1(min(rest, -1e-300)))) - float(np.log(high - low))


def log_mean_exp(terms: Array) -> float:
    """Return the logarithm of the mean of exponentials (n,)."""
    top = float(terms.max())
    return top + float(np.log(np.exp(terms - top).mean()))


def kernel_width(devices: Array) -> float:
    """Return the width of normal kernels by which each of the devices (n,) is best foretold by the others.

    It maximises the likelihood of devices left out one by one (Duin, IEEE Trans. Comput. 25, 1976).
    """
    n, spread = devices.size, float(devices.std())
    if n < 3 or spread == 0.0:
        return max(spread, 1e-6)
    square = np.subtract.outer(devices, devices) ** 2
    others = ~np.eye(n, dtype=np.bool_)

    def likelihood(width: float) -> float:
        terms = np.where(others, -0.5 * square / width**2, -np.inf)
        top = terms.max(axis=1)
        return float((top + np.log(np.exp(terms - top[:, None]).sum(axis=1))).sum() - n * np.log(width))

    return float(max(spread * WIDTHS, key=likelihood))


SoundPhones = Mapping[str, Usual]
"""The population of every quantity, by name."""


def parsed(table: Mapping[str, Any]) -> SoundPhones:
    """Return the populations of a parsed file. Raises KeyError where one has neither devices nor a range."""
    out = {}
    for name, row in table.items():
        low, high = (float(x) for x in row["faulty"])
        if "devices" in row:
            out[name] = Usual.of(np.array(row["devices"], dtype=np.float64), (low, high), str(row["source"]))
        else:
            least, most = (float(x) for x in row["between"])
            out[name] = Usual(np.zeros(0), (least, most), (low, high), str(row["source"]))
    return out


def usual(sound: SoundPhones, name: str, claim: float | None) -> Usual:
    """Return the population of a quantity: of all phones, or of those whose maker claims it, where known."""
    declared = sound.get(f"{name}_declared") if claim else None
    return declared or sound[name]


@cache
def sound_phones() -> SoundPhones:
    """Return the populations that come with the package."""
    path = files("stillcal.calib_core.diagnosis.model").joinpath("sound_phones.toml")
    return parsed(tomllib.loads(path.read_text(encoding="utf-8")))
