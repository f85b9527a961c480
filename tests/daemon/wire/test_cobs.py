"""COBS, CRCs and frames: published vectors, then properties."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillcal.daemon.wire.cobs import FrameError, cobs_decode, cobs_encode, framed, unframed
from stillcal.daemon.wire.text import crc16

RISING = bytes(range(1, 256))

# Wikipedia, "Consistent Overhead Byte Stuffing", encoding examples 1-11
VECTORS = [
    (b"\0", b"\x01\x01"),
    (b"\0\0", b"\x01\x01\x01"),
    (b"\0\x11\0", b"\x01\x02\x11\x01"),
    (b"\x11\x22\0\x33", b"\x03\x11\x22\x02\x33"),
    (b"\x11\x22\x33\x44", b"\x05\x11\x22\x33\x44"),
    (b"\x11\0\0\0", b"\x02\x11\x01\x01\x01"),
    (RISING[:254], b"\xff" + RISING[:254]),
    (b"\0" + RISING[:254], b"\x01\xff" + RISING[:254]),
    (RISING, b"\xff" + RISING[:254] + b"\x02\xff"),
    (RISING[1:] + b"\0", b"\xff" + RISING[1:] + b"\x01\x01"),
    (RISING[2:] + b"\0\x01", b"\xfe" + RISING[2:] + b"\x02\x01"),
]


@pytest.mark.parametrize(("plain", "stuffed"), VECTORS)
def test_published_vectors(plain: bytes, stuffed: bytes) -> None:
    assert cobs_encode(plain) == stuffed
    assert cobs_decode(stuffed) == plain


def runs() -> st.SearchStrategy[bytes]:
    """Bytes with long runs without a zero, where COBS has its seams."""
    piece = st.one_of(
        st.binary(max_size=20), st.integers(250, 770).map(lambda n: b"\x07" * n), st.just(b"\0\0\0")
    )
    return st.lists(piece, max_size=6).map(b"".join)


@given(runs())
def test_cobs_returns_what_it_was_given(data: bytes) -> None:
    stuffed = cobs_encode(data)
    assert 0 not in stuffed
    assert len(stuffed) <= len(data) + 1 + len(data) // 254
    assert cobs_decode(stuffed) == data


@given(st.binary(max_size=600))
def test_anything_else_is_refused_by_the_one_error(data: bytes) -> None:
    """Random bytes may be COBS, but then of something shorter, and never with the right CRC."""
    with contextlib.suppress(FrameError):
        plain = cobs_decode(data)
        assert len(plain) < len(data) and 0 not in data and cobs_decode(cobs_encode(plain)) == plain
    with pytest.raises(FrameError):
        unframed(data)


def test_check_values_of_both_crcs() -> None:
    """The CRC catalogue's check values: CRC-32/ISO-HDLC 0xCBF43926, CRC-16/IBM-3740 0x29B1."""
    frame = framed(b"123456789")
    assert cobs_decode(frame[2:-1])[-4:] == (0xCBF43926).to_bytes(4, "little")
    assert crc16(b"123456789") == 0x29B1


@given(runs(), st.data())
def test_a_flipped_bit_is_never_accepted(payload: bytes, data: st.DataObject) -> None:
    body = bytearray(framed(payload + b"x")[2:-1])
    bit = data.draw(st.integers(0, 8 * len(body) - 1))
    body[bit // 8] ^= 1 << bit % 8
    with pytest.raises(FrameError):
        unframed(bytes(body))


def test_a_frame_with_nothing_in_it_is_too_short() -> None:
    with pytest.raises(FrameError, match="too short") as refusal:
        unframed(framed(b"")[2:-1])
    assert not refusal.value.crc
    assert unframed(framed(b"x")[2:-1]) == b"x"


def test_only_a_wrong_crc_is_called_one() -> None:
    whole = framed(b"abcdefgh")[2:-1]
    with pytest.raises(FrameError) as refusal:
        unframed(whole[:1] + b"z" + whole[2:])
    assert refusal.value.crc
    with pytest.raises(FrameError) as refusal:
        unframed(whole[:-1])
    assert not refusal.value.crc
