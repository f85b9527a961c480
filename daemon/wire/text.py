"""The text form of the wire: lines that a microcontroller prints and reads without any library.

Pure functions on one line each, and the clock that unwraps a counter of microseconds; docs/wire.md has
the grammar. Values are SI. A line may end in `*` and four hexadecimal digits: CRC-16/IBM-3740 of all
before the `*` (polynomial 0x1021, start 0xFFFF, no reflection).
"""

from __future__ import annotations

import binascii
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import msgspec

from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.calib_core.streams import limits
from stillcal.calib_core.streams.events import Charging, End, Location, Temperature, Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.wire.frames import parse_hello
from stillcal.daemon.wire.messages import (
    SEQUENCE_MASK,
    Grant,
    Hello,
    Identify,
    Message,
    Rate,
    Status,
    within_limits,
)

MAX_LINE = 4096
"""Longest line, bytes without its end."""

LETTERS = {Sensor.ACCELEROMETER: "A", Sensor.GYROSCOPE: "G"}
SENSORS = {letter.encode(): sensor for sensor, letter in LETTERS.items()}
COUNTER = 1 << 32
"""us: where a time stamp starts again from 0, as Arduino's micros() of 32 bits does."""

MOST_MICROS = int(limits.STAMP_S * 1e6)
LATE = 10_000_000
"""Lines up to this much older than a wrap of the counter belong before the wrap, us."""


class LineError(ValueError):
    """The line is not a valid message."""


class Row(NamedTuple):
    """One sample of a line: t in s, xyz in SI, temperature in degC or None, sequence number or None."""

    sensor: Sensor
    t: float
    xyz: tuple[float, float, float]
    temperature: float | None
    sequence: int | None


@dataclass(slots=True)
class MicrosClock:
    """Converts stamps from us to s and unwraps a 32-bit counter (which wraps every 71.6 minutes).

    A stamp that falls back by more than half the counter's range is a wrap; one beyond 32 bits shows that
    the counter is wider. Lines must come in time order to within LATE. No time is beyond limits.STAMP_S:
    a counter said to wrap that often begins at 0 again.
    """

    last: int = 0
    epoch: int = 0

    def seconds(self, field: bytes) -> float:
        """Return the time in s. Raises ValueError on what is no non-negative integer."""
        micros = int(field)
        if not 0 <= micros <= MOST_MICROS:
            raise ValueError("not a time in us")
        if micros >= COUNTER:
            self.last, self.epoch = micros, 0
        elif self.epoch and micros - self.last > COUNTER - LATE:
            return (micros + self.epoch - COUNTER) / 1e6
        else:
            if self.last < COUNTER and self.last - micros > COUNTER // 2:
                self.epoch = self.epoch + COUNTER if self.epoch <= MOST_MICROS - 2 * COUNTER else 0
            self.last = micros
        return (micros + self.epoch) / 1e6


def crc16(text: bytes) -> int:
    """Return CRC-16/IBM-3740, also known as CRC-16/CCITT-FALSE."""
    return binascii.crc_hqx(text, 0xFFFF)


def checked(line: bytes) -> bytes:
    """Return a line without its CRC, if it has one. Raises LineError where that is wrong.

    What ends in a brace is a hello without a CRC, whatever its claims contain.
    """
    text, star, digits = line.rpartition(b"*")
    if not star or line.endswith(b"}"):
        return line
    if len(digits) != 4 or digits.upper() != b"%04X" % crc16(text):
        raise LineError("CRC")
    return text


def parse_line(line: bytes, clock: MicrosClock) -> Row | Message:
    """Read one line without its end; `clock` goes on with it. Raises LineError."""
    text = checked(line)
    word, _, rest = text.partition(b",")
    try:
        if word[:1] in SENSORS:
            return _row(word, rest, clock)
        return within_limits(_READERS[word](rest, clock))
    except (ValueError, KeyError, OverflowError, TypeError) as error:
        raise LineError(f"{type(error).__name__}: {error}") from None


def line_of(message: Message) -> bytes:
    """Return a message other than samples as a line, with end and CRC; times are rounded to 1 us."""
    return _ended(_WRITERS[type(message)](message))


