"""Every byte on the wire is where docs/wire.md says: layouts are packed here by hand, by that page alone."""

from __future__ import annotations

import math
import struct
import zlib

import numpy as np
import pytest

from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.calib_core.streams.events import Charging, End, Location, Temperature, Tick
from stillcal.calib_core.streams.samples import Samples
from stillcal.daemon.wire.cobs import cobs_decode, cobs_encode
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.encoder import Form, WireEncoder, WireSettings
from stillcal.daemon.wire.messages import Grant, Hello, Identify, Message, Rate, Status
from stillcal.daemon.wire.sample_blocks import Coding
from stillcal.daemon.wire.text import crc16
from tests.support.wire_said import A, G, others, same


def header(kind: int, form: int = 0, n: int = 0, sequence: int = 0) -> bytes:
    return struct.pack("<BBHI", kind, form, n, sequence)


def frame(payload: bytes) -> bytes:
    return b"\x00\xb1" + cobs_encode(payload + struct.pack("<I", zlib.crc32(payload))) + b"\x00"


HELLO = b'{"session":9,"claims":{"device":"x"}}'
BODIES: list[tuple[Message, int, bytes]] = [
    (Temperature(1.5, 30.25), 0x10, struct.pack("<dd", 1.5, 30.25)),
    (Charging(1.5, True), 0x11, struct.pack("<dB", 1.5, 1)),
    (Charging(1.5, False), 0x11, struct.pack("<dB", 1.5, 0)),
    (Location(1.5, 52.25, 0.125, 17.5), 0x12, struct.pack("<dddd", 1.5, 52.25, 0.125, 17.5)),
    (Location(1.5, 52.25, 0.125), 0x12, struct.pack("<dddd", 1.5, 52.25, 0.125, math.nan)),
    (Tick(2.5), 0x13, struct.pack("<d", 2.5)),
    (End(2.5), 0x14, struct.pack("<d", 2.5)),
    (Status(2.5, 1.25, True, 70_000), 0x21, struct.pack("<ddBI", 2.5, 1.25, 1, 70_000)),
    (Sense(3.5), 0x40, struct.pack("<d", 3.5)),
    (Sleep(math.inf), 0x41, struct.pack("<d", math.inf)),
    (Rate(104.0), 0x42, struct.pack("<d", 104.0)),
    (Grant(3.5), 0x43, struct.pack("<d", 3.5)),
    (Identify(), 0x44, b""),
]
KINDS = [f"{type(message).__name__} {kind:#x}" for message, kind, _ in BODIES]


@pytest.mark.parametrize(("message", "kind", "body"), BODIES, ids=KINDS)
def test_a_message_is_the_bytes_that_the_page_lists(message: Message, kind: int, body: bytes) -> None:
    encoder = WireEncoder()
    assert encoder.encode(message) == frame(header(kind) + body)
    assert encoder.encode(message) == frame(header(kind, sequence=1) + body)
    assert WireDecoder().feed(frame(header(kind) + body)) == [message]


def test_a_hello_is_json_whose_length_stands_in_the_header() -> None:
    hello = Hello(session=9, claims={"device": "x"})
    assert WireEncoder().encode(hello) == frame(header(0x20, n=len(HELLO)) + HELLO)
    assert WireDecoder().feed(frame(header(0x20, n=len(HELLO)) + HELLO)) == [hello]
    assert WireDecoder().feed(frame(header(0x20, n=2) + b"{}")) == [
        Hello(version=1, session=0, flow="free", claims={})
    ]


LINES: list[tuple[Message, str]] = [
    (Temperature(1.5, 30.25), "T,1500000,30.25"),
    (Charging(1.5, True), "E,1500000,charging,1"),
    (Charging(1.5, False), "E,1500000,charging,0"),
    (Location(1.5, 52.25, 0.125, 17.5), "E,1500000,location,52.25,0.125,17.5"),
    (Location(1.5, 52.25, 0.125), "E,1500000,location,52.25,0.125"),
    (Tick(2.5), "E,2500000,tick"),
    (End(2.5), "E,2500000,end"),
    (Status(2.5, 1.25, True, 3), "S,2500000,1.25,1,3"),
    (Status(2.5, 1.25, False, 3), "S,2500000,1.25,0,3"),
    (Hello(session=9, claims={"device": "x"}), "H," + HELLO.decode()),
    (Sense(3.5), "sense,3500000"),
    (Sense(math.inf), "sense"),
    (Sleep(math.inf), "sleep"),
    (Grant(3.5), "grant,3500000"),
    (Rate(104.0), "rate,104.0"),
    (Identify(), "identify"),
]


@pytest.mark.parametrize(("message", "line"), LINES, ids=[line for _, line in LINES])
def test_a_message_is_the_line_that_the_page_lists(message: Message, line: str) -> None:
    whole = b"%b*%04X\n" % (line.encode(), crc16(line.encode()))
    assert WireEncoder(WireSettings(form=Form.TEXT)).encode(message) == whole
    assert WireDecoder().feed(whole) == [message]
    assert WireDecoder().feed(line.encode() + b"\r\n") == [message]


