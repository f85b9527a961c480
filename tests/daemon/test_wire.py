"""The decoder and the encoder: every message, both forms, hostile bytes, sequence numbers."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stillcal.calib_core.events import Charging, End, Location, Tick
from stillcal.calib_core.samples import Samples, Sensor
from stillcal.calib_core.stationary import Sense, Sleep
from stillcal.daemon.wire import (
    Coding,
    Form,
    Grant,
    Hello,
    Identify,
    Message,
    Rate,
    Status,
    Temperature,
    WireDecoder,
    WireEncoder,
    WireSettings,
)
from stillcal.daemon.wire_cobs import MAX_FRAME, cobs_encode, framed
from stillcal.daemon.wire_frames import MAX_HELLO
from stillcal.daemon.wire_messages import SEQUENCE_MASK
from stillcal.daemon.wire_text import COUNTER, MAX_LINE, MicrosClock, crc16

A, G = Sensor.ACCELEROMETER, Sensor.GYROSCOPE

OTHERS: list[Message] = [
    Hello(
        session=7, flow="credit", claims={"device": "bench*1,A", "nominal_rate_hz": 100.0, "accel_lsb": None}
    ),
    Hello(),
    Temperature(12.5, 31.25),
    Charging(3600.0, True),
    Charging(7200.0, False),
    Location(1.5, 52.2, 0.1, 17.0),
    Location(1.5, -33.9, 151.2),
    Tick(99.000001),
    Status(99.5, 12.25, True, 3),
    Sense(120.0),
    Sense(math.inf),
    Sleep(300.5),
    Sleep(math.inf),
    Rate(50.0),
    Grant(10.0),
    Identify(),
    End(86400.0),
]


def run(n: int, sensor: Sensor = A, start: float = 0.0, seed: int = 1, temperature: bool = False) -> Samples:
    rng = np.random.default_rng(seed)
    t = start + np.cumsum(rng.uniform(0.005, 0.015, n))
    return Samples.checked(sensor, t, rng.normal(0, 9, (n, 3)), rng.normal(30, 1, n) if temperature else None)


def joined(messages: Iterable[Message], sensor: Sensor = A) -> Samples:
    runs = [m for m in messages if isinstance(m, Samples) and m.sensor is sensor]
    return Samples.joined(runs) if runs else Samples.empty(sensor)


def same(a: Samples, b: Samples) -> bool:
    """Whether two runs are equal bit for bit, columns that are not there included."""

    def columns(s: Samples) -> list[bytes | None]:
        return [None if c is None else c.tobytes() for c in (s.t, s.xyz, s.temperature, s.t_arrival)]

    return a.sensor is b.sensor and columns(a) == columns(b)


def others(messages: Iterable[Message]) -> list[Message]:
    return [m for m in messages if not isinstance(m, Samples)]


# Round trips


@pytest.mark.parametrize("form", Form)
@pytest.mark.parametrize("message", OTHERS, ids=lambda m: type(m).__name__)
def test_every_message_comes_back_in_both_forms(message: Message, form: Form) -> None:
    data = WireEncoder(WireSettings(form=form)).encode(message)
    decoder = WireDecoder()
    assert decoder.feed(data) == [message]
    assert decoder.form is form
    assert decoder.counters.garbage_bytes == decoder.counters.resynchronisations == 0


finite = st.floats(allow_nan=False, allow_infinity=False)
columns = st.lists(st.tuples(finite, finite, finite, finite, finite, finite), min_size=1, max_size=40)


@given(columns, st.booleans(), st.booleans(), st.integers(1, 50))
def test_exact_samples_come_back_bit_for_bit(
    rows: list[tuple[float, ...]], temperature: bool, arrival: bool, block: int
) -> None:
    table = np.array(sorted(rows))
    sent = Samples.checked(
        A, table[:, 0], table[:, 1:4], table[:, 4] if temperature else None, table[:, 5] if arrival else None
    )
    decoder = WireDecoder()
    came = decoder.feed(WireEncoder(WireSettings(block=block)).encode(sent))
    assert same(joined(came), sent)
    assert decoder.counters.samples == len(rows)


@pytest.mark.parametrize("coding", [Coding.FLOAT, Coding.COUNTS])
@pytest.mark.parametrize("sensor", Sensor)
def test_compact_samples_come_back_to_within_half_a_step(coding: Coding, sensor: Sensor) -> None:
    sent = run(1000, sensor, start=5e5, temperature=True)
    style = WireSettings(coding=coding, accel_unit=0.002, gyro_unit=0.002)
    data = WireEncoder(style).encode(sent)
    came = joined(WireDecoder().feed(data), sensor)
    assert np.abs(came.t - sent.t).max() <= 0.5e-6 + 1e-9
    step = 0.001 * (1 + 1e-6) if coding is Coding.COUNTS else 2**-24 * np.abs(sent.xyz).max()
    assert np.abs(came.xyz - sent.xyz).max() <= step
    assert came.temperature is not None and np.abs(came.temperature - sent.temperature).max() < 1e-5
    assert len(data) < (20 if coding is Coding.FLOAT else 14) * len(sent)


def test_counts_saturate_and_gaps_begin_another_block() -> None:
    sent = Samples.checked(A, [0.0, 0.01, 500.0, 500.01], np.full((4, 3), [1e9, -1e9, 0.0]))
    decoder = WireDecoder()
    came = joined(decoder.feed(WireEncoder(WireSettings(coding=Coding.COUNTS)).encode(sent)))
    assert np.allclose(came.t, sent.t, atol=1e-6)
    assert np.allclose(came.xyz[0] / 0.0006, [32767, -32768, 0])
    assert decoder.counters.frames == 2


def test_text_samples_come_back_with_stamps_to_a_microsecond() -> None:
    sent = run(50, temperature=True)
    came = joined(WireDecoder().feed(WireEncoder(WireSettings(form=Form.TEXT)).encode(sent)))
    assert came.xyz.tobytes() == sent.xyz.tobytes()
    assert came.temperature is not None and came.temperature.tobytes() == sent.temperature.tobytes()
    assert np.abs(came.t - sent.t).max() <= 0.5e-6 + 1e-12


def test_what_a_sketch_prints_is_read() -> None:
    decoder = WireDecoder()
    came = decoder.feed(
        b"booting...\r\n# comment\r\n"
        b"A,1000,0.1,-0.2,9.81\r\nG,1000,0.01,0.02,0.03\r\nA,2000,0.1,-0.2,9.82\r\n"
        b"T,2000,25.5\r\nE,2500,charging,1\r\nE,2600,location,52.2,0.1\r\nA,3000,0,0,9.8,26\r\n"
    )
    assert joined(came).t.tolist() == [0.001, 0.002, 0.003]
    assert joined(came).xyz[1].tolist() == [0.1, -0.2, 9.82]
    assert joined(came, G).xyz.tolist() == [[0.01, 0.02, 0.03]]
    assert others(came) == [Temperature(0.002, 25.5), Charging(0.0025, True), Location(0.0026, 52.2, 0.1)]
    assert [type(m).__name__ for m in came] == ["Samples"] * 2 + [
        "Temperature",
        "Charging",
        "Location",
        "Samples",
    ]
    assert decoder.counters.bad_lines == 1
    assert decoder.counters.lines == 7


@pytest.mark.parametrize(
    "line",
    [
        "A", "A,", "A,1", "A,1,2,3", "A,1,2,3,4,5,6", "A,x,1,2,3", "A,1,nan,2,3", "A,1,inf,2,3", "A,-1,1,2,3",
        "A,1.5,1,2,3", "A,1,1_0,2,3", "Ax,1,1,2,3", "B,1,2,3,4", "T,1", "T,1,2,3", "E,1", "E,1,charging",
        "E,1,charging,1,1", "E,1,flying,1", "E,1,location,1", "S,1,2", "H", "H,{}x", 'H,{"session":-1}',
        'H,{"claims":{"a":{"b":1}}}', "H," + "[" * 2000, "sense,x", "sense,nan", "rate,", "identify,1",
        "A," + "9" * 40 + ",1,2,3", "*", "A,1,2,3,4*", "A,1,2,3,4*0000", "x" * (MAX_LINE + 1),
    ],
)  # fmt: skip
def test_a_bad_line_is_counted_and_nothing_more(line: str) -> None:
    decoder = WireDecoder()
    came = decoder.feed(line.encode() + b"\nA,5,1,2,3\n")
    assert len(came) == 1 and joined(came).t.tolist() == [5e-6]
    assert (decoder.counters.bad_lines, decoder.counters.resynchronisations) == (1, 1)


def test_a_line_with_its_crc_is_read_and_with_another_is_not() -> None:
    line = b"A,1000,0.1,-0.2,9.81"
    decoder = WireDecoder()
    assert len(joined(decoder.feed(b"%b*%04x\n" % (line, crc16(line))))) == 1
    assert decoder.feed(b"%b*%04X\n" % (line, crc16(line) ^ 1)) == []
    assert decoder.counters.bad_lines == 1


def test_a_32_bit_counter_of_microseconds_carries_on_where_it_wraps() -> None:
    clock = MicrosClock()
    stamps = [COUNTER - 20, COUNTER - 10, 5, COUNTER - 2, 15, COUNTER - 1_000_000_000, 7]
    seconds = [clock.seconds(b"%d" % s) for s in stamps]
    assert np.allclose(
        np.array(seconds) * 1e6 - COUNTER,
        [-20, -10, 5, -2, 15, COUNTER - 1_000_000_000, COUNTER + 7],
        atol=1e-3,
    )


def test_a_wider_counter_is_taken_as_it_is() -> None:
    clock = MicrosClock()
    assert clock.seconds(b"%d" % (COUNTER + 5)) == (COUNTER + 5) / 1e6
    assert clock.seconds(b"%d" % (5 * COUNTER)) == 5 * COUNTER / 1e6


# How the bytes are cut changes nothing


def mixed_stream() -> bytes:
    binary = WireEncoder(WireSettings(block=4))
    compact = WireEncoder(WireSettings(coding=Coding.COUNTS, block=5))
    text = WireEncoder(WireSettings(form=Form.TEXT))
    parts = [binary.encode(run(11, temperature=True)), *map(binary.encode, OTHERS)]
    parts += [b"ESP-ROM:esp32\n\n# hi\n", text.encode(run(5, G)), text.encode(run(4, temperature=True))]
    parts += [
        *map(text.encode, OTHERS),
        compact.encode(run(12, G)),
        b"\xb1half\0",
        b"\xb1ha\nA,7,1,2,3\nlf\0",
        b"A,1,2",
    ]
    parts += [
        framed(b"\x99"),
        framed(b"\x01\0\0\0"),
        b"\0\xb2" + cobs_encode(b"abc") + b"\0",
        b"\n",
        b"\x00\xff\n",
    ]
    return b"".join(parts) + b"z" * 5000 + b"\nA,9,1,2,3\n\0"


def outcome(pieces: Iterable[bytes]) -> tuple[list[bytes], list[Message], object]:
    decoder = WireDecoder()
    came = [m for piece in pieces for m in decoder.feed(piece)] + decoder.end()
    runs = [joined([m for m in came if isinstance(m, Samples)], s) for s in Sensor]
    places = [
        (m, len(joined(came[:i])), len(joined(came[:i], G)))
        for i, m in enumerate(came)
        if not isinstance(m, Samples)
    ]
    return [x.tobytes() for r in runs for x in (r.t, r.xyz)], places, decoder.counters


def cut(data: bytes, places: Iterable[int]) -> list[bytes]:
    edges = [0, *sorted(places), len(data)]
    return [data[a:b] for a, b in itertools.pairwise(edges)]


@given(st.lists(st.integers(0, len(mixed_stream())), max_size=30))
@settings(deadline=None)
def test_how_the_bytes_are_cut_changes_nothing(places: list[int]) -> None:
    data = mixed_stream()
    assert outcome(cut(data, places)) == outcome([data])


def test_byte_by_byte_is_the_same_as_whole() -> None:
    data = mixed_stream()
    assert outcome(data[i : i + 1] for i in range(len(data))) == outcome([data])


hostile = st.lists(
    st.one_of(
        st.binary(max_size=40),
        st.sampled_from([b"\0", b"\0\xb1", b"\n", b"A,1,2,3,4\n", b"A1,2,3,4,5*", b"H,{", b"\xb1\n", b"G"]),
        st.sampled_from(OTHERS).map(lambda m: WireEncoder().encode(m)),
    ),
    max_size=30,
).map(b"".join)


@given(hostile, st.data())
@settings(deadline=None)
def test_hostile_bytes_never_raise_and_cutting_changes_nothing(data: bytes, draw: st.DataObject) -> None:
    places = draw.draw(st.lists(st.integers(0, len(data)), max_size=10))
    assert outcome(cut(data, places)) == outcome([data])


@given(st.lists(st.integers(0, 100_000), max_size=8))
@settings(max_examples=50, deadline=None)
def test_an_endless_frame_is_given_up_at_the_same_byte_however_it_is_cut(places: list[int]) -> None:
    data = b"\0\xb1" + b"".join(b"A,%d,1.%0100d,2,3\n" % (i, i) for i in range(1000))
    assert len(data) > 1.5 * MAX_FRAME
    whole = outcome([data])
    assert outcome(cut(data, places)) == whole
    stamps, *_ = whole[0]
    assert len(stamps) == 8 * 999


# Hostile bytes


def test_a_million_random_bytes_give_nothing_and_hold_nothing() -> None:
    noise = np.random.default_rng(20).bytes(1_000_000)
    decoder = WireDecoder()
    came = [m for i in range(0, len(noise), 4095) for m in decoder.feed(noise[i : i + 4095])]
    assert came == []
    assert decoder.counters.bytes == 1_000_000
    assert decoder.counters.bad_frames > 3000
    sent = run(10)
    assert same(joined(decoder.feed(b"\0" + WireEncoder().encode(sent))), sent)
    assert decoder.counters.resynchronisations == 1


@pytest.mark.parametrize(
    "filler", [b"\xb1", b"x", b"\xff", b"\n", b"\0", b"\0\xb1", b"A,1,2,3,", b"\0\xb1\n"]
)
def test_memory_stays_bounded_whatever_repeats(filler: bytes) -> None:
    decoder = WireDecoder()
    piece = filler * (4096 // len(filler))
    for _ in range(100):
        decoder.feed(piece)
        assert sum(map(len, decoder._parts)) <= MAX_FRAME + len(piece)
    assert len(joined(decoder.feed(b"\0\nA,1,2,3,4\n"))) == 1


def test_each_flipped_bit_costs_the_frame_it_lies_in_and_no_other() -> None:
    frames = [WireEncoder().encode(m) for m in (Tick(1.0), Charging(2.0, True), Location(3.0, 1.0, 2.0))]
    message = [Tick(1.0), Charging(2.0, True), Location(3.0, 1.0, 2.0)]
    first, last = len(frames[0]), len(frames[0] + frames[1])
    data = b"".join(frames)
    for bit in range(8 * first, 8 * last):
        hurt = bytearray(data)
        hurt[bit // 8] ^= 1 << bit % 8
        decoder = WireDecoder()
        came = decoder.feed(bytes(hurt))
        assert came == [message[0], message[2]], bit
        assert decoder.counters.garbage_bytes > 0


def test_flips_on_a_long_stream_cost_exactly_the_frames_they_hit() -> None:
    rng = np.random.default_rng(21)
    encoder = WireEncoder(WireSettings(block=8))
    frames = [encoder.encode(run(8, seed=i, start=i)) for i in range(2000)]
    hit = set(rng.choice(2000 - 2, 700, replace=False) + 1)
    hurt = []
    for i, frame in enumerate(frames):
        body = bytearray(frame)
        if i in hit:
            bit = int(rng.integers(8 * len(body)))
            body[bit // 8] ^= 1 << bit % 8
        hurt.append(bytes(body))
    decoder = WireDecoder()
    came = [m for frame in hurt for m in decoder.feed(frame)]
    kept = [run(8, seed=i, start=i) for i in range(2000) if i not in hit]
    assert len(came) == len(kept)
    assert all(isinstance(m, Samples) and same(m, k) for m, k in zip(came, kept, strict=True))
    assert decoder.counters.lost_samples == 8 * len(hit)


def test_half_a_frame_swallows_no_line_after_it() -> None:
    half = WireEncoder().encode(run(20))[:100].replace(b"\n", b"x")
    decoder = WireDecoder()
    lines = b"".join(b"A,%d,1,2,3\n" % i for i in range(100))
    came = decoder.feed(half + b"\n" + lines + WireEncoder().encode(Tick(1.0)))
    assert joined(came).t.tolist() == [i / 1e6 for i in range(100)]
    assert others(came) == [Tick(1.0)]
    assert decoder.counters.bad_frames == 1


def payload_of(kind: int, form: int, n: int, body: bytes) -> bytes:
    return bytes([kind, form]) + n.to_bytes(2, "little") + bytes(4) + body


nan, inf = np.array([math.nan]).tobytes(), np.array([math.inf]).tobytes()


@pytest.mark.parametrize(
    "payload",
    [
        b"\x01", payload_of(0x99, 0, 0, b""), payload_of(0x01, 0, 1, bytes(31)),
        payload_of(0x01, 0, 1, bytes(33)),
        payload_of(0x01, 3, 1, bytes(32)), payload_of(0x01, 0, 65535, bytes(64)),
        payload_of(0x01, 1, 1, bytes(3)),
        payload_of(0x01, 0x10, 1, bytes(32)), payload_of(0x13, 0, 0, nan), payload_of(0x13, 0, 0, inf),
        payload_of(0x13, 0, 0, b""), payload_of(0x12, 0, 0, nan * 4), payload_of(0x40, 0, 0, nan),
        payload_of(0x20, 0, 0, b"{"), payload_of(0x20, 0, 0, b"\xff\xfe"),
        payload_of(0x20, 0, 0, b'{"flow":"up"}'),
        payload_of(0x20, 0, 0, json.dumps({"claims": {"a": "x" * MAX_HELLO}}).encode()),
        payload_of(0x20, 0, 0, b'{"x":' + b"[" * 3000), payload_of(0x20, 0, 0, b"[" * 30_000),
    ],
)  # fmt: skip
def test_a_right_crc_on_nonsense_is_counted_as_malformed(payload: bytes) -> None:
    decoder = WireDecoder()
    assert decoder.feed(framed(payload) + WireEncoder().encode(Tick(1.0))) == [Tick(1.0)]
    counters = decoder.counters
    assert (counters.malformed, counters.bad_frames, counters.frames, counters.resynchronisations) == (
        1,
        0,
        1,
        1,
    )


def test_another_version_is_named_as_such() -> None:
    frame = WireEncoder().encode(Tick(1.0)).replace(b"\xb1", b"\xb2")
    decoder = WireDecoder()
    assert decoder.feed(frame) == []
    assert (decoder.counters.foreign, decoder.counters.bad_frames) == (1, 0)


def test_a_wrong_crc_is_told_from_a_broken_frame() -> None:
    frame = bytearray(WireEncoder().encode(Tick(1.25)))
    frame[-3] ^= 0x40
    decoder = WireDecoder()
    decoder.feed(bytes(frame) + b"\0\xb1\x09abc\0")
    assert (decoder.counters.crc_errors, decoder.counters.bad_frames) == (1, 2)


@pytest.mark.parametrize("coding", Coding)
def test_samples_that_cannot_be_used_are_dropped_and_counted(coding: Coding) -> None:
    t, xyz = np.arange(6.0), np.ones((6, 3))
    xyz[1, 2], xyz[4, 0] = (math.nan, math.inf) if coding is not Coding.COUNTS else (1.0, 1.0)
    t[3] = 0.5 if coding is Coding.EXACT else 3.0
    sent = Samples(A, t, xyz)
    decoder = WireDecoder()
    came = joined(decoder.feed(WireEncoder(WireSettings(coding=coding)).encode(sent)))
    expected = {Coding.EXACT: [0, 2, 5], Coding.FLOAT: [0, 2, 3, 5], Coding.COUNTS: range(6)}[coding]
    assert came.t.tolist() == pytest.approx(list(expected))
    assert decoder.counters.invalid_samples == 6 - len(came)
    Samples.checked(came.sensor, came.t, came.xyz)


def test_a_hostile_compact_block_overflows_nothing() -> None:
    head = (2**63 - 1).to_bytes(8, "little") + b"\xff" * 4 + np.array([np.inf], "<f4").tobytes()
    steps, counts = b"\xff" * 2 * 900, np.zeros(2700, "<i2").tobytes()
    decoder = WireDecoder()
    assert decoder.feed(framed(payload_of(0x01, 2, 900, head + steps + counts))) == []
    assert decoder.counters.invalid_samples == 900


# Sequence numbers


def sequences(decoder: WireDecoder, encode: Callable[[Message], bytes], skip: Iterable[int]) -> None:
    dropped = set(skip)
    for i in range(20):
        data = encode(run(5, start=float(i))) + encode(Tick(float(i)))
        if i not in dropped:
            decoder.feed(data)


def test_lost_samples_and_messages_are_counted_by_their_numbers() -> None:
    decoder = WireDecoder()
    sequences(decoder, WireEncoder(WireSettings(block=2)).encode, [3, 7, 8])
    assert (decoder.counters.lost_samples, decoder.counters.lost_messages) == (15, 3)


def test_lost_lines_are_counted_where_they_carry_numbers() -> None:
    decoder = WireDecoder()
    sequences(decoder, WireEncoder(WireSettings(form=Form.TEXT)).encode, [3, 7, 8])
    assert decoder.counters.lost_samples == 15


def test_numbers_wrap() -> None:
    encoder = WireEncoder()
    encoder._next[A] = SEQUENCE_MASK - 3
    decoder = WireDecoder()
    decoder.feed(encoder.encode(run(10)))
    encoder.encode(run(5))
    decoder.feed(encoder.encode(run(10)))
    assert (decoder.counters.lost_samples, decoder.counters.restarts) == (5, 0)


def test_a_device_that_starts_again_is_no_loss() -> None:
    decoder = WireDecoder()
    for session in (1, 2):
        encoder = WireEncoder()
        decoder.feed(
            encoder.encode(Hello(session=session)) + encoder.encode(run(10)) + encoder.encode(run(7, G))
        )
    decoder.feed(WireEncoder().encode(run(3)))
    counters = decoder.counters
    assert (counters.restarts, counters.lost_samples, counters.lost_messages) == (2, 0, 0)
    assert counters.samples == 37


def test_half_a_frame_at_the_end_of_a_connection_is_counted_once() -> None:
    decoder = WireDecoder()
    whole = WireEncoder().encode(run(10))
    decoder.feed(whole + whole[:50])
    assert decoder.end() == [] and decoder.end() == []
    assert (decoder.counters.truncated, decoder.counters.bad_frames) == (1, 0)
    assert len(decoder.feed(WireEncoder().encode(Tick(1.0)))) == 1


@pytest.mark.parametrize(
    "bad", [{"block": 0}, {"block": 2000}, {"accel_unit": 0.0}, {"gyro_unit": math.nan}, {"tick_ns": 0}]
)
def test_settings_out_of_range_are_refused_by_name(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        WireSettings(**bad)  # type: ignore[arg-type]
