"""The messages of the wire as plain records: the phone's records and the daemon's commands.

Samples, events, Sense and Sleep are the engine's own records; here are the others. No bytes here:
frames.py (binary) and text.py (lines) say how a record looks on the wire.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, Any, Literal

import msgspec

from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.calib_core.streams import limits
from stillcal.calib_core.streams.events import Charging, End, Location, Temperature, Tick
from stillcal.calib_core.streams.samples import Samples

VERSION = 1
"""The version of the wire protocol (docs/wire.md)."""

SEQUENCE_MASK = 0xFFFFFFFF
"""Sequence numbers are 32 bits and wrap."""

Claim = str | float | bool | None | list[float]


class Hello(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The device identifies itself. version: of the wire. session: a number that changes at each start.

    flow: "credit" for a phone that waits for grants (an accelerated simulation), "free" for a real one.
    claims: the maker's data, under the names of a recording's NAME.json, SI units.
    """

    version: Annotated[int, msgspec.Meta(ge=0, le=SEQUENCE_MASK)] = VERSION
    session: Annotated[int, msgspec.Meta(ge=0, le=SEQUENCE_MASK)] = 0
    flow: Literal["free", "credit"] = "free"
    claims: dict[str, Claim] = {}


@dataclass(frozen=True, slots=True)
class Status:
    """The phone's totals since it started. t: its time, s; on_time: s with the sensors on.

    sensing: whether they are on now. wakeups: how often they were switched on.
    """

    t: float
    on_time: float
    sensing: bool
    wakeups: int


@dataclass(frozen=True, slots=True)
class Rate:
    """Sample both sensors at `hz`, or as close as the device can."""

    hz: float


@dataclass(frozen=True, slots=True)
class Grant:
    """Credit: the phone's time may go on to `until` (s). For phones whose flow is "credit"."""

    until: float


@dataclass(frozen=True, slots=True)
class Identify:
    """Ask for a hello and the present time: sent whenever the daemon has opened the line."""


PhoneMessage = Samples | Charging | Location | Tick | End | Temperature | Status | Hello
"""Messages from the phone."""

Command = Sense | Sleep | Rate | Grant | Identify
"""Messages from the daemon."""

Message = PhoneMessage | Command


def within_limits(message: Message) -> Message:
    """Return a message that is no samples as it is. Raises ValueError where a number is beyond its limits."""
    limits.check_ranges({name: getattr(message, name) for name in _field_names(message)})
    return message


def _field_names(message: Any) -> tuple[str, ...]:
    if is_dataclass(message):
        return tuple(field.name for field in fields(message))
    names: tuple[str, ...] = message.__struct_fields__
    return names
