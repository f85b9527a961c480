"""A scenario played out for one seed: pieces of motion, surroundings, events, before any sensor is read."""

from __future__ import annotations

import bisect
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.events import Charging, Location
from stillcal.replay.phone.activities.planner import Planner
from stillcal.replay.phone.activities.resting import Activity, Place
from stillcal.replay.phone.clock import Interval
from stillcal.replay.phone.effects.on_settings import TiltCreep
from stillcal.replay.phone.heat import Surroundings
from stillcal.replay.phone.motion.attitudes import SUPPORTS, lying
from stillcal.replay.phone.motion.gravity import earth_rotation_at, gravity_at
from stillcal.replay.phone.motion.trajectory import Creep, Motion, Piece, motion_of
from stillcal.replay.phone.noise import seeded
from stillcal.replay.phone.scenario import Scenario
from stillcal.replay.phone.timeline import Steps

Event = Charging | Location


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What really happens, in true time s. pieces: end to end from 0 to duration."""

    pieces: tuple[Piece, ...]
    surroundings: Surroundings
    events: tuple[Event, ...]
    stressed: tuple[Interval, ...]
    suspended: tuple[Interval, ...]
    duration: float

    def motion(self, t: Array) -> Motion:
        """Return the true motion at rising times (n,) s; before 0 the phone is where it is at 0."""
        if not t.size:
            return Motion(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3)))
        parts = [motion_of(piece, t[rows]) for piece, rows in self._cut(t)]
        if len(parts) == 1:
            return parts[0]
        return Motion(
            np.concatenate([p.force for p in parts]),
            np.concatenate([p.rate for p in parts]),
            np.concatenate([p.rate_dot for p in parts]),
        )

    def _cut(self, t: Array) -> Iterator[tuple[Piece, slice]]:
        first = max(bisect.bisect_right(self.pieces, float(t[0]), key=lambda p: p.t_start) - 1, 0)
        row = 0
        for piece in self.pieces[first:]:
            last = piece is self.pieces[-1]
            end = t.size if last else row + int(np.searchsorted(t[row:], piece.t_end, side="left"))
            if end > row:
                yield piece, slice(row, end)
            row = end
            if row == t.size:
                return


class _Course:
    """Plays the segments one after another and notes what goes on around them."""

    def __init__(self, scenario: Scenario, planner: Planner) -> None:
        self._scenario, self._planner = scenario, planner
        self._ambient, self._place = scenario.ambient_c, scenario.place
        self._charging = False
        self.steps: list[tuple[float, float, float, float]] = []
        self.events: list[Event] = [_located(0.0, scenario.place)]
        self.stressed: list[Interval] = []
        self.suspended: list[Interval] = []

    def play(self, segment: Activity) -> None:
        planner, start = self._planner, self._planner.t
        if segment.place is not None and segment.place != self._place:
            self._arrive(segment.place)
        if segment.charging != self._charging:
            self._charging = segment.charging
            self.events.append(Charging(start, segment.charging))
        self._ambient = self._ambient if segment.ambient_c is None else segment.ambient_c
        self.steps.append((start, self._ambient, segment.use, float(segment.charging)))
        segment.perform(planner)
        span = Interval(start, planner.t)
        self.stressed += [span] if segment.stressed else []
        self.suspended += [span] if segment.suspended else []

    def _arrive(self, place: Place) -> None:
        self._place = place
        self.events.append(_located(self._planner.t, place))
        settle_in(self._planner, place, self._scenario.earth_rotation)


def _located(t: float, place: Place) -> Location:
    return Location(t, place.latitude, place.longitude, place.altitude)


def settle_in(planner: Planner, place: Place, earth_rotation: bool) -> None:
    """Let gravity and the Earth's rotation be those of a place from now on."""
    planner.gravity = gravity_at(place.latitude, place.altitude)
    planner.earth = np.array(earth_rotation_at(place.latitude)) if earth_rotation else None


def play(scenario: Scenario, seed: int, creep: TiltCreep | None = None) -> Plan:
    """Play a scenario out. The same scenario and seed give the same plan, whatever phone is carried."""
    planner = Planner(
        seeded(seed, "hand"),
        lying(SUPPORTS["screen_up"], seeded(seed, "first attitude")),
        gravity_at(scenario.place.latitude, scenario.place.altitude),
        creep=None if creep is None else Creep(creep.amplitude, creep.tau_s),
    )
    settle_in(planner, scenario.place, scenario.earth_rotation)
    course = _Course(scenario, planner)
    for _ in range(scenario.repeat):
        for segment in scenario.segments:
            if planner.rng.random() < segment.chance:
                course.play(segment)
    duration = scenario.duration_s or planner.t
    if planner.t < duration:
        planner.rest(duration - planner.t, "rest")
    return _plan(planner, course, duration)


def _plan(planner: Planner, course: _Course, duration: float) -> Plan:
    t, ambient, use, charging = (np.array(column) for column in zip(*course.steps, strict=True))
    return Plan(
        pieces=tuple(p for p in planner.pieces if p.t_start < duration),
        surroundings=Surroundings(Steps.of(t, ambient), Steps.of(t, use), Steps.of(t, charging)),
        events=tuple(e for e in course.events if e.t < duration),
        stressed=tuple(course.stressed),
        suspended=tuple(course.suspended),
        duration=duration,
    )
