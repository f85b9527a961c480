"""Every message in both forms, and samples in every coding, come back as they were sent."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillcal.calib_core.streams import limits
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.encoder import Form, WireEncoder, WireSettings
from stillcal.daemon.wire.messages import Message
from stillcal.daemon.wire.sample_blocks import Coding
from tests.support.wire_said import OTHERS, A, joined, run, same


@pytest.mark.parametrize("form", Form)
@pytest.mark.parametrize("message", OTHERS, ids=lambda m: type(m).__name__)
def test_every_message_comes_back_in_both_forms(message: Message, form: Form) -> None:
    data = WireEncoder(WireSettings(form=form)).encode(message)
    decoder = WireDecoder()
    assert decoder.feed(data) == [message]
    assert decoder.form is form
    assert decoder.counters.garbage_bytes == decoder.counters.resynchronisations == 0


stamp, reading = st.floats(-limits.STAMP_S, limits.STAMP_S), st.floats(-limits.READING, limits.READING)
celsius, arrival = st.floats(*limits.TEMPERATURE_C), st.floats(allow_nan=False, allow_infinity=False)
columns = st.lists(st.tuples(stamp, reading, reading, reading, celsius, arrival), min_size=1, max_size=40)


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
    sent = Samples.checked(A, [0.0, 0.01, 500.0, 500.01], np.full((4, 3), [1e5, -1e5, 0.0]))
    decoder = WireDecoder()
    came = joined(decoder.feed(WireEncoder(WireSettings(coding=Coding.COUNTS)).encode(sent)))
    assert np.allclose(came.t, sent.t, atol=1e-6)
    assert np.allclose(came.xyz[0] / 0.0006, [32767, -32768, 0])
    assert decoder.counters.frames == 2


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


@pytest.mark.parametrize(
    "bad", [{"block": 0}, {"block": 2000}, {"accel_unit": 0.0}, {"gyro_unit": math.nan}, {"tick_ns": 0}]
)
def test_settings_out_of_range_are_refused_by_name(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        WireSettings(**bad)  # type: ignore[arg-type]
