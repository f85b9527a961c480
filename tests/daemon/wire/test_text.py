"""The form in text: what a sketch prints, bad lines, CRCs and counters of microseconds."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.streams.events import Charging, Location
from stillcal.daemon.wire.decoder import Form, Temperature, WireDecoder, WireEncoder, WireSettings
from stillcal.daemon.wire.text import COUNTER, MAX_LINE, MicrosClock, crc16
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
