"""Activities in which the phone lies on something: still, or shaken by what it lies on."""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec
import numpy as np

from stillcal.replay.phone.activities.planner import Planner, Span, any_direction, drawn, log_drawn, tilted
from stillcal.replay.phone.motion.attitudes import SUPPORTS, Support, attitude_with, lying, poses
from stillcal.replay.phone.motion.trajectory import Sway, Turn, Waves
from stillcal.replay.phone.settings import Settings, Vector, require

TABLE_WEIGHTS: Mapping[str, float] = {
    "screen_up": 0.50,
    "screen_down": 0.20,
    "leaning": 0.08,
    "stand_landscape": 0.07,
    "cushion": 0.05,
    "on_long_edge": 0.04,
    "upright": 0.02,
    "upside_down": 0.02,
    "face_to_wall": 0.02,
}
"""How often a phone put down ends up on each support. Assumed: mostly flat (see docs/phone.md)."""


class Place(Settings, frozen=True, kw_only=True):
    """Where the phone is. latitude, longitude: degrees; altitude: m."""

    latitude: float
    longitude: float
    altitude: float = 0.0

    def __post_init__(self) -> None:
        require(-90.0 <= self.latitude <= 90.0, "latitude", self.latitude, "from -90 to 90 degrees")
        require(-180.0 <= self.longitude <= 180.0, "longitude", self.longitude, "from -180 to 180 degrees")
        require(-500.0 <= self.altitude <= 9000.0, "altitude", self.altitude, "from -500 to 9000 m")


class Activity(Settings, frozen=True, kw_only=True, tag_field="activity"):
    """One segment of a scenario, and what goes on around it.

    duration_s: length, fixed or drawn from a range. chance: that it happens at all. charging: on the plug.
    use: 0 idle to 1 busy screen and processor. ambient_c: surrounding temperature, None to keep the last.
    place: where it happens, None to stay. stressed: the processor starves the sensors. suspended:
    the phone sleeps and delivers nothing.
    """

    duration_s: Span = 600.0
    chance: float = 1.0
    charging: bool = False
    use: float = 0.0
    ambient_c: float | None = None
    place: Place | None = None
    stressed: bool = False
    suspended: bool = False

    def __post_init__(self) -> None:
        for field in self.__struct_fields__:
            if field.endswith("_s"):
                span = getattr(self, field)
                low, high = (span, span) if isinstance(span, float | int) else span
                require(0.0 < low <= high, field, span, "above 0 s, or a rising range")
        for name in getattr(self, "supports", ()):
            support_named(name)
        support_named(getattr(self, "support", "screen_up"))
        require(0.0 <= self.chance <= 1.0, "chance", self.chance, "from 0 to 1")
        require(0.0 <= self.use <= 1.0, "use", self.use, "from 0 to 1")

    @property
    def name(self) -> str:
        """The activity's name in scenario files."""
        return str(self.__struct_config__.tag)

    def perform(self, planner: Planner) -> None:
        """Add the activity's pieces of motion to the planner."""
        raise NotImplementedError


def support_named(name: str) -> Support:
    """Return a support. Raises ValueError naming the known ones."""
    require(name in SUPPORTS, "support", name, f"one of {', '.join(SUPPORTS)}")
    return SUPPORTS[name]


def drawn_support(weights: Mapping[str, float], rng: np.random.Generator) -> Support:
    """Draw a support with probability proportional to its weight."""
    share = np.array(list(weights.values()))
    return support_named(list(weights)[int(rng.choice(len(share), p=share / share.sum()))])


class Rest(Activity, frozen=True, kw_only=True, tag="rest"):
    """Put down once and left alone."""

    support: str = "screen_up"

    def perform(self, planner: Planner) -> None:
        """Lay pieces of putting the phone down, and one rest."""
        end = planner.t + drawn(self.duration_s, planner.rng)
        planner.put_down(lying(support_named(self.support), planner.rng))
        planner.rest(max(end - planner.t, 1.0), self.name)


class Table(Activity, frozen=True, kw_only=True, tag="table"):
    """The phone lies on supports; now and then it is picked up and put down in another attitude.

    rest_s: length of a rest; look: chance that it is looked at before it is put down again, for look_s.
    supports: the weight of each support in the draw.
    """

    rest_s: Span = (15.0, 900.0)
    look: float = 0.6
    look_s: Span = (4.0, 25.0)
    supports: dict[str, float] = msgspec.field(default_factory=lambda: dict(TABLE_WEIGHTS))

    def perform(self, planner: Planner) -> None:
        """Lay rests with handling between, until the time is up."""
        rng = planner.rng
        end = planner.t + drawn(self.duration_s, rng)
        while planner.t < end:
            if rng.random() < self.look:
                look_at(planner, drawn(self.look_s, rng))
            planner.put_down(lying(drawn_support(self.supports, rng), rng))
            planner.rest(max(min(log_drawn(self.rest_s, rng), end - planner.t), 2.0), self.name)


def look_at(planner: Planner, duration: float) -> None:
    """Hold the phone before the eyes for `duration` s: some 45 degrees back, trembling and drifting."""
    viewing = lying(Support((math.radians(25.0), math.radians(65.0)), (0.0,), 0.12), planner.rng)
    planner.turn_to(viewing, lift=0.3)
    turns = planner.tremble(0.03, (0.1, 1.5), 4, duration) + planner.tremble(0.0015, (6.0, 12.0), 3, duration)
    sways = planner.shake(0.12, (0.4, 3.0), 4, duration) + planner.shake(0.05, (6.0, 12.0), 3, duration)
    planner.move(duration, "hand", turns=turns, sways=sways)


