"""Values that come in coarser steps for a while: a range, or a mode, that was switched.

The finest difference of two values is looked at piece by piece. Where a run of pieces keeps to a coarser grid
than the rest, each distinct value in it had the choice of all finer ones.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.direct.stuck import longest_run
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding, of_chance, sized
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Where
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT, comb_step
from stillcal.calib_core.streams.samples import Samples

DRIVER = "steps of the values that change"
PIECES = 40
"""Parts of the recording that are looked at one by one."""

COARSER = 1.5
"""Times the finest step, half way to the next one that there can be."""

FITTED = 2
"""Numbers that a coarser grid takes up: its step and its place."""


def step_change(samples: Samples, sensor: str) -> Finding | None:
    """Find a run of time in which a sensor's values keep to a coarser grid; the axis that is surest tells."""
    found = {a: one for a in range(3) if (one := _of_axis(samples.xyz[:, a])) is not None}
    if not found:
        return None
    best = max(found, key=lambda a: found[a][0])
    nats, rows, coarse, fine = found[best]
    axes = [a for a in found if DirectEvidence(found[a][0] - float(np.log(3.0))).stated] or [best]
    start, end = float(samples.t[rows.start]), float(samples.t[rows.stop - 1])
    named = ", ".join(AXES[a] for a in axes)
    say = (
        f"From {start:.0f} to {end:.0f} s the {NAME[sensor]}'s values on {named} come in steps of"
        f" {coarse:.4g} {UNIT[sensor]}, else in steps of {fine:.4g}."
    )
    sizes = sized({"step": (coarse, UNIT[sensor]), "finest_step": (fine, UNIT[sensor])})
    seen = DirectEvidence(nats - float(np.log(3.0)))
    where = Where(start, end, (0.0, 0.0), DRIVER)
    return direct_finding("unknown", sensor, axes, where, sizes, statement=say, seen=seen)


def _of_axis(values: Array) -> tuple[float, slice, float, float] | None:
    """Return nats, the rows, their step and the finest one of values (n,); None where steps are alike."""
    fine = comb_step(values)
    if fine is None or values.size < PIECES:
        return None
    edges = np.linspace(0, values.size, PIECES + 1).astype(np.int64)
    least = [_finest(values[a:b], fine) for a, b in pairwise(edges)]
    first, last = longest_run(np.array(least) > COARSER * fine)
    rows = slice(int(edges[first]), int(edges[last]))
    part, others = values[rows], np.delete(values, rows)
    coarse = comb_step(part)
    if coarse is None or coarse < COARSER * fine or not others.size:
        return None
    own, away = np.unique(np.rint(part / fine)), np.unique(np.rint(others / fine))
    pitch = coarse / fine
    place = float(np.median(own))
    off = np.abs(own - place - pitch * np.rint((own - place) / pitch)).max()
    chance = (2.0 * np.rint(off) + 1.0) / pitch
    # What lies on the coarser grid elsewhere must be few too.
    beside = np.abs(away - place - pitch * np.rint((away - place) / pitch)) > off + 0.5
    if chance >= 1.0 or beside.mean() < 0.5 * (1.0 - chance):
        return None
    nats = of_chance((own.size - FITTED) * float(np.log(chance)), PIECES**2 / 2.0)
    return nats, rows, coarse, fine


def _finest(values: Array, step: float) -> float:
    """Return the smallest difference of two values (n,) that is no rounding; infinite for one value."""
    gaps = np.diff(np.unique(values))
    return float(gaps[gaps > step / 2.0].min(initial=np.inf))
