"""Activities in which the phone is carried: in the hand, in a pocket, on foot, on stairs, in a car."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

import numpy as np

from stillcal.replay.phone.activities.planner import Planner, Span, drawn, log_drawn, tilted
from stillcal.replay.phone.activities.resting import Activity, look_at, support_named
from stillcal.replay.phone.motion.attitudes import SUPPORTS, Support, lying
from stillcal.replay.phone.motion.trajectory import Glide, Sway, Turn, Waves

Carry = Literal["pocket", "hand", "bag"]

CARRIED: Mapping[str, Support] = {
    "pocket": SUPPORTS["upside_down"],
    "hand": Support((math.radians(25.0), math.radians(60.0)), (0.0,), 0.1),
    "bag": SUPPORTS["bag"],
}
SWING: Mapping[str, float] = {"pocket": 0.20, "hand": 0.04, "bag": 0.08}
"""Amplitude of the phone's swing with each stride, rad. Assumed."""

FORWARD, SIDEWAYS, UPWARD = np.eye(3)


class Hand(Activity, frozen=True, kw_only=True, tag="hand"):
    """The phone in use before the eyes, with changes of grip."""

    hold_s: Span = (6.0, 40.0)

    def perform(self, planner: Planner) -> None:
        """Lay pieces of holding, with changes of grip between."""
        end = planner.t + drawn(self.duration_s, planner.rng)
        while planner.t < end:
            look_at(planner, log_drawn(self.hold_s, planner.rng))


class Pocket(Activity, frozen=True, kw_only=True, tag="pocket"):
    """The phone in the pocket of somebody who sits or stands: breathing and fidgeting."""

    shift_s: Span = (5.0, 240.0)

    def perform(self, planner: Planner) -> None:
        """Lay pieces of breathing and fidgeting, with shifts between."""
        rng = planner.rng
        end = planner.t + drawn(self.duration_s, rng)
        planner.turn_to(lying(CARRIED["pocket"], rng))
        while planner.t < end:
            duration = log_drawn(self.shift_s, rng)
            turns = planner.tremble(0.002, (0.2, 0.35), 2, duration)
            turns += planner.tremble(0.0004, (1.0, 8.0), 4, duration)
            sways = planner.shake(0.015, (0.8, 6.0), 5, duration)
            planner.move(duration, self.name, turns=turns, sways=sways)
            planner.turn_to(tilted(planner.attitude, 0.3, rng), self.name, lift=0.02)


class Walk(Activity, frozen=True, kw_only=True, tag="walk"):
    """On foot. cadence_hz: steps a second; vigour: acceleration relative to the figures below.

    Harmonics of the step frequency as fractions of g: upwards 0.4, 0.1, 0.1; forwards 0.2, 0.1;
    sideways 0.1 at half the step frequency (Bachmann and Ammann 1987, Vibrations in Structures Induced by
    Man and Machines, IABSE SED 3e, Table 2.2). Cadence 1.8 Hz, sd 0.1 Hz (Pachi and Ji 2005, Frequency and
    velocity of people walking, The Structural Engineer 83). Those are of the body's centre over hard ground;
    a vigour of 0.6 to 1 gives what phones at the waist record (docs/phone.md).
    """

    cadence_hz: Span = (1.6, 2.0)
    carry: Carry = "pocket"
    vigour: Span = (0.6, 1.0)
    stretch_s: Span = (8.0, 60.0)

    def perform(self, planner: Planner) -> None:
        """Lay pieces of walking at one pace, with turns between."""
        rng = planner.rng
        end = planner.t + drawn(self.duration_s, rng)
        planner.turn_to(lying(CARRIED[self.carry], rng))
        own_pace, vigour = drawn(self.cadence_hz, rng), drawn(self.vigour, rng)
        while planner.t < end:
            duration = log_drawn(self.stretch_s, rng)
            pace = own_pace * rng.normal(1.0, 0.02)
            course = Glide(rng.normal(0.0, 0.8), min(duration, 3.0), max(0.0, duration - 4.0) * rng.random())
            planner.move(duration, self.name, turns=self._swing(planner, pace, vigour, duration),
                         sways=self._steps(planner, pace, vigour, duration), heading=course)  # fmt: skip
            planner.turn_to(tilted(planner.attitude, 0.1, rng), self.name, lift=0.05)

    def _steps(self, planner: Planner, pace: float, vigour: float, duration: float) -> tuple[Sway, ...]:
        g = planner.gravity * vigour
        courses = (
            (UPWARD, (1, 2, 3), (0.4, 0.1, 0.1)),
            (FORWARD, (1, 2), (0.2, 0.1)),
            (SIDEWAYS, (0.5, 1.5), (0.1, 0.1)),
        )
        sways = tuple(
            Sway(axis, self._harmonics(planner, pace, orders, g * np.array(share), duration), order=0)
            for axis, orders, share in courses
        )
        return sways + planner.shake(0.5 * vigour, (5.0, 20.0), 8, duration)

    def _swing(self, planner: Planner, pace: float, vigour: float, duration: float) -> tuple[Turn, ...]:
        size = SWING[self.carry] * vigour
        shares = ((size, 0.3 * size), (0.3 * size, 0.2 * size), (0.2 * size, 0.1 * size))
        return tuple(
            Turn(axis, self._harmonics(planner, pace, (0.5, 1.0), np.array(share), duration))
            for axis, share in zip(np.eye(3), shares, strict=True)
        )

    @staticmethod
    def _harmonics(
        planner: Planner, pace: float, orders: tuple[float, ...], size: np.ndarray, duration: float
    ) -> Waves:
        phase = planner.rng.uniform(0.0, 2.0 * math.pi, len(orders))
        return Waves(size, pace * np.array(orders), phase, duration, min(1.0, duration / 2.0))


