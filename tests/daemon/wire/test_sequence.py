"""Sequence numbers count what is lost, once; a device that starts again is no loss."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from stillcal.calib_core.streams.events import Tick
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.encoder import Form, WireEncoder, WireSettings
from stillcal.daemon.wire.frames import Frame
from stillcal.daemon.wire.messages import SEQUENCE_MASK, Hello, Message
from stillcal.daemon.wire.reassembly import WireCounters, WireDelivery
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


def counted(*sequences: int, start: int = 0) -> WireCounters:
    """Return the counters after single samples with these numbers, the first of which is expected."""
    counters = WireCounters()
    delivery = WireDelivery(counters)
    for at, sequence in enumerate((start, *sequences)):
        delivery.deliver(Frame(run(1, start=float(at)), sequence))
    return counters


def test_a_gap_of_up_to_half_the_numbers_is_loss_and_a_larger_one_a_restart() -> None:
    half = SEQUENCE_MASK // 2  # 2^31 - 1
    lost = counted(1 + half)
    assert (lost.lost_samples, lost.restarts) == (half, 0)
    anew = counted(1 + half + 1)
    assert (anew.lost_samples, anew.restarts) == (0, 1)


def test_after_the_largest_number_comes_zero() -> None:
    assert counted(SEQUENCE_MASK, 0, 1, start=SEQUENCE_MASK - 1).lost_samples == 0
    assert counted(1, start=SEQUENCE_MASK).lost_samples == 1


def test_a_frames_numbers_count_the_samples_that_were_dropped_too() -> None:
    counters = WireCounters()
    delivery = WireDelivery(counters)
    delivery.deliver(Frame(run(3), 0, counted=5, invalid=2))
    delivery.deliver(Frame(run(3, start=1.0), 5, counted=3))
    assert (counters.lost_samples, counters.invalid_samples, counters.samples) == (0, 2, 6)
    delivery.deliver(Frame(run(0), 8, counted=4, invalid=4))
    assert counters.invalid_samples == 6
    assert [len(m) for m in delivery.take()] == [3, 3]  # type: ignore[arg-type]


def test_the_same_session_again_is_no_restart_and_another_is_one() -> None:
    decoder = WireDecoder()
    for session, restarts in ((0, 0), (0, 0), (4, 1), (4, 1), (0, 2)):
        decoder.feed(WireEncoder(WireSettings(form=Form.TEXT)).encode(Hello(session=session)))
        assert decoder.counters.restarts == restarts


def test_a_new_session_begins_the_counter_of_microseconds_anew() -> None:
    decoder = WireDecoder()
    (first,) = decoder.feed(b"H,{}\nA,4294967290,1,2,3\nA,10,1,2,3\n")[1:]
    assert first.t.tolist() == [4294.96729, 4294.967306]  # type: ignore[union-attr]
    (anew,) = decoder.feed(b'H,{"session":1}\nA,20,1,2,3\n')[1:]
    assert anew.t.tolist() == [2e-05]  # type: ignore[union-attr]