T = np.array([10.0, 10.001, 10.0025])
XYZ = np.array([[1.0, 2.0, 3.0], [-4.0, 5.5, 6.25], [7.0, 8.0, -9.0]])
WARM, ARRIVED = np.array([20.0, 20.5, 21.0]), np.array([11.0, 11.5, 12.0])


def test_exact_samples_are_columns_of_float64() -> None:
    for sensor, kind in ((A, 0x01), (G, 0x02)):
        payload = header(kind, 0x00, 3) + T.tobytes() + XYZ.tobytes()
        assert WireEncoder().encode(Samples(sensor, T, XYZ)) == frame(payload)
    both = Samples(A, T, XYZ, WARM, ARRIVED)
    columns = T.tobytes() + XYZ.tobytes() + WARM.tobytes() + ARRIVED.tobytes()
    assert WireEncoder().encode(both) == frame(header(0x01, 0x30, 3) + columns)
    arrived = Samples(A, T, XYZ, None, ARRIVED)
    columns = T.tobytes() + XYZ.tobytes() + ARRIVED.tobytes()
    assert WireEncoder().encode(arrived) == frame(header(0x01, 0x20, 3) + columns)
    (back,) = WireDecoder().feed(frame(header(0x01, 0x20, 3) + columns))
    assert isinstance(back, Samples) and same(back, arrived)


