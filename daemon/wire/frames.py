"""The payload of a frame: encode and decode each message. Pure functions, no state.

sample_blocks.py has the payloads of samples; docs/wire.md has every layout.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec

from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.calib_core.streams.events import Charging, End, Location, Temperature, Tick
from stillcal.daemon.wire.messages import Grant, Hello, Identify, Message, Rate, Status, within_limits
from stillcal.daemon.wire.sample_blocks import HEADER, SENSORS, parse_samples

HELLO = 0x20
MAX_HELLO = 4096
"""Longest JSON of a hello, bytes."""


class PayloadError(ValueError):
    """The payload's CRC is right but its content is not valid."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A decoded frame: its message, the sender's sequence number, and rows that had to be dropped.

    sequence: of the first sample in its stream, or of the message among all that are not samples.
    counted: how many numbers the frame takes up. invalid: samples that were not finite or ran backwards.
    """

    message: Message
    sequence: int
    counted: int = 1
    invalid: int = 0


# Messages that are not samples: kind, layout, and how fields become a record and back


@dataclass(frozen=True, slots=True)
class _Layout:
    kind: int
    fields: struct.Struct
    build: Callable[..., Message]
    take: Callable[[Any], tuple[float | int, ...]]


def _location(t: float, latitude: float, longitude: float, altitude: float) -> Location:
    return Location(t, latitude, longitude, altitude if math.isfinite(altitude) else None)


def _layout(
    kind: int, fields: str, build: Callable[..., Message], take: Callable[[Any], tuple[float | int, ...]]
) -> _Layout:
    return _Layout(kind, struct.Struct("<" + fields), build, take)


_LAYOUTS: dict[type, _Layout] = {
    Temperature: _layout(0x10, "dd", Temperature, lambda m: (m.t, m.celsius)),
    Charging: _layout(0x11, "dB", lambda t, on: Charging(t, bool(on)), lambda m: (m.t, m.on)),
    Location: _layout(
        0x12,
        "dddd",
        _location,
        lambda m: (m.t, m.latitude, m.longitude, math.nan if m.altitude is None else m.altitude),
    ),
    Tick: _layout(0x13, "d", Tick, lambda m: (m.t,)),
    End: _layout(0x14, "d", End, lambda m: (m.t,)),
    Status: _layout(
        0x21,
        "ddBI",
        lambda t, on_time, sensing, wakeups: Status(t, on_time, bool(sensing), wakeups),
        lambda m: (m.t, m.on_time, m.sensing, m.wakeups),
    ),
    Sense: _layout(0x40, "d", Sense, lambda m: (m.until,)),
    Sleep: _layout(0x41, "d", Sleep, lambda m: (m.until,)),
    Rate: _layout(0x42, "d", Rate, lambda m: (m.hz,)),
    Grant: _layout(0x43, "d", Grant, lambda m: (m.until,)),
    Identify: _layout(0x44, "", Identify, lambda m: ()),
}
_BY_KIND = {layout.kind: layout for layout in _LAYOUTS.values()}


def message_payload(message: Message, sequence: int) -> bytes:
    """Return the payload of a message that is not samples."""
    if isinstance(message, Hello):
        text = msgspec.json.encode(message)
        return HEADER.pack(HELLO, 0, len(text), sequence) + text
    layout = _LAYOUTS[type(message)]
    return HEADER.pack(layout.kind, 0, 0, sequence) + layout.fields.pack(*layout.take(message))


def parse_payload(payload: bytes) -> Frame:
    """Read a payload whose CRC was right. Raises PayloadError where its content is not valid."""
    try:
        kind, form, n, sequence = HEADER.unpack_from(payload)
        if kind in SENSORS:
            samples = parse_samples(SENSORS[kind], form, n, payload)
            return Frame(samples, sequence, n, n - len(samples))
        if kind == HELLO:
            return Frame(parse_hello(payload[HEADER.size :]), sequence)
        layout = _BY_KIND[kind]
        message = layout.build(*layout.fields.unpack(payload[HEADER.size :]))
        return Frame(within_limits(message), sequence)
    except (ValueError, KeyError, struct.error) as error:
        raise PayloadError(f"{type(error).__name__}: {error}") from None


def parse_hello(text: bytes) -> Hello:
    """Read a hello's JSON. Raises ValueError."""
    if len(text) > MAX_HELLO:
        raise ValueError(f"a hello of {len(text)} bytes, at most {MAX_HELLO} are allowed")
    try:
        return msgspec.json.decode(text, type=Hello)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise ValueError(f"not a hello: {error}") from None
