"""Values that an axis never gives because one bit of its converter never changes.

On the grid of its steps an axis with a dead bit k leaves out every other run of 2^k codes, over the whole
range that motion took it through. A sound one that was seen in m such pairs of runs is in one half of each by
chance, 2^-m. At rest few pairs are seen, but where noise takes the axis across such a run from sample to
sample, each time it might have been in it: noise is no less likely there than on the less likely side.
"""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    Index,
    direct_finding,
    of_chance,
    sized,
)
from stillcal.calib_core.diagnosis.model.records import AT_REST, AXES, NAME, Finding, Number, Where
from stillcal.calib_core.diagnosis.segments.value_grid import step_at_rest
from stillcal.calib_core.streams.samples import Samples

BITS = 14
"""Bits that are looked at: those of a 16-bit converter but the lowest and the sign."""

SPOILED = ("noise_heavy_tailed", "noise_unequal_axes", "accel_quantisation", "gyro_quantisation")

ON_GRID = 0.25
"""Steps that a value may be off the grid."""

DITHERED = 0.5
"""Part of the crossings of samples that know nothing of each other, from which on noise makes them: a bias
that jumps, or a phone that is turned, crosses rarely."""


def dead_bits(samples: Samples, sensor: str) -> Finding | None:
    """Find axes of which one bit never changes."""
    found = {a: b for a in range(3) if (b := _dead_bit(samples.xyz[:, a])) is not None}
    if not found:
        return None
    axes = list(found)
    told = ", ".join(f"{bit} of {AXES[a]}" for a, (bit, _, _) in found.items())
    say = f"One bit of the {NAME[sensor]}'s values never changes ({told}), so half of the values never occur."
    pairs = float(min(pairs for _, pairs, _ in found.values()))
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.0), "values")
    bits: Number = [float(bit) for bit, _, _ in found.values()]
    sizes = sized({"bit": (bits, "1"), "pairs": (pairs, "1")})
    seen = DirectEvidence(max(_nats(bit, chances) for bit, _, chances in found.values()))
    return direct_finding("missing_codes", sensor, axes, where, sizes, statement=say, seen=seen)


def _nats(bit: int, chances: int) -> float:
    """Return the evidence for a dead bit: of each pair of runs a sound axis shows one by chance 1/2.

    chances: how many pairs and crossings were seen.

    Both halves, three axes, `BITS` bits and every place where a run may begin were tried.
    """
    return of_chance(-chances * float(np.log(2.0)), 6.0 * BITS * 2.0 * 2.0**bit)


def _dead_bit(values: Array) -> tuple[int, int, int] | None:
    """Return the bit of values (n,) that never changes, in how many pairs of runs, and by how many chances.

    None where all bits change. The chances are pairs, and crossings of a run that is left out.

    The lowest bit is not among them: without it the step is twice as large.
    """
    step = step_at_rest(values)
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
        side = (np.rint(away).astype(np.int64) - start) // (2 * run)
        seen = (codes - start) // (2 * run)
        pairs = int(np.unique(seen).size)
        chances = pairs + _crossed(side, seen)
        if DirectEvidence(_nats(bit, chances)).stated:
            return bit, pairs, chances
    return None


def _crossed(side: Index, seen: Index) -> int:
    """Return how often noise took an axis across a run that it might have been in.

    side: (n,) which pair of runs each sample lies in; seen: (m,) the same of each code that occurs. Half of
    the crossings go to the less likely side. None where it crosses rarely, nor where one of the two usual
    sides is a single code: that may be what a dead zone makes of all in it.
    """
    places, count = np.unique(side, return_counts=True)
    usual = places[np.argsort(count)[-2:]]
    if usual.size < 2 or min(int(np.count_nonzero(seen == place)) for place in usual) < 2:
        return 0
    share = count / side.size
    crossings = int(np.count_nonzero(np.diff(side)))
    return crossings // 2 if crossings > DITHERED * (1.0 - float((share**2).sum())) * side.size else 0


def _half(codes: Index, run: int) -> int | None:
    """Return where the run of codes that occur begins, modulo two runs; None where more than one occurs."""
    seen = np.unique(codes % (2 * run))
    gaps = np.diff(np.concatenate([seen, [seen[0] + 2 * run]]))
    widest = int(np.argmax(gaps))
    return int(seen[(widest + 1) % seen.size]) if gaps[widest] > run else None


def beside(found: list[Finding], lost: Finding | None) -> list[Finding]:
    """Return one sensor's findings and the values lost, without what these do to the noise of their axes."""
    if lost is None:
        return found
    spoiled = [f for f in found if f.effect in SPOILED or (f.effect, f.where.driver) == ("unknown", AT_REST)]
    own = [f for f in spoiled if set(f.axes) <= set(lost.axes)]
    return [lost, *(f for f in found if not any(f is other for other in own))]
