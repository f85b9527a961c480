"""The wire, both ways, sans-I/O: bytes in, messages out, and back. Nothing here opens anything.

Binary frames and lines of text may come mixed on one line (a bootloader's chatter before the firmware's
frames); docs/wire.md says how they are told apart. Whatever comes in, nothing raises, memory stays
bounded, and what a frame of intact bytes held is delivered exactly once, in order.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from enum import Enum, auto

from stillcal.calib_core.samples import Samples, Sensor, frozen
from stillcal.daemon.wire_blocks import Coding
from stillcal.daemon.wire_cobs import MARKER, MARKERS, MAX_FRAME, FrameError, unframed
from stillcal.daemon.wire_encoder import MESSAGES, Form, WireEncoder, WireSettings
from stillcal.daemon.wire_frames import Frame, PayloadError, parse_payload
from stillcal.daemon.wire_messages import (
    SEQUENCE_MASK,
    VERSION,
    Claim,
    Command,
    Grant,
    Hello,
    Identify,
    Message,
    Rate,
    Status,
    Temperature,
)
from stillcal.daemon.wire_text import MAX_LINE, LineError, MicrosClock, Row, parse_line

__all__ = [
    "VERSION",
    "Claim",
    "Coding",
    "Command",
    "Form",
    "Grant",
    "Hello",
    "Identify",
    "Message",
    "Rate",
    "Status",
    "Temperature",
    "WireCounters",
    "WireDecoder",
    "WireEncoder",
    "WireSettings",
]

PRINTABLE = bytes(range(0x20, 0x7F)) + b"\t"


@dataclass(slots=True)
class WireCounters:
    """What a decoder has met since it was made.

    bytes: all that came. frames, lines: good ones. samples: delivered. bad_frames: frames dropped, of
    which crc_errors were well formed otherwise. bad_lines: printable lines that say nothing or whose CRC
    is wrong. malformed: frames with a right CRC that make no sense. foreign: frames of another version of
    the wire. truncated: frames or lines cut off by the end of a connection. garbage_bytes: in all of
    these, and between them. resynchronisations: returns to a good frame or line after any of these.
    lost_samples, lost_messages: by sequence number. invalid_samples: dropped, as not finite or running
    back in time. restarts: sequences that began anew.
    """

    bytes: int = 0
    frames: int = 0
    lines: int = 0
    samples: int = 0
    bad_frames: int = 0
    crc_errors: int = 0
    bad_lines: int = 0
    malformed: int = 0
    foreign: int = 0
    truncated: int = 0
    garbage_bytes: int = 0
    resynchronisations: int = 0
    lost_samples: int = 0
    lost_messages: int = 0
    invalid_samples: int = 0
    restarts: int = 0


class _Mode(Enum):
    """Where the decoder is: at a segment's start, in a frame, in a line, in a line that is too long."""

    START = auto()
    FRAME = auto()
    LINE = auto()
    SKIP = auto()