class Stairs(Walk, frozen=True, kw_only=True, tag="stairs"):
    """Walking on stairs: slower and harder than on level ground."""

    cadence_hz: Span = (1.4, 1.9)
    vigour: Span = (0.8, 1.4)
    stretch_s: Span = (4.0, 9.0)


class Drive(Activity, frozen=True, kw_only=True, tag="drive"):
    """The phone in a car: engine, road, accelerating, braking, bends, and waits with the engine idling."""

    support: str = "leaning"
    road_rms: Span = (0.3, 0.9)
    idle_rms: Span = (0.01, 0.06)
    engine_hz: Span = (22.0, 30.0)

    def perform(self, planner: Planner) -> None:
        """Lay pieces of waiting, accelerating, driving through bends and braking."""
        rng = planner.rng
        end = planner.t + drawn(self.duration_s, rng)
        planner.turn_to(lying(support_named(self.support), rng))
        engine = drawn(self.engine_hz, rng)
        while planner.t < end:
            self._wait(planner, engine)
            speed = rng.uniform(6.0, 25.0)
            self._leg(planner, speed, engine)
            for _ in range(int(rng.integers(1, 6))):
                self._leg(planner, 0.0, engine, cruising=speed)
            self._leg(planner, -speed, engine)

    def _wait(self, planner: Planner, engine: float) -> None:
        duration = planner.rng.uniform(4.0, 45.0)
        idling = planner.shake(drawn(self.idle_rms, planner.rng), (engine * 0.98, engine * 1.02), 3, duration)
        planner.move(duration, self.name, sways=idling)

    def _leg(self, planner: Planner, gain: float, engine: float, cruising: float = 0.0) -> None:
        rng = planner.rng
        duration = abs(gain) / rng.uniform(1.2, 2.5) if gain else rng.uniform(6.0, 40.0)
        road = planner.shake(drawn(self.road_rms, rng), (1.0, 20.0), 12, duration)
        hum = planner.shake(0.15, (engine, 2.0 * engine), 3, duration)
        pitching = planner.tremble(0.006, (0.7, 3.0), 4, duration)
        bend = Glide(rng.normal(0.0, 0.8) if cruising else 0.0, max(duration - 2.0, 1.0), 0.5)
        push = Sway(FORWARD, Glide(gain, duration), order=1)
        outward = Sway(SIDEWAYS * cruising, bend, order=1)
        planner.move(duration, self.name, turns=pitching, sways=(*road, *hum, push, outward), heading=bend)