@pytest.mark.parametrize(("coding", "form", "unit"), [(Coding.FLOAT, 1, 1.0), (Coding.COUNTS, 2, 0.25)])
def test_compact_samples_are_steps_and_values_of_a_unit(coding: Coding, form: int, unit: float) -> None:
    settings = WireSettings(coding=coding, accel_unit=0.25, gyro_unit=0.5, tick_ns=500_000)
    head = struct.pack("<qIf", 10_000_000_000, 500_000, unit)
    steps = np.array([0, 2, 3], "<u2").tobytes()
    values = XYZ.astype("<f4") if coding is Coding.FLOAT else np.rint(XYZ / 0.25).astype("<i2")
    tail = WARM.astype("<f4").tobytes() + ARRIVED.tobytes()
    payload = header(0x01, form | 0x30, 3) + head + steps + values.tobytes() + tail
    sent = Samples(A, T, XYZ, WARM, ARRIVED)
    assert WireEncoder(settings).encode(sent) == frame(payload)
    (back,) = WireDecoder().feed(frame(payload))
    assert isinstance(back, Samples)
    np.testing.assert_allclose(back.t, T, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(back.xyz, XYZ)
    np.testing.assert_array_equal(back.temperature, WARM)
    np.testing.assert_array_equal(back.t_arrival, ARRIVED)


def test_each_sensor_has_its_own_unit_of_a_count() -> None:
    settings = WireSettings(coding=Coding.COUNTS, accel_unit=0.25, gyro_unit=0.5)
    for sensor, unit in ((A, 0.25), (G, 0.5)):
        payload = cobs_decode(WireEncoder(settings).encode(Samples(sensor, T, XYZ))[2:-1])
        assert struct.unpack_from("<f", payload, 8 + 12) == (unit,)


def test_as_shipped_256_samples_make_an_exact_frame() -> None:
    settings = WireSettings()
    assert (settings.form, settings.coding, settings.block) == (Form.BINARY, Coding.EXACT, 256)
    decoder = WireDecoder()
    t = np.arange(513) * 0.01
    decoder.feed(WireEncoder().encode(Samples(A, t, np.ones((513, 3)))))
    assert (decoder.counters.frames, decoder.counters.samples) == (3, 513)


@pytest.mark.parametrize("ticks", [65_534, 65_536])
def test_a_step_beyond_16_bits_of_ticks_begins_another_block(ticks: int) -> None:
    t = np.array([0.0, 0.001, 0.001 + ticks * 1e-6, 0.002 + ticks * 1e-6])
    decoder = WireDecoder()
    encoder = WireEncoder(WireSettings(coding=Coding.FLOAT, tick_ns=1000))
    came = decoder.feed(encoder.encode(Samples(A, t, np.ones((4, 3)))))
    assert [len(m) for m in came if isinstance(m, Samples)] == ([4] if ticks < 65_535 else [2, 2])
    stamps = np.concatenate([m.t for m in came if isinstance(m, Samples)])
    np.testing.assert_allclose(stamps, t, rtol=0, atol=1e-9)
    assert decoder.counters.lost_samples == 0


@pytest.mark.parametrize(
    ("field", "low", "below", "high", "above"),
    [
        ("block", 1, 0, 1024, 1025),
        ("accel_unit", 1e-9, 0.9e-9, 1e3, 1001.0),
        ("gyro_unit", 1e-9, 0.9e-9, 1e3, 1001.0),
        ("tick_ns", 1, 0, 1_000_000, 1_000_001),
    ],
)
def test_settings_hold_up_to_their_limits(
    field: str, low: float, below: float, high: float, above: float
) -> None:
    for value in (low, high):
        assert getattr(WireSettings(**{field: value}), field) == value  # type: ignore[arg-type]
    for value in (below, above):
        with pytest.raises(ValueError, match=field):
            WireSettings(**{field: value})  # type: ignore[arg-type]


def padded_hello(length: int) -> bytes:
    text = b'{"claims":{"a":"%b"}}' % (b"x" * (length - len(b'{"claims":{"a":""}}')))
    assert len(text) == length
    return text


def test_a_hello_of_4096_bytes_is_read_and_a_longer_one_is_not() -> None:
    decoder = WireDecoder()
    assert len(decoder.feed(frame(header(0x20) + padded_hello(4096)))) == 1
    assert decoder.feed(frame(header(0x20) + padded_hello(4097))) == []
    assert decoder.counters.malformed == 1


def body_of(length: int) -> bytes:
    """Return a frame of `length` bytes between its delimiters: a temperature's kind, and too long for one."""
    size = length - 1 - 4
    while True:
        payload = header(0x10) + b"\x07" * (size - 8)
        body = frame(payload)[1:-1]
        if len(body) == length:
            return body
        size -= len(body) - length


def test_a_frame_of_65536_bytes_is_judged_and_a_longer_one_is_given_up() -> None:
    decoder = WireDecoder()
    decoder.feed(b"\0" + body_of(65_536) + b"\0")
    assert (decoder.counters.malformed, decoder.counters.bad_frames) == (1, 0)
    decoder.feed(b"\0" + body_of(65_537) + b"\0")
    assert (decoder.counters.malformed, decoder.counters.bad_frames) == (1, 1)
    assert decoder.counters.garbage_bytes == 65_536 + 65_537


def test_a_line_of_4096_characters_is_read_and_a_longer_one_is_not() -> None:
    line = b"A,1000,1,2,3"
    decoder = WireDecoder()
    assert len(decoder.feed(line.rjust(4096) + b"\n")) == 1
    assert decoder.feed(line.rjust(4097) + b"\n") == []
    assert (decoder.counters.bad_lines, decoder.counters.garbage_bytes) == (1, 4097)
    pieces = [line.rjust(4097)[:4000], line.rjust(4097)[4000:] + b"\n"]
    assert [decoder.feed(piece) for piece in pieces] == [[], []]
    assert (decoder.counters.bad_lines, decoder.counters.garbage_bytes) == (2, 2 * 4097)


def test_only_printable_ascii_makes_a_bad_line_and_only_that_a_comment() -> None:
    decoder = WireDecoder()
    decoder.feed(b"# comment ~\n#\ttab \x20\n")
    assert (decoder.counters.bad_lines, decoder.counters.garbage_bytes) == (0, 0)
    decoder.feed(b"words ~\nmore\twords\n")
    assert (decoder.counters.bad_lines, decoder.counters.garbage_bytes) == (2, 7 + 10)
    decoder.feed(b"delete\x7f\nunit\x1fseparator\n# comment\x7f\nhigh\x80\n")
    assert decoder.counters.bad_lines == 2
    assert decoder.counters.garbage_bytes == 17 + 7 + 14 + 10 + 5


def test_garbage_is_counted_to_the_byte() -> None:
    decoder = WireDecoder()
    decoder.feed(b"\x01\x02\x03\0")  # a piece of a frame that began elsewhere
    assert (decoder.counters.bad_frames, decoder.counters.garbage_bytes) == (1, 3)
    decoder.feed(b"\0\xb2" + cobs_encode(b"abc" + struct.pack("<I", zlib.crc32(b"abc"))) + b"\0")
    assert (decoder.counters.foreign, decoder.counters.garbage_bytes) == (1, 3 + 9)
    decoder.feed(frame(b"\x99" + bytes(7)))
    assert (decoder.counters.malformed, decoder.counters.garbage_bytes) == (1, 12 + 1 + 13)
    decoder.feed(b"\0\xb1ha\nA,7,1,2,3\nlf\0")  # half a frame that swallowed a line
    assert (decoder.counters.bad_frames, decoder.counters.garbage_bytes) == (2, 26 + 3 + 2)
    assert (decoder.counters.lines, decoder.counters.samples) == (1, 1)
    assert decoder.counters.resynchronisations == 1
    decoder.feed(b"A,8,1,2")
    assert decoder.end() == []
    assert (decoder.counters.truncated, decoder.counters.garbage_bytes) == (1, 31 + 7)
    assert len(others(decoder.feed(frame(header(0x13) + struct.pack("<d", 1.0))))) == 1
    assert decoder.counters.resynchronisations == 2
