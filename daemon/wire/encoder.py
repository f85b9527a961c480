"""The encoder of the wire: numbers messages and writes them as frames or as lines."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.wire.cobs import framed
from stillcal.daemon.wire.frames import message_payload
from stillcal.daemon.wire.messages import SEQUENCE_MASK, Message
from stillcal.daemon.wire.sample_blocks import BlockStyle, Coding, sample_payloads
from stillcal.daemon.wire.text import line_of, sample_lines

MESSAGES = "messages"
"""The stream of sequence numbers for all messages that are not samples."""


class Form(StrEnum):
    """The form of messages: binary frames or lines of text."""

    BINARY = "binary"
    TEXT = "text"


@dataclass(frozen=True, slots=True)
class WireSettings:
    """Settings of the encoder. coding: of samples. block: the most samples in a frame.

    accel_unit, gyro_unit: SI value of one count (counts only). tick_ns: unit of time steps, ns (all but
    exact).
    """

    form: Form = Form.BINARY
    coding: Coding = Coding.EXACT
    block: int = 256
    accel_unit: float = 0.0006
    gyro_unit: float = 0.0011
    tick_ns: int = 1000

    def __post_init__(self) -> None:
        if not 1 <= self.block <= 1024:
            raise ValueError(f"block = {self.block}: must be within 1..1024 samples")
        for name in ("accel_unit", "gyro_unit"):
            if not 1e-9 <= getattr(self, name) <= 1e3:
                raise ValueError(f"{name} = {getattr(self, name)}: must be within 1e-9..1e3")
        if not 1 <= self.tick_ns <= 1_000_000:
            raise ValueError(f"tick_ns = {self.tick_ns}: must be within 1..1000000 ns")

    def unit(self, sensor: Sensor) -> float:
        """Return the SI value of one count of a sensor."""
        return self.accel_unit if sensor is Sensor.ACCELEROMETER else self.gyro_unit


class WireEncoder:
    """Turns messages into bytes and numbers them. One for each direction and session."""

    def __init__(self, settings: WireSettings | None = None) -> None:
        self.settings = settings or WireSettings()
        self._next: dict[str, int] = {}

    def encode(self, message: Message) -> bytes:
        """Return a message as bytes: one or more frames or lines."""
        if isinstance(message, Samples):
            sequence = self._number(message.sensor, len(message))
            return b"".join(self._samples(message, sequence))
        if self.settings.form is Form.TEXT:
            return line_of(message)
        return framed(message_payload(message, self._number(MESSAGES, 1)))

    def _number(self, stream: str, count: int) -> int:
        sequence = self._next.get(stream, 0)
        self._next[stream] = (sequence + count) & SEQUENCE_MASK
        return sequence

    def _samples(self, samples: Samples, sequence: int) -> list[bytes]:
        s = self.settings
        if s.form is Form.TEXT:
            return list(sample_lines(samples, sequence))
        style = BlockStyle(s.coding, s.block, s.unit(samples.sensor), s.tick_ns)
        return [framed(payload) for payload in sample_payloads(samples, sequence, style)]
