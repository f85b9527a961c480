"""What goes into the engine besides samples, and what comes out of it.

Events tell of the phone's world on the sensor's own time; actions are what the engine wants done. Both
are plain records: nothing here does anything. Events are tagged as they stand in a
recording's events file, and so can be saved with the engine's state.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import msgspec

from stillcal.calib_core.record import CalibrationRecord
from stillcal.calib_core.stillness_settings import Sense, Sleep


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


class Level(StrEnum):
    """How much a log line matters; the names are syslog's."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"


@dataclass(frozen=True, slots=True)
class Log:
    """Something a person may want to know: what (a stable name), why (a sentence), and figures."""

    t: float
    level: Level
    what: str
    why: str
    fields: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Store:
    """Keep this calibration as the current one, with the reason it was accepted."""

    t: float
    record: CalibrationRecord
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Reject:
    """Record that this candidate was fitted and not taken, and why."""

    t: float
    record: CalibrationRecord
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Forget:
    """The current calibration is of another phone: it is current no longer. Why is the reason."""

    t: float
    record: CalibrationRecord
    reason: str


@dataclass(frozen=True, slots=True)
class Diagnose:
    """Calibrating anew does not help: somebody should look for what the model leaves out. Asked once."""

    t: float
    reason: str


Action = Sense | Sleep | Log | Store | Reject | Forget | Diagnose
