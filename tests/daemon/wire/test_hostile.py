"""Noise, flipped bits and nonsense cost the decoder what they hit and nothing else."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from stillcal.calib_core.streams.events import Charging, Location, Tick
from stillcal.calib_core.streams.samples import Samples
from stillcal.daemon.wire.cobs import MAX_FRAME, framed
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.encoder import WireEncoder, WireSettings
from stillcal.daemon.wire.frames import MAX_HELLO
from tests.support.wire_said import joined, others, run, same


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


def test_a_hostile_compact_block_overflows_nothing() -> None:
    head = (2**63 - 1).to_bytes(8, "little") + b"\xff" * 4 + np.array([np.inf], "<f4").tobytes()
    steps, counts = b"\xff" * 2 * 900, np.zeros(2700, "<i2").tobytes()
    decoder = WireDecoder()
    assert decoder.feed(framed(payload_of(0x01, 2, 900, head + steps + counts))) == []
    assert decoder.counters.invalid_samples == 900
