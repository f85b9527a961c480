"""The decoder of the wire, sans-I/O: bytes in, messages out.

Binary frames and lines of text may come mixed on one line (a bootloader's chatter before the firmware's
frames); docs/wire.md says how they are told apart. They are cut and checked here, and put in order in
reassembly.py. Whatever comes in, nothing raises, memory stays bounded, and what a frame of intact bytes
held is delivered exactly once, in order.
"""

from __future__ import annotations

import dataclasses
from enum import Enum, auto

from stillcal.daemon.wire.cobs import MARKER, MARKERS, MAX_FRAME, FrameError, unframed
from stillcal.daemon.wire.encoder import Form
from stillcal.daemon.wire.frames import PayloadError, parse_payload
from stillcal.daemon.wire.messages import Message
from stillcal.daemon.wire.reassembly import WireCounters, WireDelivery
from stillcal.daemon.wire.text import MAX_LINE, LineError, Row, parse_line

PRINTABLE = bytes(range(0x20, 0x7F)) + b"\t"


class _Mode(Enum):
    """The decoder's state: at a segment's start, in a frame, in a line, in a line that is too long."""

    START = auto()
    FRAME = auto()
    LINE = auto()
    SKIP = auto()


class WireDecoder:
    """Turns bytes, however they are cut, into the messages that they complete.

    Samples of consecutive lines of text come as one run a sensor, so only their cutting into runs
    depends on the cutting of the bytes. form: how the other side spoke last, None before it did.
    """

    def __init__(self) -> None:
        self.counters = WireCounters()
        self.form: Form | None = None
        self._mode = _Mode.START
        self._parts: list[bytes] = []
        self._held = 0
        self._out_of_sync = False
        self._delivery = WireDelivery(self.counters)

    def feed(self, data: bytes) -> list[Message]:
        """Take bytes as they arrived and return the messages they complete, in order."""
        self.counters.bytes += len(data)
        *closed, rest = data.split(b"\0")
        for piece in closed:
            self._extend(piece)
            self._close()
        self._extend(rest)
        return self._delivery.take()

    def end(self) -> list[Message]:
        """End the connection: an unfinished frame or line is dropped and counted."""
        if self._held or self._mode is _Mode.SKIP:
            self.counters.truncated += 1
            self._discard(self._held)
        self._begin(_Mode.START)
        return self._delivery.take()

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
        """Give up a frame that is too long, and continue with lines."""
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
        """End a segment: a frame is complete; anything else is an unfinished line and is dropped."""
        if self._mode is _Mode.FRAME:
            self._frame(b"".join(self._parts))
        elif self._held:
            self.counters.bad_frames += 1
            self._discard(self._held)
        self._begin(_Mode.START)

    # Decoding

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
        self._in_sync_again(Form.BINARY)
        self.counters.frames += 1
        self._delivery.deliver(frame)

    def _bad_frame(self, body: bytes) -> None:
        """Drop a bad frame, but keep complete lines in it: a frame without its end includes what follows."""
        self.counters.bad_frames += 1
        first, *lines = body.split(b"\n")
        self._discard(len(first) + (len(lines[-1]) if lines else 0))
        for line in lines[:-1]:
            self._line(line, doubtful=True)

    def _line(self, line: bytes, doubtful: bool = False) -> None:
        """Decode a complete line. doubtful: it may be part of a broken frame, and is not counted as bad."""
        text = line.strip(b" \t\r")
        if not text or (text.startswith(b"#") and _printable(text)):
            return
        try:
            message = parse_line(text, self._delivery.clock) if len(line) <= MAX_LINE else None
        except LineError:
            message = None
        if message is None:
            self._discard(len(line)) if doubtful else self._bad_line(line)
            return
        self._in_sync_again(Form.TEXT)
        self.counters.lines += 1
        if isinstance(message, Row):
            self._delivery.add_row(message)
        else:
            self._delivery.add_message(message)

    def _bad_line(self, line: bytes) -> None:
        self.counters.bad_lines += _printable(line[:MAX_LINE].strip(b" \t\r"))
        self._discard(len(line))

    def _discard(self, count: int) -> None:
        self.counters.garbage_bytes += count
        self._out_of_sync = self._out_of_sync or count > 0

    def _in_sync_again(self, form: Form) -> None:
        self.form = form
        self.counters.resynchronisations += self._out_of_sync
        self._out_of_sync = False


def _printable(line: bytes) -> bool:
    return not line.translate(None, PRINTABLE)