class WireDecoder:
    """Feed it what arrives, however it is cut; it returns the messages that are whole by then.

    Samples of consecutive lines of text come as one run a sensor, so only their cutting into runs
    depends on the cutting of the bytes. form: how the other side spoke last, None before it did.
    """

    def __init__(self) -> None:
        self.counters = WireCounters()
        self.form: Form | None = None
        self._mode = _Mode.START
        self._parts: list[bytes] = []
        self._held = 0
        self._astray = False
        self._out: list[Message] = []
        self._rows: dict[Sensor, list[Row]] = {Sensor.GYROSCOPE: [], Sensor.ACCELEROMETER: []}
        self._clock = MicrosClock()
        self._expected: dict[str, int] = {}
        self._session: int | None = None

    def feed(self, data: bytes) -> list[Message]:
        """Take bytes as they arrived and return the messages they complete, in order."""
        self.counters.bytes += len(data)
        *closed, rest = data.split(b"\0")
        for piece in closed:
            self._extend(piece)
            self._close()
        self._extend(rest)
        return self._taken()

    def end(self) -> list[Message]:
        """Note that the connection is over: half a frame or line at its end is dropped and counted."""
        if self._held or self._mode is _Mode.SKIP:
            self.counters.truncated += 1
            self._discard(self._held)
        self._begin(_Mode.START)
        return self._taken()

    def snapshot(self) -> WireCounters:
        """Return a copy of the counters."""
        return dataclasses.replace(self.counters)

    # Cutting. A segment reaches from one 0x00 to the next; one that begins with a marker is a frame, any
    # other is lines. `_parts` are the pieces of the unfinished frame or line, `_held` is their length.

    def _begin(self, mode: _Mode, *parts: bytes) -> None:
        self._mode, self._parts = mode, list(parts)
        self._held = sum(map(len, parts))

    def _extend(self, piece: bytes) -> None:
        if not piece:
            return
        if self._mode is _Mode.START:
            self._mode = _Mode.FRAME if piece[0] in MARKERS else _Mode.LINE
        if self._mode is not _Mode.FRAME:
            self._extend_lines(piece)
            return
        self._parts.append(piece)
        self._held += len(piece)
        if self._held > MAX_FRAME:
            self._overflow(b"".join(self._parts))

    def _overflow(self, body: bytes) -> None:
        """Give up a frame that does not end, and go on reading lines."""
        self._bad_frame(body[:MAX_FRAME])
        last = body.rfind(b"\n", 0, MAX_FRAME) + 1
        self._begin(_Mode.LINE if last else _Mode.SKIP)
        self._extend_lines(body[last or MAX_FRAME :])

    def _extend_lines(self, piece: bytes) -> None:
        first, *more = piece.split(b"\n")
        if more:
            self._end_line(first)
            for line in more[:-1]:
                self._line(line)
        tail = more[-1] if more else first
        if self._mode is _Mode.SKIP:
            self._discard(len(tail))
            return
        self._parts.append(tail)
        self._held += len(tail)
        if self._held > MAX_LINE:
            self._bad_line(b"".join(self._parts))
            self._begin(_Mode.SKIP)

    def _end_line(self, rest: bytes) -> None:
        if self._mode is _Mode.SKIP:
            self._discard(len(rest))
        else:
            self._line(b"".join([*self._parts, rest]))
        self._begin(_Mode.LINE)

    def _close(self) -> None:
        """End the segment: a frame is whole; what stands where a line began is a piece of one."""
        if self._mode is _Mode.FRAME:
            self._frame(b"".join(self._parts))
        elif self._held:
            self.counters.bad_frames += 1
            self._discard(self._held)
        self._begin(_Mode.START)

    # Judging

    def _frame(self, body: bytes) -> None:
        try:
            payload = unframed(body[1:])
        except FrameError as error:
            self.counters.crc_errors += error.crc
            self._bad_frame(body)
            return
        if body[0] != MARKER:
            self.counters.foreign += 1
            self._discard(len(body))
            return
        try:
            frame = parse_payload(payload)
        except PayloadError:
            self.counters.malformed += 1
            self._discard(len(body))
            return
        self._good(Form.BINARY)
        self.counters.frames += 1
        self._deliver(frame)

    def _bad_frame(self, body: bytes) -> None:
        """Drop a frame, but not the whole lines within: half a frame may swallow them."""
        self.counters.bad_frames += 1
        first, *lines = body.split(b"\n")
        self._discard(len(first) + (len(lines[-1]) if lines else 0))
        for line in lines[:-1]:
            self._line(line, doubtful=True)

    def _line(self, line: bytes, doubtful: bool = False) -> None:
        """Take a whole line. doubtful: it may as well be part of a broken frame, so it is no bad line."""
        text = line.strip(b" \t\r")
        if not text or (text.startswith(b"#") and _printable(text)):
            return
        try:
            told = parse_line(text, self._clock) if len(line) <= MAX_LINE else None
        except LineError:
            told = None
        if told is None:
            self._discard(len(line)) if doubtful else self._bad_line(line)
            return
        self._good(Form.TEXT)
        self.counters.lines += 1
        if isinstance(told, Row):
            self._add(told)
        else:
            self._say(told)

    def _bad_line(self, line: bytes) -> None:
        self.counters.bad_lines += _printable(line[:MAX_LINE].strip(b" \t\r"))
        self._discard(len(line))

    def _discard(self, count: int) -> None:
        self.counters.garbage_bytes += count
        self._astray = self._astray or count > 0

    def _good(self, form: Form) -> None:
        self.form = form
        self.counters.resynchronisations += self._astray
        self._astray = False

    # Delivering

    def _deliver(self, frame: Frame) -> None:
        if isinstance(frame.message, Samples):
            self._flush()
            self.counters.invalid_samples += frame.invalid
            self.counters.samples += len(frame.message)
            lost = self._gap(frame.message.sensor, frame.sequence, frame.counted)
            self.counters.lost_samples += lost
            if len(frame.message):
                self._out.append(frame.message)
            return
        self._say(frame.message)
        self.counters.lost_messages += self._gap(MESSAGES, frame.sequence, 1)

    def _say(self, message: Message) -> None:
        self._flush()
        if isinstance(message, Hello):
            self._meet(message.session)
        self._out.append(message)

    def _meet(self, session: int) -> None:
        """Expect the numbers of a new session to begin at 0."""
        if self._session not in (None, session):
            self.counters.restarts += 1
            self._expected = dict.fromkeys((*Sensor, MESSAGES), 0)
            self._clock = MicrosClock()
        self._session = session

    def _gap(self, stream: str, sequence: int, count: int) -> int:
        """Return how many numbers of the stream are missing before `sequence`."""
        gap = (sequence - self._expected.get(stream, sequence)) & SEQUENCE_MASK
        self._expected[stream] = (sequence + count) & SEQUENCE_MASK
        if gap > SEQUENCE_MASK // 2:
            self.counters.restarts += 1
            return 0
        return gap

    def _add(self, row: Row) -> None:
        if row.sequence is not None:
            self.counters.lost_samples += self._gap(row.sensor, row.sequence, 1)
        rows = self._rows[row.sensor]
        if rows and (row.t < rows[-1].t or (row.temperature is None) != (rows[-1].temperature is None)):
            self._flush()
        self._rows[row.sensor].append(row)

    def _flush(self) -> None:
        for sensor, rows in self._rows.items():
            if rows:
                self.counters.samples += len(rows)
                self._out.append(_run(sensor, rows))
                self._rows[sensor] = []

    def _taken(self) -> list[Message]:
        self._flush()
        out, self._out = self._out, []
        return out


def _printable(line: bytes) -> bool:
    return not line.translate(None, PRINTABLE)


def _run(sensor: Sensor, rows: list[Row]) -> Samples:
    celsius = [r.temperature for r in rows if r.temperature is not None]
    warm = frozen(celsius) if celsius else None
    return Samples(sensor, frozen([r.t for r in rows]), frozen([r.xyz for r in rows]), warm)
