"""Frames as bytes: COBS coding, CRC-32 and delimiters. frames.py says what is inside a frame.

A frame is 0x00, a marker byte that carries the version, COBS(payload + CRC-32), 0x00.

COBS: Cheshire and Baker, Consistent Overhead Byte Stuffing, IEEE/ACM Trans. Networking 7(2), 1999.
"""

from __future__ import annotations

import struct
import zlib

from stillcal.daemon.wire.messages import VERSION

MARKERS = range(0xB0, 0xC0)
"""First byte of a frame: 0xB0 + version, so that no frame begins like a line of text."""

MARKER = MARKERS[VERSION]
MAX_FRAME = 65_536
"""Longest frame, bytes between the delimiters, marker included; longer ones are dropped."""

CRC = struct.Struct("<I")
_CODES = [bytes((length + 1,)) for length in range(254)]


class FrameError(ValueError):
    """The bytes are not a frame. crc: whether only the CRC is wrong."""

    def __init__(self, reason: str, crc: bool = False) -> None:
        super().__init__(reason)
        self.crc = crc


def cobs_encode(data: bytes) -> bytes:
    """Rewrite `data` so that it holds no 0x00; one byte longer, and one more for each 254."""
    parts: list[bytes] = []
    run = b""
    for run in data.split(b"\0"):
        rest = run
        while len(rest) >= 254:
            parts += (b"\xff", rest[:254])
            rest = rest[254:]
        parts += (_CODES[len(rest)], rest)
    if run and len(run) % 254 == 0:
        del parts[-2:]
    return b"".join(parts)


def cobs_decode(data: bytes) -> bytes:
    """Undo cobs_encode. Raises FrameError where `data` is empty, holds 0x00, or ends within a run."""
    end = len(data)
    if not end or 0 in data:
        raise FrameError("empty, or holds the delimiter")
    out, joints, at = bytearray(data), [], 0
    while at < end:
        code = data[at]
        out[at] = 0
        at += code
        if code == 255:
            joints.append(at)
    if at != end:
        raise FrameError("ends within a run")
    for joint in reversed(joints):
        del out[joint : joint + 1]
    return bytes(memoryview(out)[1:])


def framed(payload: bytes) -> bytes:
    """Wrap a payload into a frame, delimiters included."""
    return b"\0%c%b\0" % (MARKER, cobs_encode(payload + CRC.pack(zlib.crc32(payload))))


def unframed(body: bytes) -> bytes:
    """Return the payload of a frame's body (after the marker). Raises FrameError."""
    data = cobs_decode(body)
    if len(data) <= CRC.size:
        raise FrameError("too short")
    payload = data[: -CRC.size]
    if zlib.crc32(payload) != CRC.unpack_from(data, len(payload))[0]:
        raise FrameError("CRC", crc=True)
    return payload