class Poses(Activity, frozen=True, kw_only=True, tag="poses"):
    """A calibration by hand: attitudes held still for rest_s one after another.

    count: so many, spread over the sphere and shuffled; or ups: up directions in body axes, held in order.
    """

    count: int = 24
    rest_s: Span = (18.0, 22.0)
    ups: tuple[Vector, ...] = ()

    def perform(self, planner: Planner) -> None:
        """Turn and hold, attitude after attitude; ends when all are done, whatever duration_s says."""
        rng = planner.rng
        chosen = [attitude_with(np.array(up), rng.uniform(-math.pi, math.pi)) for up in self.ups]
        for attitude in chosen or poses(self.count, rng):
            planner.put_down(attitude)
            planner.rest(drawn(self.rest_s, planner.rng), self.name)


class Desk(Activity, frozen=True, kw_only=True, tag="desk"):
    """On a desk at which somebody types: bursts of vibration between quiet stretches."""

    support: str = "screen_up"
    quiet_s: Span = (10.0, 120.0)
    typing_s: Span = (3.0, 60.0)
    typing_rms: Span = (0.01, 0.08)

    def perform(self, planner: Planner) -> None:
        """Lay alternating pieces of rest and typing."""
        rng = planner.rng
        end = planner.t + drawn(self.duration_s, rng)
        planner.put_down(lying(support_named(self.support), rng))
        while planner.t < end:
            planner.rest(log_drawn(self.quiet_s, rng), self.name)
            duration = log_drawn(self.typing_s, rng)
            shaking = planner.shake(drawn(self.typing_rms, rng), (8.0, 40.0), 8, duration)
            rocking = planner.tremble(2e-4, (8.0, 25.0), 3, duration)
            planner.move(duration, self.name, turns=rocking, sways=shaking)


class Washer(Activity, frozen=True, kw_only=True, tag="washer"):
    """On a washing machine (Stisen et al. 2015, Fig. 4): tumbling, then spinning at spin_hz."""

    support: str = "screen_up"
    spin_hz: Span = (10.0, 25.0)
    spin_rms: Span = (0.5, 2.0)

    def perform(self, planner: Planner) -> None:
        """Lay alternating pieces of pauses, tumbling and spinning."""
        rng = planner.rng
        end = planner.t + drawn(self.duration_s, rng)
        planner.put_down(lying(support_named(self.support), rng))
        while planner.t < end:
            planner.rest(rng.uniform(5.0, 20.0), self.name)
            duration = rng.uniform(20.0, 90.0)
            spinning = rng.random() < 0.4
            pitch = drawn(self.spin_hz, rng) if spinning else rng.uniform(0.7, 0.9)
            rms = drawn(self.spin_rms, rng) if spinning else rng.uniform(0.05, 0.2)
            planner.move(duration, self.name, turns=self._rocking(planner, pitch, rms, duration),
                         sways=self._turning(planner, pitch, rms, duration))  # fmt: skip

    def _turning(self, planner: Planner, pitch: float, rms: float, duration: float) -> tuple[Sway, ...]:
        harmonics = np.array([1.0, 2.0, 3.0])
        share = rms * math.sqrt(2.0) * np.array([1.0, 0.3, 0.15])
        tones = tuple(
            Sway(
                axis,
                Waves(share * size, pitch * harmonics, planner.rng.uniform(0, 6.28, 3), duration, 2.0),
                0,
            )
            for axis, size in zip(np.eye(3), (1.0, 0.6, 0.5), strict=True)
        )
        return tones + planner.shake(0.1 * rms, (15.0, 45.0), 6, duration)

    def _rocking(self, planner: Planner, pitch: float, rms: float, duration: float) -> tuple[Turn, ...]:
        swing = np.array([rms / (2.0 * math.pi * pitch) ** 2])
        phase = planner.rng.uniform(0.0, 6.28, 1)
        return (Turn(any_direction(planner.rng), Waves(swing, np.array([pitch]), phase, duration, 2.0)),)


class Mattress(Activity, frozen=True, kw_only=True, tag="mattress"):
    """On a bed beside a sleeper: breathing tilts it, turning over shifts it."""

    breath_hz: Span = (0.2, 0.3)
    breath_rad: Span = (2e-4, 2e-3)
    shift_s: Span = (300.0, 2400.0)

    def perform(self, planner: Planner) -> None:
        """Lay pieces of breathing, with shifts when the sleeper turns over."""
        rng = planner.rng
        end = planner.t + drawn(self.duration_s, rng)
        planner.turn_to(lying(SUPPORTS["cushion"], rng))
        while planner.t < end:
            duration = max(min(log_drawn(self.shift_s, rng), end - planner.t), 10.0)
            planner.move(duration, self.name, turns=self._breathing(planner, duration))
            planner.turn_to(tilted(planner.attitude, 0.15, rng), self.name, lift=0.01)

    def _breathing(self, planner: Planner, duration: float) -> tuple[Turn, ...]:
        rng = planner.rng
        pitch, depth = drawn(self.breath_hz, rng), drawn(self.breath_rad, rng)
        frequency = pitch * np.array([1.0, 1.03, 0.96, 2.0])
        amplitude = depth * np.array([1.0, 0.4, 0.4, 0.2])
        return (
            Turn(any_direction(rng), Waves(amplitude, frequency, rng.uniform(0, 6.28, 4), duration, 3.0)),
        )
