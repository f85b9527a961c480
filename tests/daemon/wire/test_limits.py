"""Numbers beyond any phone's: refused where they come in, whatever message and form they come in."""

from __future__ import annotations

import dataclasses
import math
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.streams import limits
from stillcal.calib_core.streams.events import Charging, End, Location, Tick
from stillcal.calib_core.streams.samples import SampleError, Samples, Sensor
from stillcal.daemon.service.batching import join_blocks
from stillcal.daemon.service.saved_state import SavedState, decode, encode
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.encoder import WireSettings
from stillcal.daemon.wire.messages import Message, PhoneMessage, Status
from stillcal.daemon.wire.text import MicrosClock
from stillcal.replay.trials.faults.hostile import any_message, any_style, encoded

RECORDS = [kind for kind in get_args(PhoneMessage) if kind is not Samples]


@contextmanager
def no_longer_than(seconds: float) -> Iterator[None]:
    def spun(*_: object) -> None:
        raise TimeoutError(f"still busy after {seconds} s")

    before = signal.signal(signal.SIGALRM, spun)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("kind", RECORDS, ids=lambda kind: kind.__name__)
def test_every_number_that_a_phone_sends_has_limits(kind: type) -> None:
    numbers = [n for n, hint in get_type_hints(kind).items() if hint in (float, float | None)]
    assert set(numbers) <= limits.RANGES.keys()
    assert all(low < high and not math.isnan(low + high) for low, high in limits.RANGES.values())


def numbers(message: Message) -> Iterator[tuple[str, float]]:
    names = [f.name for f in dataclasses.fields(message)] if dataclasses.is_dataclass(message) else []
    for name in names or message.__struct_fields__:
        value = getattr(message, name)
        if isinstance(value, float):
            yield name, value


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # a busy machine is no failure
@given(st.lists(any_message(), max_size=12), any_style())
def test_whatever_comes_in_is_within_limits(messages: list[Message], style: WireSettings) -> None:
    decoder = WireDecoder()
    came = [m for data in encoded(messages, style) for m in decoder.feed(data)]
    for message in came:
        if isinstance(message, Samples):
            assert limits.usable(message.t, message.xyz).all()
            celsius = message.temperature
            assert celsius is None or (np.isnan(celsius) | limits.plausible_temperature(celsius)).all()
        else:
            assert all(limits.within(name, value) for name, value in numbers(message)), message


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # a busy machine is no failure
@given(st.lists(any_message(), max_size=12), any_style())
def test_whatever_comes_in_the_engine_goes_on_and_its_state_can_be_saved(
    messages: list[Message], style: WireSettings
) -> None:
    decoder, engine = WireDecoder(), Engine()
    saved = SavedState(engine.state)
    came: list[Any] = [m for data in encoded(messages, style) for m in decoder.feed(data)]
    with no_longer_than(10.0):
        for host, message in enumerate(join_blocks(came)):
            if isinstance(message, Samples | Charging | Location | Tick | End):
                item = saved.clock.mapped(message, float(host))
                if item is not None:
                    engine.feed(item)
                if isinstance(item, Samples):
                    saved.energy.samples(float(item.t[-1]), len(item))
            elif isinstance(message, Status):
                saved.energy.status(message.t + saved.clock.offset, message)
        again = decode(encode(replace(saved, engine=engine.state)))
        assert encode(again) == encode(replace(saved, engine=engine.state))


@pytest.mark.parametrize(
    "line",
    [
        b"S,0,0,1,99999999999999999999\n",
        b"S,0,1e308,1,0\n",
        b"A,%d,0,0,9.8\n" % (10**19),
        b"A,0,0,0,1e308\n",
        b"E,0,location,1e300,0\n",
        b"T,0,1e300\n",
        b"E,%d,tick\n" % (10**17),
    ],
)
def test_a_line_with_a_number_beyond_its_limits_is_a_bad_line(line: bytes) -> None:
    decoder = WireDecoder()
    assert decoder.feed(line) == []
    assert decoder.counters.bad_lines == 1


def test_a_counter_that_is_said_to_wrap_without_end_stays_within_limits() -> None:
    clock = MicrosClock(epoch=int(limits.STAMP_S * 1e6) - (1 << 32))
    for _ in range(10):
        assert clock.seconds(b"4294967295") <= limits.STAMP_S
        assert clock.seconds(b"0") <= limits.STAMP_S


@pytest.mark.parametrize(
    ("t", "x", "reason"),
    [
        (1e19, 0.0, "time 1e\\+19 s is out of range"),
        (0.0, 1e308, "reading 1e\\+308 is out of range"),
        (math.inf, 0.0, "not a finite number"),
        (0.0, math.nan, "not a finite number"),
    ],
)
def test_a_recording_with_such_a_sample_is_refused_with_its_row(t: float, x: float, reason: str) -> None:
    with pytest.raises(SampleError, match=f"sample 1: {reason}"):
        Samples.checked(Sensor.ACCELEROMETER, [0.0, t], [[0.0, 0.0, 9.8], [x, 0.0, 9.8]])
    edge = [[limits.READING, 0.0, 0.0]]
    assert len(Samples.checked(Sensor.ACCELEROMETER, [limits.STAMP_S], edge)) == 1
