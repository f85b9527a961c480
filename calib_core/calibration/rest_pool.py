"""The pool of rests and rotation segments gathered so far, bounded in size, age and rests per attitude.

The daemon runs for months, so nothing here grows without end, and an attitude that is held often does not
displace the others. Each rest is kept with the gravity of the place it was taken at, because the phone
travels between rests. `AttitudeIndex` adds rests to a pool and thins it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegment
from stillcal.calib_core.static.rest import (
    ATTITUDE_ANGLE,
    RestState,
    attitude_labels,
    directions,
    force_uncertainties,
    forces,
    group_attitudes,
)


@dataclass(frozen=True, slots=True)
class PoolSettings:
    """The bounds of the pool.

    attitude_angle: rad, two rests whose directions of gravity are within this angle share an attitude.
    rests_per_attitude, attitudes, turns: how many rests, attitudes and rotation segments are kept.
    max_age_s: s after which a rest is too old. turns_max_age_s: s after which a rotation segment is: a
    gyroscope's scale keeps longer than a bias, and turns that show it come seldom. place_reach_s: s before
    the first known place within which rests are taken to come from there.
    """

    attitude_angle: float = ATTITUDE_ANGLE
    rests_per_attitude: int = 12
    attitudes: int = 96
    turns: int = 64
    max_age_s: float = 14 * 86400.0
    turns_max_age_s: float = 91 * 86400.0
    place_reach_s: float = 86400.0

    def __post_init__(self) -> None:
        if not 0 < self.attitude_angle < np.pi / 4:
            raise ValueError(f"attitude_angle = {self.attitude_angle}: must be within 0..0.785 rad")
        for name in ("rests_per_attitude", "attitudes", "turns"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)}: must be 1 or more")
        for name in ("max_age_s", "turns_max_age_s", "place_reach_s"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} = {getattr(self, name)}: must be positive")


MOST_SAMPLES = 32_768
"""Samples of all rotation segments together, 1.2 MB of a saved state: eleven minutes of turns at 50 Hz."""


@dataclass(frozen=True, slots=True, eq=False)
class HeldRest:
    """A rest with the gravity of the place where it was taken."""

    rest: RestState
    gravity: Gravity


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """Rests and rotation segments (`turns`), oldest first."""

    held: tuple[HeldRest, ...] = ()
    turns: tuple[RotationSegment, ...] = ()

    @property
    def rests(self) -> list[RestState]:
        """The rests without their gravity, oldest first."""
        return [h.rest for h in self.held]

    def with_segment(self, segment: RotationSegment, settings: PoolSettings) -> Pool:
        """Return the pool with one rotation segment more, without the oldest where there are too many."""
        return replace(self, turns=_bounded((*self.turns, segment)[-settings.turns :]))

    def since(self, t: float | None) -> Pool:
        """Return the pool of what was taken from t (s) on; the whole pool for None."""
        if t is None:
            return self
        return Pool(
            tuple(h for h in self.held if h.rest.t_start >= t),
            tuple(segment for segment in self.turns if segment.t_start >= t),
        )

    def where(self, valid: Callable[[RestState], bool]) -> Pool:
        """Return the pool with only the rests for which `valid` holds."""
        return replace(self, held=tuple(h for h in self.held if valid(h.rest)))

    def located(self, gravity: Gravity, t: float, settings: PoolSettings) -> Pool:
        """Return the pool with `gravity`, of the first place known (at t, s), given to the rests before it.

        Rests from more than place_reach_s before t are dropped, because their place, and so the norm that
        they should have, is unknown.
        """
        near = (h for h in self.held if t - h.rest.t_end <= settings.place_reach_s)
        held = (replace(h, gravity=gravity) if h.gravity.source == "default" else h for h in near)
        return replace(self, held=tuple(held))

    def attitudes(self, settings: PoolSettings) -> list[list[int]]:
        """Group the rests by attitude; indices point into `held`."""
        return group_attitudes(self.rests, settings.attitude_angle)


def _bounded(turns: tuple[RotationSegment, ...]) -> tuple[RotationSegment, ...]:
    """Return segments of MOST_SAMPLES at most: long ones are thinned first, then the oldest dropped."""
    kept = list(turns)
    excess = sum(segment.t.size for segment in kept) - MOST_SAMPLES
    while excess > 0 and not all(segment.thinnest for segment in kept):
        longest = max(range(len(kept)), key=lambda k: (not kept[k].thinnest, kept[k].t.size))
        thinned = kept[longest].halved()
        excess -= kept[longest].t.size - thinned.t.size
        kept[longest] = thinned
    while excess > 0:
        excess -= kept.pop(0).t.size
    return tuple(kept)


Index = NDArray[np.intp]
Flags = NDArray[np.bool_]


class AttitudeIndex:
    """Adds rests to a pool one at a time and keeps track of which rests share an attitude.

    The grouping is that of rest.group_attitudes. Grouping all rests anew for each new one takes time in
    proportion to rests times attitudes, thousands of times a week. Here a new rest is compared with the first
    rest of each attitude only, and a rest that is dropped affects only the rests that were compared with it.
    It is fastest where each pool passed in is the one it returned last.

    Arrays by rest of that pool: _up, (n, 3), unit direction; _ends, (n,) s; _uncertainty, (n,) m/s^2; _first,
    (n,) position in the pool of the first rest of the same attitude.
    """

    def __init__(self, settings: PoolSettings) -> None:
        self._settings, self._near = settings, float(np.cos(settings.attitude_angle))
        self._rebuild(())

    def with_rest(self, pool: Pool, held: HeldRest) -> Pool:
        """Return the pool with one rest more, thinned back to its bounds.

        Rests and rotation segments that are too old are dropped first, then the least certain rests of an
        attitude that has too many, then the oldest attitudes. The newest rest of an attitude always stays,
        because the next check is made with it.
        """
        if pool.held is not self._held:
            self._rebuild(pool.held)
        self._add(held)
        self._keep_only(self._ends[-1] - self._ends <= self._settings.max_age_s)
        if len(self._held) > self._settings.rests_per_attitude:
            self._keep_only(self._within_bounds())
        oldest = self._ends[-1] - self._settings.turns_max_age_s
        turns = tuple(segment for segment in pool.turns if segment.t_end >= oldest)
        return replace(pool, held=self._held, turns=turns)

    def attitudes(self, pool: Pool) -> int:
        """Return the number of distinct attitudes in the pool."""
        if pool.held is not self._held:
            self._rebuild(pool.held)
        return int(np.count_nonzero(self._first == np.arange(self._first.size)))

    def _rebuild(self, held: tuple[HeldRest, ...]) -> None:
        rests = [h.rest for h in held]
        raw = forces(rests)
        self._held, self._up = held, directions(raw)
        self._ends = np.array([rest.t_end for rest in rests])
        self._uncertainty = np.linalg.norm(force_uncertainties(rests), axis=1)
        labels = attitude_labels(raw, self._settings.attitude_angle)
        self._first = np.asarray(np.unique(labels, return_index=True)[1][labels], dtype=np.intp)

    def _add(self, held: HeldRest) -> None:
        n = self._first.size
        up = directions(forces([held.rest]))
        firsts = np.flatnonzero(self._first == np.arange(n))
        near = firsts[self._is_near(self._up[firsts], up[0])]
        self._held = (*self._held, held)
        self._up = np.concatenate((self._up, up))
        self._ends = np.append(self._ends, held.rest.t_end)
        self._uncertainty = np.append(self._uncertainty, np.linalg.norm(held.rest.force_uncertainty))
        self._first = np.append(self._first, near[0] if near.size else n)

    def _within_bounds(self) -> Flags:
        """Tell which rests stay, (n,), within the bounds on rests of an attitude and on attitudes."""
        n, most = self._first.size, self._settings.rests_per_attitude
        keep = np.ones(n, dtype=bool)
        for first in np.flatnonzero(np.bincount(self._first, minlength=n) > most):
            *older, _ = np.flatnonzero(self._first == first)
            by_uncertainty = np.argsort(self._uncertainty[older], kind="stable")
            keep[np.array(older)[by_uncertainty[most - 1 :]]] = False
        latest = np.full(n, -1)
        latest[self._first] = np.arange(n)
        taken = np.flatnonzero(latest >= 0)
        forgotten = taken[np.argsort(latest[taken])][: -self._settings.attitudes]
        return np.asarray(keep & ~np.isin(self._first, forgotten))

    def _keep_only(self, keep: Flags) -> None:
        """Drop the other rests, and find the attitude of those anew whose first rest is dropped."""
        if keep.all():
            return
        orphans = np.flatnonzero(keep & ~keep[self._first])
        place = np.cumsum(keep) - 1
        first = np.where(keep[self._first], place[self._first], keep.size)[keep]
        self._held = tuple(held for held, stays in zip(self._held, keep.tolist(), strict=True) if stays)
        self._up, self._ends, self._uncertainty = self._up[keep], self._ends[keep], self._uncertainty[keep]
        self._first = first
        if not all(self._reassigned(int(place[orphan])) for orphan in orphans):
            self._rebuild(self._held)

    def _reassigned(self, orphan: int) -> bool:
        """Find the attitude of a rest that lost its first rest, or let it begin one.

        False where it would take a rest that begins an attitude of its own: then all must be grouped anew.
        """
        places = np.arange(self._first.size)
        near = self._is_near(self._up, self._up[orphan])
        earlier = np.flatnonzero(near[:orphan] & (self._first[:orphan] == places[:orphan]))
        if earlier.size:
            self._first[orphan] = earlier[0]
            return True
        theirs = near & (self._first > orphan)
        if (self._first[theirs] == places[theirs]).any():
            return False
        self._first[theirs] = orphan
        return True

    def _is_near(self, up: Array, other: Array) -> Flags:
        return np.asarray(up[:, 0] * other[0] + up[:, 1] * other[1] + up[:, 2] * other[2] >= self._near)