def sample_lines(samples: Samples, sequence: int) -> Iterator[bytes]:
    """Yield a line for each sample, numbered from `sequence`, with end and CRC; stamps rounded to 1 us."""
    letter = LETTERS[samples.sensor]
    warm = None if samples.temperature is None else samples.temperature.tolist()
    for i, (t, (x, y, z)) in enumerate(zip(samples.t.tolist(), samples.xyz.tolist(), strict=True)):
        tail = "" if warm is None else f",{warm[i]!r}"
        number = (sequence + i) & SEQUENCE_MASK
        yield _ended(f"{letter}{number},{_micros(t)},{x!r},{y!r},{z!r}{tail}")


def _number(field: bytes) -> float:
    value = float(field)
    if not math.isfinite(value) or b"_" in field:
        raise ValueError("not a finite number")
    return value


def _row(word: bytes, rest: bytes, clock: MicrosClock) -> Row:
    stamp, *fields = rest.split(b",")
    x, y, z, *more = map(_number, fields)
    if len(more) > 1:
        raise ValueError("too many fields")
    if max(abs(x), abs(y), abs(z)) > limits.READING:
        raise ValueError("a reading is out of range")
    celsius = more[0] if more and limits.within("celsius", more[0]) else None
    sequence = int(word[1:]) & SEQUENCE_MASK if len(word) > 1 else None
    return Row(SENSORS[word[:1]], clock.seconds(stamp), (x, y, z), celsius, sequence)


def _temperature(rest: bytes, clock: MicrosClock) -> Message:
    stamp, celsius = rest.split(b",")
    return Temperature(clock.seconds(stamp), _number(celsius))


def _event(rest: bytes, clock: MicrosClock) -> Message:
    stamp, kind, *fields = rest.split(b",")
    build = _EVENTS[kind]
    values = [_number(field) for field in fields]
    return build(clock.seconds(stamp), *values)


def _status(rest: bytes, clock: MicrosClock) -> Message:
    stamp, on_time, sensing, wakeups = rest.split(b",")
    return Status(clock.seconds(stamp), _number(on_time), bool(int(sensing)), int(wakeups))


def _hello(rest: bytes, clock: MicrosClock) -> Message:
    return parse_hello(rest)


def _identify(rest: bytes, clock: MicrosClock) -> Message:
    if rest:
        raise ValueError("takes no field")
    return Identify()


def _until(make: Callable[[float], Message]) -> Callable[[bytes, MicrosClock], Message]:
    def read(rest: bytes, clock: MicrosClock) -> Message:
        return make(_number(rest) / 1e6 if rest else math.inf)

    return read


_EVENTS: dict[bytes, Callable[..., Message]] = {
    b"charging": lambda t, on: Charging(t, bool(on)),
    b"location": lambda t, latitude, longitude, altitude=None: Location(t, latitude, longitude, altitude),
    b"tick": Tick,
    b"end": End,
}
_READERS: dict[bytes, Callable[[bytes, MicrosClock], Message]] = {
    b"T": _temperature,
    b"E": _event,
    b"S": _status,
    b"H": _hello,
    b"sense": _until(Sense),
    b"sleep": _until(Sleep),
    b"grant": _until(Grant),
    b"rate": lambda rest, clock: Rate(_number(rest)),
    b"identify": _identify,
}


def _micros(t: float) -> str:
    return f"{t * 1e6:.0f}"


def _place(event: Location) -> str:
    altitude = "" if event.altitude is None else f",{event.altitude!r}"
    return f"E,{_micros(event.t)},location,{event.latitude!r},{event.longitude!r}{altitude}"


def _command(word: str, until: float) -> str:
    return word if math.isinf(until) else f"{word},{_micros(until)}"


_WRITERS: dict[type, Callable[..., str]] = {
    Temperature: lambda m: f"T,{_micros(m.t)},{m.celsius!r}",
    Charging: lambda m: f"E,{_micros(m.t)},charging,{int(m.on)}",
    Location: _place,
    Tick: lambda m: f"E,{_micros(m.t)},tick",
    End: lambda m: f"E,{_micros(m.t)},end",
    Status: lambda m: f"S,{_micros(m.t)},{m.on_time!r},{int(m.sensing)},{m.wakeups}",
    Hello: lambda m: f"H,{msgspec.json.encode(m).decode()}",
    Sense: lambda m: _command("sense", m.until),
    Sleep: lambda m: _command("sleep", m.until),
    Grant: lambda m: _command("grant", m.until),
    Rate: lambda m: f"rate,{m.hz!r}",
    Identify: lambda m: "identify",
}


def _ended(text: str) -> bytes:
    line = text.encode()
    return b"%b*%04X\n" % (line, crc16(line))
