"""Single values in motion that neither neighbours nor noise explain: a torn byte, a bit that fell.

One value that is off by e leaves a pattern of five residuals: e times (1, -4, 6, -4, 1) / 6. A hand, a knock
or a vibration that is quicker than samples are leaves others about it too. So a value counts where the
pattern is all that stands out: without it, what is left of the five is what motion leaves about them, and so
it is on the other axes. Noise at rest has tests of its own, and so has a sample that repeats the one before
(`direct.repeated_values`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.direct.repeated_values import repeating
from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    Index,
    direct_finding,
    of_counts,
    share_of,
    sized,
)
from stillcal.calib_core.diagnosis.model.records import AXES, NAME, Finding, Where
from stillcal.calib_core.diagnosis.segments.value_grid import UNIT, least_change
from stillcal.calib_core.diagnosis.sequence.neighbours import REACH, WEIGHTS, residual, spread
from stillcal.calib_core.maths.robust import MAD_TO_SD
from stillcal.calib_core.streams.samples import Samples

DRIVER = "single values in motion, or blows shorter than two samples"

FAR = 20.0
"""Spreads of what motion leaves about a value, from which on it stands out."""

CALM = 4.0
"""Spreads up to which nothing else may stand out."""

AROUND = np.concatenate([np.arange(-8, -REACH), np.arange(REACH + 1, 9)])
"""Places of the residuals that know nothing of a value, and tell what motion leaves about it."""

SOUND = 1e-3
"""Share of the samples in motion that may be so: twice the worst. Of 31 streams of real sensors (480,000
samples in motion) 25 have none, five up to 2 in 10,000, and one in flight 5 in 10,000."""

FEWEST = 200
"""Samples in motion, at least."""


def lone_values(samples: Samples, sensor: str, still: NDArray[np.bool_]) -> Finding | None:
    """Find single values that jump away and back in motion. still: (n,) which samples lie at rest."""
    moving = int(len(samples) - still.sum())
    if moving < FEWEST:
        return None
    left = residual(samples.xyz)
    known = still | repeating(samples.xyz)
    found = [_beyond_steps(*_lone(left, known, axis), samples.xyz[:, axis]) for axis in range(3)]
    rows = np.unique(np.concatenate([at for at, _ in found]))
    if not rows.size:
        return None
    size = float(np.median(np.concatenate([np.abs(off) for _, off in found])))
    axes = [a for a in range(3) if len(found[a][0])]
    share = share_of(float(rows.size), float(moving))
    say = (
        f"In motion single values of the {NAME[sensor]}'s {', '.join(AXES[a] for a in axes)} jump away and"
        f" back, {rows.size} of {moving}, by {size:.3g} {UNIT[sensor]} (median): neither their neighbours nor"
        " noise explain them. Blows shorter than two samples look the same: record at a higher rate to tell."
    )
    where = Where(float(samples.t[rows[0]]), float(samples.t[rows[-1]]), (0.0, 0.0), DRIVER)
    sizes = {"fraction": share.parameter("1"), **sized({"size": (size, UNIT[sensor])})}
    seen = DirectEvidence(of_counts(float(rows.size), float(moving), SOUND))
    return direct_finding("unknown", sensor, axes, where, sizes, statement=say, seen=seen)


def _lone(left: Array, known: NDArray[np.bool_], axis: int) -> tuple[Index, Array]:
    """Return which samples (k,) stand alone on an axis, and by how much (k,) they are off.

    known: (n,) which samples are not asked for.
    """
    usual = spread(left)
    own = np.abs(left[:, axis])
    reach = int(AROUND[-1])
    at = np.flatnonzero((own > FAR * 0.5 * usual[axis]) & ~known[REACH:-REACH])
    at = at[(at >= reach) & (at < len(left) - reach)]
    pattern = np.arange(-REACH, REACH + 1)
    five = left[at[:, None] + pattern, axis]
    off = five @ WEIGHTS / float(WEIGHTS @ WEIGHTS)
    rest = np.abs(five - off[:, None] * WEIGHTS).max(axis=1)
    # What is left must be far smaller whatever motion leaves: most places are told by that alone.
    alone = FAR * rest < CALM * own[at]
    at, off, rest = at[alone], off[alone], rest[alone]
    about = np.abs(left[at[:, None] + AROUND])
    scale = np.maximum(MAD_TO_SD * np.median(about, axis=1), 0.5 * usual)
    others = (np.abs(left[at]) > CALM * scale).sum(axis=1) == 1
    clear = (own[at] > FAR * scale[:, axis]) & (rest < CALM * scale[:, axis]) & others
    return at[clear] + REACH, off[clear]


def _beyond_steps(at: Index, off: Array, values: Array) -> tuple[Index, Array]:
    """Return those of single values (k,) that are no rounding: coarse steps leave nothing between them."""
    if not at.size:
        return at, off
    beyond = np.abs(off) > FAR * least_change(values) / np.sqrt(12.0)
    return at[beyond], off[beyond]
