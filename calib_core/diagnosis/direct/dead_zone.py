"""One value that an axis gives in place of all about it: a dead zone, or noise that a driver takes away.

A sound axis that is met n times as far again from that value, on either side, is met as often nearer by:
never with a chance of 2^-n. What has no name: drivers that hold the zero, gates and thresholds look alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding, of_chance, sized
from stillcal.calib_core.diagnosis.model.records import AT_REST, AXES, NAME, Finding, Where
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT, comb_step
from stillcal.calib_core.streams.samples import Samples

SPOILED = (
    "noise_level", "noise_heavy_tailed", "noise_unequal_axes", "held_samples", "bandwidth", "vibration_tone",
    "accel_quantisation", "gyro_quantisation",
)  # fmt: skip
"""What the noise that is left, and a value that repeats, cannot tell."""

DRIVER = "inputs that are nearly none"

LEAST_STEPS = 1.5
"""Steps of the values' grid to the nearest other value: from two on, a code between them is left out."""

LEAST_VALUES = 8
"""Different values just beyond, or `LEAST_MET` of those that the grid has there where it has fewer."""

LEAST_MET = 0.8
"""Part of the grid's values: what leaves out values everywhere is no zone."""

MOST_STANDING = 0.9
"""Part of the samples just beyond that repeat the one before, above which nothing passes there."""

LEAST_VISITS = 5
"""Visits to the surroundings, on either side."""

HIDDEN = 0.02
"""Part of the samples at rest that read the one value, from which on rests show neither bias nor noise."""


@dataclass(frozen=True, slots=True)
class Zone:
    """width: half of it, in the sensor's unit. visits: runs of samples just beyond it, on both sides."""

    width: float
    visits: int


def dead_zone(samples: Samples, sensor: str) -> Finding | None:
    """Find axes that read one value in place of all about it."""
    zones = {a: zone for a in range(3) if (zone := _zone(samples.xyz[:, a])) is not None}
    if not zones:
        return None
    width = float(np.median([zone.width for zone in zones.values()]))
    named, size = ", ".join(AXES[a] for a in zones), f"{width:.2g} {UNIT[sensor]}"
    say = f"Dead zone: the {NAME[sensor]} reads one constant value on {named} for inputs within {size} of it."
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.0), DRIVER)
    visits = [float(zone.visits) for zone in zones.values()]
    sizes = sized({"width": (width, UNIT[sensor]), "visits": (min(visits), "1")})
    seen = DirectEvidence(of_chance(-max(visits) * float(np.log(2.0)), 6.0))
    return direct_finding("unknown", sensor, list(zones), where, sizes, statement=say, seen=seen)


def _zone(values: Array) -> Zone | None:
    """Return the gap about the value that occurs most; None without one, or where steps leave it."""
    distinct, count = np.unique(values, return_counts=True)
    k = int(np.argmax(count))
    if not 0 < k < distinct.size - 1:
        return None
    step = comb_step(values)
    visits, gaps = [], []
    for side in (1.0, -1.0):
        away = side * (values - distinct[k])
        gap = float(away[away > 0.0].min())
        near = (away > 0.0) & (away <= 2.0 * gap)
        if not _filled(np.unique(away[near]).size, gap, step) or _stands(values, near):
            return None
        visits.append(_visits(near))
        gaps.append(gap)
    replaced = _visits(values == distinct[k]) >= 0.5 * min(visits)
    return Zone(min(gaps), sum(visits)) if replaced and min(visits) >= LEAST_VISITS else None


def _filled(met: int, gap: float, step: float | None) -> bool:
    """Whether the values `met` just beyond a gap, as far again, are those that the steps let occur."""
    if step is None:
        return met >= LEAST_VALUES
    steps = gap / step
    return steps > LEAST_STEPS and met >= min(LEAST_VALUES, LEAST_MET * (np.rint(steps) + 1.0))


def _stands(values: Array, near: NDArray[np.bool_]) -> bool:
    """Whether values just beyond a gap do not change: a simulation jumps to its rates and back."""
    both = near[1:] & near[:-1]
    return bool(both.any()) and float((np.diff(values)[both] == 0.0).mean()) > MOST_STANDING


def _visits(there: NDArray[np.bool_]) -> int:
    """Return how many runs of True begin in (n,) bool."""
    return int((there[1:] & ~there[:-1]).sum())


def is_zone(finding: Finding) -> bool:
    """Whether a finding is a dead zone."""
    return finding.effect == "unknown" and finding.where.driver == DRIVER


def hides_rest(found: Sequence[Finding], sensor: str, rests: Sequence[Array]) -> bool:
    """Whether a dead zone among the findings takes what a sensor reads at rest; rests: (n, 3) values each."""
    axes = {AXES.index(a) for zone in found if is_zone(zone) and zone.sensor == sensor for a in zone.axes}
    if not axes or not rests:
        return False
    still = np.concatenate(rests)
    return any(np.unique(still[:, a], return_counts=True)[1].max() > HIDDEN * len(still) for a in axes)


def beside(found: list[Finding], zone: Finding | None) -> list[Finding]:
    """Return one sensor's findings and the zone, without what it does to the noise."""
    if zone is None:
        return found
    return [zone, *(f for f in found if f.effect not in SPOILED and f.where.driver != AT_REST)]
