"""Sequence numbers count what is lost, once; a device that starts again is no loss."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from stillcal.calib_core.streams.events import Tick
from stillcal.daemon.wire.decoder import Form, Hello, Message, WireDecoder, WireEncoder, WireSettings
from stillcal.daemon.wire.messages import SEQUENCE_MASK
from tests.support.wire_said import A, G, run


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
