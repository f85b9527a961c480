"""Samples that repeat the one before, exactly and on all axes: held values, or samples delivered twice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.model.left_out import of_counts
from stillcal.calib_core.diagnosis.model.measurement import unknown
from stillcal.calib_core.diagnosis.model.records import NAME, Finding, Where
from stillcal.calib_core.streams.samples import Samples

BLOCK_S = 1.0
SIGNIFICANT = 6.0
ALLOWED = 0.3
LEAST_SHARE = 0.002
LEAST_COUNT = 20
ALONE = 1.02
"""Times the repeats on all axes that one axis has, above which axes repeat by themselves too."""

COME_BACK = 0.5
"""Part of the changes that lead to a value never seen before, below which values come in few steps."""

LEVELS = 5
"""Levels next to a limit on each of which fewer samples lie than on it."""

LEAST_VISITS = 3
"""Runs on a value that make it a limit: values that are held for once end there by chance."""

MANY = 0.05
"""Part of the samples held beyond which spectrum and tails are not judged."""


def without_doubles(samples: Samples) -> tuple[Samples, int]:
    """Return a stream without samples that have stamp and values of the one before.

    And how many there were.
    """
    same = (np.diff(samples.t) == 0.0) & (np.diff(samples.xyz, axis=0) == 0.0).all(axis=1)
    if not same.any():
        return samples, 0
    keep = np.concatenate([[True], ~same])
    columns = (samples.temperature, samples.t_arrival)
    temperature, arrival = (None if c is None else frozen(c[keep]) for c in columns)
    kept = Samples(samples.sensor, frozen(samples.t[keep]), frozen(samples.xyz[keep]), temperature, arrival)
    return kept, int(same.sum())


def doubled(samples: Samples, count: int) -> Finding | None:
    """State samples that were delivered twice; samples: without them."""
    share = count / (len(samples) + count)
    if count < LEAST_COUNT or share < LEAST_SHARE:
        return None
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.0), "delivery")
    say = f"{share:.2%} of the samples were delivered twice, with the same time stamp."
    seen = of_counts(np.full(40, count / 40.0), np.full(40, len(samples) / 40.0), LEAST_SHARE, 30.0)
    return unknown("timing", [], where, {"fraction": (share, "1")}, statement=say, seen=seen)


def at_limits(xyz: Array) -> NDArray[np.bool_]:
    """Return where values (n, 3) stay on their axis' highest or lowest one, and do so again and again.

    (n - 1, 3): the sample and the one before.
    """
    ends = [_at_highest(xyz[:, a]) | _at_highest(-xyz[:, a]) for a in range(xyz.shape[1])]
    return np.stack(ends, axis=1)


def _at_highest(x: Array) -> NDArray[np.bool_]:
    """Return where (n - 1,) values (n,) stay on a limit above: more lie on it than on any level below it."""
    on = np.asarray(x == x.max(initial=-np.inf))
    stays = on[1:] & on[:-1]
    if (stays[1:] & ~stays[:-1]).sum() + stays[:1].sum() < LEAST_VISITS:
        return np.zeros_like(stays)
    below = np.unique(x, return_counts=True)[1][-1 - LEVELS : -1]
    return stays if below.size == LEVELS and on.sum() > below.max() else np.zeros_like(stays)


def held(samples: Samples, sensor: str) -> tuple[Finding | None, float]:
    """Find values held: all axes repeat at once far oftener than each does by itself. Also their share.

    Coarse steps repeat on each axis, but not on all together more than chance has it. What lies at a limit
    repeats for that, and is left out.
    """
    n = max(int(BLOCK_S / max(float(np.median(np.diff(samples.t))), 1e-6)), 10)
    count = (len(samples) - 1) // n
    if count < 2:
        return None, 0.0
    free = ~np.asarray(at_limits(samples.xyz).any(axis=1))[: count * n].reshape(count, n)
    same = np.asarray(np.diff(samples.xyz, axis=0)[: count * n].reshape(count, n, 3) == 0.0)
    same &= free[:, :, None]
    judged = np.maximum(free.sum(axis=1), 1)
    together = same.all(axis=2).sum(axis=1)
    chance = judged * (same.sum(axis=1) / judged[:, None]).prod(axis=1)
    expected = float(chance.sum())
    excess = float(together.sum()) - expected
    share = max(excess, 0.0) / (count * n)
    sigmas = excess / np.sqrt(expected + 1.0)
    if excess < max(LEAST_COUNT, ALLOWED * expected) or share < LEAST_SHARE or sigmas < SIGNIFICANT:
        return None, share
    if _mixed_steps(samples.xyz, same, float(together.sum())):
        return None, share
    first, last = _bulk(np.maximum(together - chance, 0.0))
    where = Where(
        float(samples.t[first * n]),
        float(samples.t[min((last + 1) * n, len(samples) - 1)]),
        (0.0, 0.0),
        "values",
    )
    longest = _longest(same.all(axis=2).ravel())
    say = (
        f"{share:.2%} of the {NAME[sensor]}'s samples repeat the previous one on all axes, up to {longest}"
        " in a row: the driver repeats values."
    )
    seen = of_counts(
        together.astype(np.float64),
        np.full(count, float(n)),
        max(LEAST_SHARE, expected / (count * n)),
        sigmas,
    )
    sizes = {"fraction": (share, "1"), "longest": (float(longest), "samples")}
    return unknown(sensor, [0, 1, 2], where, sizes, statement=say, seen=seen), share


def _mixed_steps(xyz: Array, same: NDArray[np.bool_], together: float) -> bool:
    """Whether coarse steps went through a calibration, which mixes the axes: no one then repeats alone.

    Values xyz (n, 3) of coarse steps come back again and again; those of a sensor that was read late do not.
    """
    if float(same.sum(axis=(0, 1)).max()) > ALONE * together:
        return False
    changes = len(xyz) - together
    return len(np.unique(xyz, axis=0)) < COME_BACK * changes


def _bulk(excess: Array) -> tuple[int, int]:
    """Return first and last of the blocks that hold all but 2 % of the excess."""
    total = np.cumsum(excess) / excess.sum()
    first, last = np.searchsorted(total, (0.01, 0.99))
    return int(first), int(min(last, excess.size - 1))


def _longest(same: NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(np.int8), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))
