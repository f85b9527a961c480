"""The form in text: what a sketch prints, bad lines, CRCs and counters of microseconds."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.streams.events import Charging, Location, Temperature
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.encoder import Form, WireEncoder, WireSettings
from stillcal.daemon.wire.text import COUNTER, LATE, MAX_LINE, MOST_MICROS, MicrosClock, crc16
from tests.support.wire_said import G, joined, others, run


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


def seconds_after(first: int, second: int) -> float:
    """Return what a clock that has wrapped once and then saw `first` makes of `second`, less 2^32 us."""
    clock = MicrosClock()
    for stamp in (COUNTER - 10, 10, first):
        clock.seconds(b"%d" % stamp)
    return clock.seconds(b"%d" % second) - COUNTER / 1e6


def test_the_page_says_ten_seconds_of_disorder_and_32_bits() -> None:
    assert (LATE, COUNTER) == (10_000_000, 2**32)


def test_a_line_from_before_the_wrap_may_be_ten_seconds_late() -> None:
    late = seconds_after(20, 20 + COUNTER - LATE + 1)
    assert late == pytest.approx((20 - LATE + 1) / 1e6, abs=1e-6)  # before the wrap
    ahead = seconds_after(20, 20 + COUNTER - LATE)
    assert ahead == pytest.approx((20 + COUNTER - LATE) / 1e6, abs=1e-6)  # silent for more than an hour


def test_a_stamp_that_falls_by_more_than_half_the_range_is_a_wrap() -> None:
    half = COUNTER // 2
    for fall, wrapped in ((half, False), (half + 1, True)):
        clock = MicrosClock()
        clock.seconds(b"%d" % (half + 10))
        assert clock.seconds(b"%d" % (half + 10 - fall)) == pytest.approx(
            (half + 10 - fall + wrapped * COUNTER) / 1e6, abs=1e-6
        )


def test_a_counter_seen_beyond_32_bits_never_wraps() -> None:
    clock = MicrosClock()
    assert clock.seconds(b"%d" % COUNTER) == COUNTER / 1e6
    assert clock.seconds(b"5") == 5e-6  # the device started again
    assert clock.seconds(b"%d" % (COUNTER - 1)) == (COUNTER - 1) / 1e6


@pytest.mark.parametrize("stamp", [MOST_MICROS, 0])
def test_any_time_of_317_years_is_one(stamp: int) -> None:
    assert MicrosClock().seconds(b"%d" % stamp) == stamp / 1e6


@pytest.mark.parametrize("stamp", [MOST_MICROS + 1, 2**63, -1])
def test_what_is_beyond_is_no_time(stamp: int) -> None:
    with pytest.raises(ValueError, match="not a time"):
        MicrosClock().seconds(b"%d" % stamp)


def test_lines_come_as_one_run_until_time_or_columns_change() -> None:
    decoder = WireDecoder()
    came = decoder.feed(b"A,10,1,2,3\nA,10,1,2,4\nA,20,1,2,5\nA,15,1,2,6\nA,30,1,2,7,25\nA,40,1,2,8,26\n")
    assert [joined([m]).xyz[:, 2].tolist() for m in came] == [[3, 4, 5], [6], [7, 8]]
    assert [joined([m]).temperature is None for m in came] == [True, True, False]
    assert decoder.counters.samples == 6


def test_a_lines_crc_may_not_be_shorter_or_longer() -> None:
    line = b"A,1000,1,2,3"
    decoder = WireDecoder()
    crc = b"%04X" % crc16(line)
    for digits in (crc[1:], b"0" + crc):
        assert decoder.feed(line + b"*" + digits + b"\n") == []
    assert decoder.counters.bad_lines == 2
    assert len(decoder.feed(line + b"*" + crc + b"\n")) == 1


def test_numbers_beside_the_letter_count_lost_lines() -> None:
    decoder = WireDecoder()
    decoder.feed(b"A5,1,1,2,3\nA6,2,1,2,3\nA9,3,1,2,3\nG7,3,1,2,3\nG8,4,1,2,3\nA,4,1,2,3\n")
    assert (decoder.counters.lost_samples, decoder.counters.lines) == (2, 6)
