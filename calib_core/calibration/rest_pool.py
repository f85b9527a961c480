"""The rests and turns gathered so far: bounded, one attitude never crowding out the others.

The daemon runs for months, so nothing here grows without end. A rest is kept with the gravity of
the place it was taken at, because the phone travels between rests.
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
    RestState,
    attitude_labels,
    force_uncertainties,
    forces,
    group_attitudes,
)


@dataclass(frozen=True, slots=True)
class PoolSettings:
    """attitude_angle: rad within which two rests share an attitude. The rest are bounds of the pool.

    rests_per_attitude, attitudes, turns: how many are kept. max_age_s: s after which a rest is too old.
    place_reach_s: s before the first known place within which a rest is taken to be from there.
    """

    attitude_angle: float = 0.0872665  # 5 degrees
    rests_per_attitude: int = 12
    attitudes: int = 96
    turns: int = 64
    max_age_s: float = 14 * 86400.0
    place_reach_s: float = 86400.0

    def __post_init__(self) -> None:
        if not 0 < self.attitude_angle < np.pi / 4:
            raise ValueError(f"attitude_angle = {self.attitude_angle}: must be within 0..0.785 rad")
        for name in ("rests_per_attitude", "attitudes", "turns"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)}: must be 1 or more")
        for name in ("max_age_s", "place_reach_s"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} = {getattr(self, name)}: must be positive")


@dataclass(frozen=True, slots=True, eq=False)
class HeldRest:
    """A rest and the gravity of where it was taken."""

    rest: RestState
    gravity: Gravity


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """What has been gathered, oldest first."""

    held: tuple[HeldRest, ...] = ()
    turns: tuple[RotationSegment, ...] = ()

    @property
    def rests(self) -> list[RestState]:
        """The rests without their gravity, oldest first."""
        return [h.rest for h in self.held]

    def with_segment(self, turn: RotationSegment, settings: PoolSettings) -> Pool:
        """Return the pool with one turn more; the oldest goes where there are too many."""
        return replace(self, turns=(*self.turns, turn)[-settings.turns :])

    def since(self, t: float | None) -> Pool:
        """Return only what was taken from t (s) on; all of it for None."""
        if t is None:
            return self
        return Pool(
            tuple(h for h in self.held if h.rest.t_start >= t),
            tuple(turn for turn in self.turns if turn.t_start >= t),
        )

    def where(self, valid: Callable[[RestState], bool]) -> Pool:
        """Return the pool without the rests that are no longer believed to be rests."""
        return replace(self, held=tuple(h for h in self.held if valid(h.rest)))

    def located(self, gravity: Gravity, t: float, settings: PoolSettings) -> Pool:
        """Return the pool with `gravity`, of the first known place (at t, s), for the rests before it.

        Those from longer ago than place_reach_s go: where they were taken, and so their norm, is unknown.
        """
        near = (h for h in self.held if t - h.rest.t_end <= settings.place_reach_s)
        held = (replace(h, gravity=gravity) if h.gravity.source == "default" else h for h in near)
        return replace(self, held=tuple(held))

    def attitudes(self, settings: PoolSettings) -> list[list[int]]:
        """Group the rests by attitude; indices point into `held`."""
        return group_attitudes(self.rests, settings.attitude_angle)


Index = NDArray[np.intp]
Flags = NDArray[np.bool_]


class AttitudeIndex:
    """Grows pools by one rest at a time, fastest where each pool is the one it returned last.

    By rest of that pool: up, (n, 3), its direction; ends, s; doubt, its uncertainty, m/s^2; first, the place
    in the pool of the first rest of its attitude, to which it is near.
    """

    def __init__(self, settings: PoolSettings) -> None:
        self._settings, self._near = settings, float(np.cos(settings.attitude_angle))
        self._take_up(())

    def grown(self, pool: Pool, held: HeldRest) -> Pool:
        """Return the pool with one rest more, thinned back to its bounds.

        What is too old goes, then the least certain rest of a crowded attitude, then the oldest attitude. The
        newest rest of an attitude always stays: it is what the next check is made with.
        """
        if pool.held is not self._held:
            self._take_up(pool.held)
        self._add(held)
        self._keep(self._ends[-1] - self._ends <= self._settings.max_age_s)
        if len(self._held) > self._settings.rests_per_attitude:
            self._keep(self._wanted())
        return replace(pool, held=self._held)

    def attitudes(self, pool: Pool) -> int:
        """Return how many distinct attitudes there are in the pool."""
        if pool.held is not self._held:
            self._take_up(pool.held)
        return int(np.count_nonzero(self._first == np.arange(self._first.size)))

    def _take_up(self, held: tuple[HeldRest, ...]) -> None:
        rests = [h.rest for h in held]
        raw = forces(rests)
        self._held, self._up = held, _directions(raw)
        self._ends = np.array([rest.t_end for rest in rests])
        self._doubt = np.linalg.norm(force_uncertainties(rests), axis=1)
        labels = attitude_labels(raw, self._settings.attitude_angle)
        self._first = np.asarray(np.unique(labels, return_index=True)[1][labels], dtype=np.intp)

    def _add(self, held: HeldRest) -> None:
        n = self._first.size
        up = _directions(forces([held.rest]))
        firsts = np.flatnonzero(self._first == np.arange(n))
        near = firsts[self._is_near(self._up[firsts], up[0])]
        self._held = (*self._held, held)
        self._up = np.concatenate((self._up, up))
        self._ends = np.append(self._ends, held.rest.t_end)
        self._doubt = np.append(self._doubt, np.linalg.norm(held.rest.force_uncertainty))
        self._first = np.append(self._first, near[0] if near.size else n)

    def _wanted(self) -> Flags:
        """Tell which rests stay, of too many in one attitude and of too many attitudes."""
        n, most = self._first.size, self._settings.rests_per_attitude
        keep = np.ones(n, dtype=bool)
        for first in np.flatnonzero(np.bincount(self._first, minlength=n) > most):
            *older, _ = np.flatnonzero(self._first == first)
            by_doubt = np.argsort(self._doubt[older], kind="stable")
            keep[np.array(older)[by_doubt[most - 1 :]]] = False
        latest = np.full(n, -1)
        latest[self._first] = np.arange(n)
        taken = np.flatnonzero(latest >= 0)
        forgotten = taken[np.argsort(latest[taken])][: -self._settings.attitudes]
        return np.asarray(keep & ~np.isin(self._first, forgotten))

    def _keep(self, keep: Flags) -> None:
        """Let the others go; whoever was held against one of them is held against the rest of the pool."""
        if keep.all():
            return
        orphans = np.flatnonzero(keep & ~keep[self._first])
        place = np.cumsum(keep) - 1
        first = np.where(keep[self._first], place[self._first], keep.size)[keep]
        self._held = tuple(held for held, stays in zip(self._held, keep.tolist(), strict=True) if stays)
        self._up, self._ends, self._doubt = self._up[keep], self._ends[keep], self._doubt[keep]
        self._first = first
        if not all(self._settled(int(place[orphan])) for orphan in orphans):
            self._take_up(self._held)

    def _settled(self, orphan: int) -> bool:
        """Find a rest its attitude again, or let it begin one; False where that takes one from another."""
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


def _directions(raw: Array) -> Array:
    return np.asarray(raw / np.maximum(np.linalg.norm(raw, axis=1, keepdims=True), 1e-12))
