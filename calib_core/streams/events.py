"""Events: the engine's input besides samples, on the sensor's own time.

They are plain records with the tags of a recording's events file, so that they can be saved with the engine's
state.
"""

from __future__ import annotations

import msgspec


class Charging(msgspec.Struct, frozen=True, tag_field="event", tag="charging"):
    """The charger was plugged in (on) or unplugged at t (s)."""

    t: float
    on: bool


class Location(msgspec.Struct, frozen=True, tag_field="event", tag="location"):
    """The phone's place became known at t (s). latitude, longitude: deg. altitude: m or None."""

    t: float
    latitude: float
    longitude: float
    altitude: float | None = None


class Temperature(msgspec.Struct, frozen=True, tag_field="event", tag="temperature"):
    """A thermometer's reading at t (s). celsius: degC."""

    t: float
    celsius: float


class Tick(msgspec.Struct, frozen=True, tag_field="event", tag="tick"):
    """Time has reached t (s), and no earlier sample is still on its way: the clock of a sleeping phone."""

    t: float


class End(msgspec.Struct, frozen=True, tag_field="event", tag="end"):
    """The stream ends at t (s): open rests are closed, and a calibration is tried where one is due."""

    t: float


Event = Charging | Location | Temperature | Tick | End
