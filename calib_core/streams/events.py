"""What goes into the engine besides samples: events of the phone's world, on the sensor's own time.

They are plain records. They are tagged as they stand in a recording's events file, and so can be saved with
the engine's state.
"""

from __future__ import annotations

import msgspec


class Charging(msgspec.Struct, frozen=True, tag_field="event", tag="charging"):
    """The charger was plugged in (on) or pulled out. t: s."""

    t: float
    on: bool


class Location(msgspec.Struct, frozen=True, tag_field="event", tag="location"):
    """The phone learned where it is. t: s; latitude, longitude: deg; altitude: m or None."""

    t: float
    latitude: float
    longitude: float
    altitude: float | None = None


class Tick(msgspec.Struct, frozen=True, tag_field="event", tag="tick"):
    """Time has come to t (s) and no sample before it is still on its way: the clock of a sleeping phone."""

    t: float


class End(msgspec.Struct, frozen=True, tag_field="event", tag="end"):
    """The stream is over at t (s); what is open is closed and, where there is cause, calibrated."""

    t: float


Event = Charging | Location | Tick | End
