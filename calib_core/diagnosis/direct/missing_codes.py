"""Values that an axis never gives: those of a bit that never changes, and those about its zero.

On the grid of its steps an axis with a dead bit k leaves out every other run of 2^k codes, over the whole
range that motion took it through. A sound one that was seen in m such pairs of runs is in one half of each by
chance, 2^-m. In a dead zone an axis reads one value where a sound one, that came within twice the width n
times, would have been met in it as often: not once by chance, e^-n.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import Index, Seen, direct_finding, of_chance, sized
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Number, Where
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT, comb_step
from stillcal.calib_core.streams.samples import Samples

BITS = 14
"""Bits that are looked at: those of a 16-bit converter but the lowest and the sign."""

SPOILED = ("noise_heavy_tailed", "noise_unequal_axes", "accel_quantisation", "gyro_quantisation")
LEAST_VALUES = 8
"""Different values that occur just beyond a dead zone, which is wider than steps then."""

LEAST_VISITS = 5
"""Visits to the surroundings of a dead zone, on either side."""

ON_GRID = 0.25
"""Steps that a value may be off the grid."""


def dead_bits(samples: Samples, sensor: str) -> Finding | None:
    """Find axes of which one bit never changes."""
    found = {a: b for a in range(3) if (b := _dead_bit(samples.xyz[:, a])) is not None}
    if not found:
        return None
    axes = list(found)
    told = ", ".join(f"{bit} of {AXES[a]}" for a, (bit, _) in found.items())
    say = f"One bit of the {NAME[sensor]}'s values never changes ({told}), so half of the values never occur."
    pairs = float(min(pairs for _, pairs in found.values()))
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.0), "values")
    bits: Number = [float(bit) for bit, _ in found.values()]
    sizes = sized({"bit": (bits, "1"), "pairs": (pairs, "1")})
    seen = Seen(max(_nats(bit, pairs) for bit, pairs in found.values()))
    return direct_finding("missing_codes", sensor, axes, where, sizes, statement=say, seen=seen)


def _nats(bit: int, pairs: int) -> float:
    """Return the evidence for a dead bit: of each pair of runs a sound axis shows one by chance 1/2.

    Both halves, three axes, `BITS` bits and every place where a run may begin were tried.
    """
    return of_chance(-pairs * float(np.log(2.0)), 6.0 * BITS * 2.0 * 2.0**bit)


def _dead_bit(values: Array) -> tuple[int, int] | None:
    """Return the bit of values (n,) that never changes and in how many pairs of runs; None where all do.

    The lowest bit is not among them: without it the step is twice as large.
    """
    step = comb_step(values)
    if step is None:
        return None
    away = (values - float(np.median(values))) / step
    codes = np.unique(np.rint(away)).astype(np.int64)
    if float(np.quantile(np.abs(away - np.rint(away)), 0.99)) > ON_GRID:
        return None
    for bit in range(1, BITS):
        run = 2**bit
        start = _half(codes, run)
        if start is None:
            continue
        pairs = int(np.unique((codes - start) // (2 * run)).size)
        if Seen(_nats(bit, pairs)).stated:
            return bit, pairs
    return None


def _half(codes: Index, run: int) -> int | None:
    """Return where the run of codes that occur begins, modulo two runs; None where more than one occurs."""
    seen = np.unique(codes % (2 * run))
    gaps = np.diff(np.concatenate([seen, [seen[0] + 2 * run]]))
    widest = int(np.argmax(gaps))
    return int(seen[(widest + 1) % seen.size]) if gaps[widest] > run else None


def dead_zone(samples: Samples, sensor: str) -> Finding | None:
    """Find axes that read one value in place of all about it."""
    zones = {a: z for a in range(3) if (z := _zone(samples.xyz[:, a])) is not None}
    if not zones:
        return None
    axes = list(zones)
    width = float(np.median([width for width, _ in zones.values()]))
    named, size = ", ".join(AXES[a] for a in axes), f"{width:.2g} {UNIT[sensor]}"
    say = f"Dead zone: the {NAME[sensor]} reads one constant value on {named} for inputs within {size} of it."
    visits = float(min(visits for _, visits in zones.values()))
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.0), "values")
    sizes = sized({"width": (width, UNIT[sensor]), "visits": (visits, "1")})
    # A sound axis would have been met in the zone as often as beside it: never, by chance e^-visits.
    seen = Seen(of_chance(-max(float(v) for _, v in zones.values()), 6.0))
    return direct_finding("missing_codes", sensor, axes, where, sizes, statement=say, seen=seen)


def _zone(values: Array) -> tuple[float, int] | None:
    """Return half the width of the gap about the value that occurs most, and the visits to its surroundings.

    None where it has no gap on both sides, or one that steps or chance would leave.
    """
    distinct, count = np.unique(values, return_counts=True)
    k = int(np.argmax(count))
    if not 0 < k < distinct.size - 1:
        return None
    beyond = []
    for side in (1.0, -1.0):
        away = side * (values - distinct[k])
        gap = float(away[away > 0.0].min())
        near = (away > 0.0) & (away <= 2.0 * gap)
        beyond.append((gap, near))
    visits = [_visits(near) for _, near in beyond]
    rich = all(np.unique(values[near]).size >= LEAST_VALUES for _, near in beyond)
    replaced = _visits(values == distinct[k]) >= 0.5 * min(visits)
    if not rich or not replaced or min(visits) < LEAST_VISITS:
        return None
    return min(gap for gap, _ in beyond), sum(visits)


def _visits(there: NDArray[np.bool_]) -> int:
    """Return how many runs of True begin in (n,) bool."""
    return int((there[1:] & ~there[:-1]).sum())


def beside(found: list[Finding], lost: Sequence[Finding | None]) -> list[Finding]:
    """Return one sensor's findings and the values lost, without what these do to the noise of their axes."""
    known = [f for f in lost if f is not None]
    axes = {axis for f in known for axis in f.axes}
    return [*known, *(f for f in found if f.effect not in SPOILED or not set(f.axes) <= axes)]
