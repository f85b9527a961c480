"""How the bytes are cut into pieces changes nothing that the decoder says."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

from hypothesis import given, settings
from hypothesis import strategies as st

from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.wire.cobs import MAX_FRAME, cobs_encode, framed
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.encoder import Form, WireEncoder, WireSettings
from stillcal.daemon.wire.messages import Message
from stillcal.daemon.wire.sample_blocks import Coding
from tests.support.wire_said import OTHERS, G, joined, run


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
