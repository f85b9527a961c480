"""The rests and turns gathered so far: bounded, one attitude never crowding out the others.

The daemon runs for months, so nothing here grows without end. A rest is kept with the gravity of
the place it was taken at, because the phone travels between rests.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stillcal.calib_core.gravity import Gravity
from stillcal.calib_core.gyroscope.rotation_segment import RotationSegment
from stillcal.calib_core.static.rest import RestState, group_attitudes


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
