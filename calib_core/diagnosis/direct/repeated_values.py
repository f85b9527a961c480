"""Samples that repeat the one before, exactly and on all axes: held values, or samples delivered twice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.inference.left_out import of_shares
from stillcal.calib_core.diagnosis.model.measurement import (
    DirectEvidence,
    Index,
    Measured,
    direct_finding,
    of_counts,
    of_measured,
    share_in_time,
    share_of,
)
from stillcal.calib_core.diagnosis.model.records import NAME, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.model.sound_phones import Usual
from stillcal.calib_core.diagnosis.segments.sample_period import sample_period
from stillcal.calib_core.diagnosis.segments.value_grid import least_change
from stillcal.calib_core.maths.robust import bulk
from stillcal.calib_core.streams.samples import Samples

BLOCK_S = 1.0
ALLOWED = 0.3
"""Part of the repeats that chance expects by which they may exceed it: axes are not quite independent."""

ALIKE = 10
"""Blocks that are counted together: counts of a single one are too uncertain for their products."""

LEAST_SHARE = 1e-3
"""Share of samples held that is none, on the logarithmic scale of populations."""

ALONE = 1.02
"""Times the repeats on all axes that one axis has, above which axes repeat by themselves too."""

COME_BACK = 0.5
"""Part of the changes that lead to a value never seen before, below which values come in few steps."""

LEAST_PILE = 8
"""Samples that must lie on the last value of an axis for it to end there."""

LEAST_ENDS = 3
"""Ends of axes that must agree, of six, for a limit that all have."""

LEVELS = 5
"""Levels next to a limit on each of which fewer samples lie than on it."""

LEAST_VISITS = 3
"""Runs on a value that make it a limit: values that are held for once end there by chance."""

TWICE = "samples delivered twice"
"""Driver of what is delivered again at once, stamp and all."""

MANY = 0.05
"""Part of the samples held beyond which spectrum and tails are not judged."""


USUAL = 0.9
"""Quantile of the runs of samples held that is the longest usual one."""

OFTEN, CAUGHT_UP = 10, 2.0
"""Rows that repeat after which what moved meanwhile must show, and times the next change by which it does."""

NEAR = 2.5
"""Steps of an axis up to which a value is near another: one or two of them."""


def repeating(xyz: Array) -> NDArray[np.bool_]:
    """Return which rows (n, 3) repeat the one before on all axes."""
    return np.concatenate([[False], (np.diff(xyz, axis=0) == 0.0).all(axis=1)])


def without_doubles(samples: Samples) -> tuple[Samples, int]:
    """Return a stream without samples that have stamp and values of the one before.

    And how many there were.
    """
    same = repeating(samples.xyz)
    same[1:] &= np.diff(samples.t) == 0.0
    return (samples.where(~same), int(same.sum())) if same.any() else (samples, 0)


def held_rows(samples: Samples) -> NDArray[np.bool_]:
    """Return which rows repeat the one before though the values go on from there.

    They do where the next other value is more than two steps away; what coarse steps repeat is not held.
    After many rows it must also be farther away than the value after it: a sensor without noise reads the
    same at rest, and then moves off.
    """
    again = repeating(samples.xyz)
    if not again.any():
        return again
    xyz, rows = samples.xyz, np.arange(len(samples))
    fresh = np.append(np.flatnonzero(~again), len(samples) - 1)
    run = np.searchsorted(fresh[:-1], rows, side="right")
    after, then = fresh[run], fresh[np.minimum(run + 1, fresh.size - 1)]
    step = np.array([least_change(axis) for axis in xyz.T])
    goes_on = (np.abs(xyz[after] - xyz) > NEAR * step).any(axis=1)
    away, next_away = (np.linalg.norm(to - xyz[after], axis=1) for to in (xyz, xyz[then]))
    long = after - fresh[run - 1] > OFTEN
    return np.asarray(again & goes_on & ~(long & (away < CAUGHT_UP * next_away)))


def without_held(samples: Samples) -> Samples:
    """Return a stream without the samples that are held (`held_rows`)."""
    again = held_rows(samples)
    return samples.where(~again) if again.any() else samples


def doubled(samples: Samples, count: int, once: float) -> Finding | None:
    """State `count` samples that were delivered twice. samples: without them; once: how many in all."""
    total = once + count
    share = share_of(float(count), total)
    where = Where(float(samples.t[0]), float(samples.t[-1]), (0.0, 0.0), TWICE)
    say = f"{share.value:.2%} of the samples were delivered twice, with the same time stamp."
    seen = DirectEvidence(of_counts(float(count), total, LEAST_SHARE))
    sizes = {"fraction": share.parameter("1")}
    return direct_finding("unknown", "timing", [], where, sizes, statement=say, seen=seen)


def common_extreme(xyz: Array) -> tuple[float, int, float]:
    """Return the largest size of value at which most of the six ends of the axes stop, and how many do.

    Ends are those on whose very last value `LEAST_PILE` samples lie. Also returned is how closely they agree:
    the least difference of two values.
    """
    ends = []
    for a in range(xyz.shape[1]):
        for signed in (xyz[:, a], -xyz[:, a]):
            top = float(signed.max(initial=-np.inf))
            if top > 0.0 and (signed == top).sum() >= LEAST_PILE:
                ends.append(top)
    if not ends:
        return 0.0, 0, 0.0
    rounding = 1e-6 * max(map(abs, ends))
    gaps = [np.diff(np.unique(xyz[:, a])) for a in range(xyz.shape[1])]
    within = min(float(g[g > rounding].min(initial=np.inf)) for g in gaps)
    within = within if np.isfinite(within) else rounding
    count = [sum(abs(other - end) <= within for other in ends) for end in ends]
    most = int(np.argmax(count))
    return ends[most], count[most], within


def at_limits(xyz: Array) -> NDArray[np.bool_]:
    """Return where values (n, 3) stay on their axis' highest or lowest one, and do so again and again.

    (n - 1, 3): the sample and the one before.
    """
    ends = np.stack([_at_highest(xyz[:, a]) | _at_highest(-xyz[:, a]) for a in range(xyz.shape[1])], axis=1)
    limit, count, within = common_extreme(xyz)
    if count < LEAST_ENDS:
        return ends
    on = np.abs(xyz) >= limit - within
    return np.asarray(ends | (on[1:] & on[:-1]))


def _at_highest(x: Array) -> NDArray[np.bool_]:
    """Return where (n - 1,) values (n,) stay on a limit above: more lie on it than on any level below it."""
    on = np.asarray(x == x.max(initial=-np.inf))
    stays = on[1:] & on[:-1]
    if (stays[1:] & ~stays[:-1]).sum() + stays[:1].sum() < LEAST_VISITS:
        return np.zeros_like(stays)
    below = np.unique(x, return_counts=True)[1][-1 - LEVELS : -1]
    return stays if below.size == LEVELS and on.sum() > below.max() else np.zeros_like(stays)


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """Samples that repeat the one before on all axes. n: samples a block.

    together, chance: (B,) a block, how many there are and how many steps would make if none were held;
    judged: (B,) how many could be; alone: (B, 3) how many repeat on each axis; longest: in a row.
    """

    n: int
    together: Array
    chance: Array
    judged: Array
    alone: Array
    longest: int
    mixed: bool

    @classmethod
    def of(cls, samples: Samples) -> Repeats | None:
        """Count the repeats of one sensor; None where it is too short. What lies at a limit is left out."""
        n = max(int(BLOCK_S / max(sample_period(samples.t), 1e-6)), 10)
        count = (len(samples) - 1) // n
        if count < 2:
            return None
        free = ~np.asarray(at_limits(samples.xyz).any(axis=1))[: count * n].reshape(count, n)
        same = np.asarray(np.diff(samples.xyz, axis=0)[: count * n].reshape(count, n, 3) == 0.0)
        same &= free[:, :, None]
        judged = np.maximum(free.sum(axis=1), 1)
        every = same.all(axis=2)
        together = every.sum(axis=1).astype(np.float64)
        alone = same.sum(axis=1)
        chance = judged * (alone / judged[:, None]).prod(axis=1)
        mixed = _mixed_steps(samples.xyz, same, float(together.sum()))
        return cls(n, together, chance, judged, alone, int(_runs(every.ravel()).max(initial=0)), mixed)

    @property
    def excess(self) -> float:
        """Repeats above those that chance expects."""
        return float(self.together.sum() - self.chance.sum())

    def share(self) -> Measured:
        """Return the part of the samples that is held: where steps may make all, none, to what they make."""
        total, expected = float(self.n * self.together.size), float(self.chance.sum())
        if self.mixed or self.excess < ALLOWED * expected:
            by_steps = max(self.excess, 0.0) + ALLOWED * expected
            return Measured(0.0, max(by_steps, 1.0) / float(self.judged.sum()))
        part = float(self.judged.sum()) / total
        less, most_likely, more = (part * self._held(k) for k in (1.0 + ALLOWED, 1.0, 1.0 - ALLOWED))
        counted = share_of(most_likely * total, total)
        return Measured(most_likely, float(np.hypot(counted.error, (more - less) / 2.0)))

    def foretold(self) -> Measured:
        """Return the same as another recording may have it: samples are held now and then."""
        share, total = self.share(), float(self.n * self.together.size)
        shown = self.together * (share.value * total / max(float(self.together.sum()), 1.0))
        return Measured(share.value, max(share.error, share_in_time(shown, total).error))

    def _held(self, dependence: float) -> float:
        """Return the part h of the judged samples that is held; steps make the other repeats.

        An axis repeats in p = h + (1 - h) c of them, all axes in q = h + (1 - h) c1 c2 c3, so that
        (1 - h)^2 (q - h) is (p1 - h) (p2 - h) (p3 - h), a cubic of h. c differs with motion, and is one for
        `ALIKE` blocks whose axes repeat about as often. dependence: times that steps make all axes repeat,
        of what independent axes do.
        """
        first = np.arange(0, self.judged.size, ALIKE)
        order = np.argsort(self.alone.sum(axis=1) / self.judged)
        counts = np.column_stack([self.judged, self.together, self.alone])[order]
        judged, *repeats = np.add.reduceat(counts, first).T
        q, x, y, z = repeats / judged
        apart = np.stack([x * y * z, -(x * y + y * z + z * x), x + y + z, np.full(q.size, -1.0)])
        held = np.stack([q, -(1.0 + 2.0 * q), 2.0 + q, np.full(q.size, -1.0)])
        cubic = (held - dependence * apart) @ judged
        if cubic[0] <= 0.0:
            return 0.0
        roots = np.roots(cubic[::-1])
        # Without a root, as dependent axes may leave none, all that repeats is held at most.
        real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real <= 1.0)]
        return float(real.min(initial=float(self.together.sum() / self.judged.sum())))


def held(samples: Samples, sensor: str, usual: Usual) -> tuple[Finding | None, float]:
    """Find values held: all axes repeat at once far oftener than each does by itself. Also their share.

    Coarse steps repeat on each axis, but not on all together more than chance has it. usual: of log10 of the
    share plus `LEAST_SHARE`.
    """
    seen = Repeats.of(samples)
    if seen is None:
        return None, 0.0
    share = seen.share()
    if share.value <= 0.0:
        return None, 0.0
    first, last = bulk(np.maximum(seen.together - seen.chance, 0.0))
    end = min((last + 1) * seen.n, len(samples) - 1)
    where = Where(float(samples.t[first * seen.n]), float(samples.t[end]), (0.0, 0.0), "values")
    say = (
        f"{share.value:.2%} of the {NAME[sensor]}'s samples repeat the previous one on all axes, up to"
        f" {seen.longest} in a row: the driver repeats values."
    )
    of = np.full(seen.together.size, float(seen.n))
    held_out = of_shares(seen.together, of, min(10.0**usual.highest, 0.9))
    judged = of_measured(share.log(LEAST_SHARE), usual, held_out)
    sizes = {
        "fraction": share.parameter("1"),
        "longest": Parameter(float(seen.longest), None, "samples"),
    }
    found = direct_finding("held_samples", sensor, [0, 1, 2], where, sizes, statement=say, seen=judged)
    return found, share.value


def _mixed_steps(xyz: Array, same: NDArray[np.bool_], together: float) -> bool:
    """Whether coarse steps went through a calibration, which mixes the axes: no one then repeats alone.

    Values xyz (n, 3) of coarse steps come back again and again; those of a sensor that was read late do not.
    """
    if float(same.sum(axis=(0, 1)).max()) > ALONE * together:
        return False
    changes = len(xyz) - together
    return len(np.unique(xyz, axis=0)) < COME_BACK * changes


def _runs(same: NDArray[np.bool_]) -> Index:
    """Return how many of (n,) are true in a row, each time that any are."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(np.int8), [0]])))
    return np.asarray(edges[1::2] - edges[::2], dtype=np.int64)


def usual_longest(samples: Samples) -> int:
    """Return how many samples in a row repeat the one before at most, but for one time in ten.

    Steps add some repeats to those that are held, and make longer runs of them.
    """
    runs = _runs(repeating(samples.xyz))
    return int(np.quantile(runs, USUAL, method="lower")) if runs.size else 0
