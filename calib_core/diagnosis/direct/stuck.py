"""An axis that gives one value for a while, or throughout, when the others go on: it is stuck, or dead.

Values of coarse steps repeat by chance, the oftener the coarser. Evidence is the chance of a run as long,
from how often the axis repeats otherwise. An axis at the limit of its range,
where motion brings it again and again, is not stuck.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.direct.repeated_values import at_limits
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding, of_chance, sized
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Where
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT
from stillcal.calib_core.streams.samples import Samples

BLOCK_S = 1.0
LEAST_S = 3.0
MOVES = 0.5
"""Part of the samples of a run in which another axis must change; else the sample is held as a whole."""

MOST_REPEATS = 0.5
"""Part of the samples elsewhere that repeat, above which steps are too coarse to tell."""

MANY_VALUES = 100
"""Different values that each of the other axes must give for one with a single value to be dead."""


def stuck(samples: Samples, sensor: str) -> Finding | None:
    """Find the longest run in which one axis of a sensor is stuck."""
    same = np.diff(samples.xyz, axis=0) == 0.0
    free = same & ~at_limits(samples.xyz)
    runs = [longest_run(free[:, a]) for a in range(3)]
    axis = int(np.argmax([last - first for first, last in runs]))
    first, last = runs[axis]
    length, t = last - first, samples.t
    if length < 2 or t[last] - t[first] < LEAST_S:
        return None
    others = np.delete(same[first:last], axis, axis=1)
    elsewhere = np.delete(free[:, axis], np.s_[first:last])
    if elsewhere.size < length:
        return None
    # By blocks, so that stretches in which little happens do not hide in a mean; an axis may stick twice.
    block = max(round(BLOCK_S * length / (t[last] - t[first])), 1)
    chance = max(float(np.quantile(_shares(elsewhere, block), 0.9)), 1e-9)
    if chance > MOST_REPEATS or others.mean(axis=0).min() > 1.0 - MOVES:
        return None
    span = f"From {t[first]:.0f} to {t[last]:.0f} s"
    say = f"{span} the {NAME[sensor]}'s {AXES[axis]} axis is stuck at {samples.xyz[first, axis]:.4g}."
    return _stated(samples, sensor, (axis, first, last), chance, say)


def dead(samples: Samples, sensor: str) -> Finding | None:
    """Find an axis that gives one value from the first sample to the last, when both others go on."""
    still = (samples.xyz == samples.xyz[:1]).all(axis=0)
    if still.sum() != 1 or samples.t[-1] - samples.t[0] < LEAST_S:
        return None
    others = samples.xyz[:, ~still]
    chance = max(float((np.diff(others, axis=0) == 0.0).mean(axis=0).max()), 1e-9)
    few = min(np.unique(column).size for column in others.T) < MANY_VALUES
    if few or chance > MOST_REPEATS:
        return None
    axis = int(np.argmax(still))
    value = f"gives {samples.xyz[0, axis]:.4g} throughout"
    say = f"The {NAME[sensor]}'s {AXES[axis]} axis {value}: it is dead, or was not recorded."
    return _stated(samples, sensor, (axis, 0, len(samples) - 1), chance, say)


def _stated(
    samples: Samples, sensor: str, run: tuple[int, int, int], chance: float, say: str
) -> Finding | None:
    """State a run of one value: axis, first and last sample. chance: of a repeat by chance."""
    axis, first, last = run
    where = Where(float(samples.t[first]), float(samples.t[last]), (0.0, 0.0), "values that stand still")
    # As many repeats in a row, each with that chance, on any axis, from any sample on.
    seen = DirectEvidence(of_chance((last - first) * float(np.log(chance)), 3.0 * len(samples)))
    value = float(samples.xyz[first, axis])
    sizes = sized({"value": (value, UNIT[sensor]), "samples": (last - first + 1.0, "1")})
    return direct_finding("unknown", sensor, [axis], where, sizes, statement=say, seen=seen)


def longest_run(same: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the longest run [first, last) of True in (n,) bool."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(np.int8), [0]])))
    if not edges.size:
        return 0, 0
    starts, ends = edges[::2], edges[1::2]
    k = int(np.argmax(ends - starts))
    return int(starts[k]), int(ends[k])


def _shares(same: Array, size: int) -> Array:
    """Return the parts of True (m,) in blocks of `size`."""
    whole = same[: same.size // size * size]
    return np.asarray(whole.reshape(-1, size).mean(axis=1))
