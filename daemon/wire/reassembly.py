"""Put decoded messages in order: runs of samples, missing sequence numbers, new sessions.

Takes whole frames and rows from decoder.py, returns messages in order, and counts errors and losses.
"""

from __future__ import annotations

from dataclasses import dataclass

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.wire.encoder import MESSAGES
from stillcal.daemon.wire.frames import Frame
from stillcal.daemon.wire.messages import SEQUENCE_MASK, Hello, Message
from stillcal.daemon.wire.text import MicrosClock, Row


@dataclass(slots=True)
class WireCounters:
    """The decoder's counters since it was created.

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


class WireDelivery:
    """Collects messages until they are taken. clock: converts stamps of lines in microseconds."""

    def __init__(self, counters: WireCounters) -> None:
        self.clock = MicrosClock()
        self._counters = counters
        self._out: list[Message] = []
        self._rows: dict[Sensor, list[Row]] = {Sensor.GYROSCOPE: [], Sensor.ACCELEROMETER: []}
        self._expected: dict[str, int] = {}
        self._session: int | None = None

    def deliver(self, frame: Frame) -> None:
        """Add a valid frame."""
        if isinstance(frame.message, Samples):
            self._flush()
            self._counters.invalid_samples += frame.invalid
            self._counters.samples += len(frame.message)
            lost = self._gap(frame.message.sensor, frame.sequence, frame.counted)
            self._counters.lost_samples += lost
            if len(frame.message):
                self._out.append(frame.message)
            return
        self.add_message(frame.message)
        self._counters.lost_messages += self._gap(MESSAGES, frame.sequence, 1)

    def add_message(self, message: Message) -> None:
        """Add a message other than samples."""
        self._flush()
        if isinstance(message, Hello):
            self._on_session(message.session)
        self._out.append(message)

    def add_row(self, row: Row) -> None:
        """Add one sample from a line of text."""
        if row.sequence is not None:
            self._counters.lost_samples += self._gap(row.sensor, row.sequence, 1)
        rows = self._rows[row.sensor]
        if rows and (row.t < rows[-1].t or (row.temperature is None) != (rows[-1].temperature is None)):
            self._flush()
        self._rows[row.sensor].append(row)

    def take(self) -> list[Message]:
        """Return the messages since the last call, in order."""
        self._flush()
        out, self._out = self._out, []
        return out

    def _on_session(self, session: int) -> None:
        """Expect the sequence numbers of a new session to start at 0."""
        if self._session not in (None, session):
            self._counters.restarts += 1
            self._expected = dict.fromkeys((*Sensor, MESSAGES), 0)
            self.clock = MicrosClock()
        self._session = session

    def _gap(self, stream: str, sequence: int, count: int) -> int:
        """Return how many numbers of the stream are missing before `sequence`."""
        gap = (sequence - self._expected.get(stream, sequence)) & SEQUENCE_MASK
        self._expected[stream] = (sequence + count) & SEQUENCE_MASK
        if gap > SEQUENCE_MASK // 2:
            self._counters.restarts += 1
            return 0
        return gap

    def _flush(self) -> None:
        for sensor, rows in self._rows.items():
            if rows:
                self._counters.samples += len(rows)
                self._out.append(_run(sensor, rows))
                self._rows[sensor] = []


def _run(sensor: Sensor, rows: list[Row]) -> Samples:
    celsius = [r.temperature for r in rows if r.temperature is not None]
    warm = frozen(celsius) if celsius else None
    return Samples(sensor, frozen([r.t for r in rows]), frozen([r.xyz for r in rows]), warm)
