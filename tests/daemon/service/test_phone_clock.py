"""The phone's clock mapped to the engine's: whatever it does, time goes on and nothing is taken twice."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillcal.calib_core.streams.events import Charging, Event, Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.service.batching import join_blocks
from stillcal.daemon.service.phone_clock import GAP_S, GAPS_S, LEAP_S, PhoneClock

A, G = Sensor.ACCELEROMETER, Sensor.GYROSCOPE


def block(t: list[float], sensor: Sensor = A) -> Samples:
    return Samples.checked(sensor, t, np.zeros((len(t), 3)))


def mapped(clock: PhoneClock, t: list[float], host: float, sensor: Sensor = A) -> list[float]:
    found = clock.mapped(block(t, sensor), host)
    return [] if found is None else found.t.tolist()


def test_a_phone_that_carries_on_is_not_touched():
    clock, samples = PhoneClock(), block([1.7e9, 1.7e9 + 0.01])
    assert clock.mapped(samples, 5.0) is samples
    assert mapped(clock, [1.7e9 + 3600.0], 3605.0) == [1.7e9 + 3600.0]
    assert (clock.offset, clock.restarts, clock.leaps) == (0.0, 0, 0)


def test_a_new_session_goes_on_by_what_the_host_saw_go_by():
    clock = PhoneClock()
    clock.meet(1)
    mapped(clock, [100.0, 200.0], 1000.0)
    assert not clock.meet(1)
    assert clock.meet(2)
    assert mapped(clock, [0.5, 0.6], 1030.0) == pytest.approx([230.0, 230.1])
    assert mapped(clock, [0.5, 0.6], 1030.0, G) == pytest.approx([230.0, 230.1])
    assert clock.restarts == 1
    assert clock.phone(230.0) == pytest.approx(0.5)


def test_a_phone_without_sessions_that_counts_from_zero_again_is_noticed():
    clock = PhoneClock()
    mapped(clock, [100.0, 200.0], 1000.0)
    mapped(clock, [100.0, 200.0], 1000.0, G)
    assert mapped(clock, [0.0, 0.01], 1010.0, G) == pytest.approx([210.0, 210.01])
    assert mapped(clock, [0.0, 0.01], 1010.0) == pytest.approx([210.0, 210.01])
    assert clock.restarts == 1


def test_streams_that_come_one_after_the_other_are_no_restart():
    clock = PhoneClock()
    mapped(clock, [0.0, 10.0], 0.0, G)
    assert mapped(clock, [0.0, 10.0], 0.0, A) == [0.0, 10.0]
    assert clock.restarts == 0


def test_samples_out_of_order_are_dropped_and_counted():
    clock = PhoneClock()
    mapped(clock, [1.0, 2.0], 0.0)
    assert mapped(clock, [1.5, 1.9, 2.0, 2.1], 0.1) == [2.0, 2.1]
    assert mapped(clock, [1.5], 0.1) == []
    assert (clock.disordered, clock.restarts) == (3, 0)


@pytest.mark.parametrize("ahead", [LEAP_S * 2, 9e9])
def test_a_leap_of_years_is_no_gap(ahead: float):
    clock = PhoneClock()
    mapped(clock, [0.0, 50.0], 1000.0)
    assert mapped(clock, [ahead, ahead + 1.0], 1060.0) == pytest.approx([110.0, 111.0], abs=1e-3)
    assert clock.leaps == 1


def test_a_gap_that_the_host_lived_through_stays():
    clock = PhoneClock()
    mapped(clock, [0.0], 1000.0)
    assert mapped(clock, [3 * LEAP_S], 1000.0 + 3 * LEAP_S) == [3 * LEAP_S]
    assert clock.leaps == 0


@pytest.mark.parametrize("pause", [2 * GAP_S, 0.9 * LEAP_S, LEAP_S, 50 * LEAP_S])
def test_pauses_within_a_block_are_bounded_until_the_engine_caught_up(pause: float):
    clock, counted = PhoneClock(), min(pause, LEAP_S)
    most = int(GAPS_S // counted)
    stamps = [i * pause for i in range(most + 10)]
    assert mapped(clock, stamps, 0.0) == stamps[: most + 1]
    assert (clock.disordered, clock.leaps) == (9, 0)
    assert mapped(clock, [stamps[-1], stamps[-1] + 1.0], 0.0) == [stamps[most] + 1.0, stamps[most] + 2.0]
    assert clock.leaps == 1
    clock.caught_up()
    late = stamps[-1] + 1.0 + counted
    assert mapped(clock, [late], 0.0) == [stamps[most] + 2.0 + counted]
    assert clock.leaps == 1


@pytest.mark.parametrize("kind", [Tick, lambda t: Charging(t, True)])
def test_pauses_between_events_are_bounded_too(kind: Callable[[float], Event]):
    clock = PhoneClock()
    times = [clock.mapped(kind(i * LEAP_S), 0.0).t for i in range(100)]
    assert times[14] == 14 * LEAP_S
    assert times[-1] == 14 * LEAP_S + 85.0


def test_short_pauses_are_not_counted():
    clock = PhoneClock()
    stamps = [i * GAP_S for i in range(100_000)]
    assert mapped(clock, stamps, 0.0) == stamps


def test_the_time_between_samples_is_the_hosts():
    clock = PhoneClock()
    assert clock.now(5.0) is None
    mapped(clock, [100.0], 5.0)
    assert clock.now(35.0) == 130.0


moves = st.lists(
    st.tuples(
        st.sampled_from([A, G]),
        st.floats(-1e9, 1e9, allow_nan=False),
        st.floats(0.0, 1e6),
        st.none() | st.integers(0, 2),
    ),
    max_size=20,
)


@given(moves)
def test_whatever_the_phone_does_each_stream_runs_forward(moves: list):
    clock, host, streams = PhoneClock(), 0.0, {A: [-math.inf], G: [-math.inf]}
    for sensor, t, passed, session in moves:
        host += passed
        if session is not None:
            clock.meet(session)
        streams[sensor] += mapped(clock, [t, t + 0.5], host, sensor)
        clock.mapped(Tick(t), host)
        event = clock.mapped(Charging(t, True), host)
        assert isinstance(event, Charging) and math.isfinite(event.t)
    for times in streams.values():
        assert all(a <= b for a, b in itertools.pairwise(times))


@pytest.mark.parametrize("jump", [-LEAP_S, 2 * LEAP_S])
def test_a_jump_of_the_clock_among_blocks_read_at_once_is_one_jump(jump: float) -> None:
    """The sensors' blocks take turns on the line, and the gyroscope's are handed on first."""
    begin, clock = 10 * LEAP_S, PhoneClock()
    stamps = [begin + k + jump * (k >= 5) for k in range(10)]
    read = [block([t, t + 0.9], sensor) for t in stamps for sensor in (A, G)]
    for record in join_blocks(read):
        clock.mapped(record, 1000.0)
    assert clock.restarts + clock.leaps == 1 and clock.disordered == 0
    assert clock.newest - begin < 20.0
