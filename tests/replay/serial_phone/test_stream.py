"""A phone's stream alone: whole and in step however it is cut, asleep, awake and thinned as told."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import hypothesis
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.calib_core.streams.events import Charging, End, Location, Tick
from stillcal.calib_core.streams.samples import Samples
from stillcal.daemon.wire.messages import Grant, Message, Rate, Status
from stillcal.replay.serial_phone.stream import PhoneEvent, PhoneStream
from tests.support.phone_pieces import EVENTS, Piece, pieces, whole
from tests.support.wire_said import A, G, joined, same


def drained(stream: PhoneStream, answer: Callable[[float], Iterable[Any]]) -> list[Message]:
    """Run a stream to its end; `answer` gives the commands at each time at which it waits."""
    told: list[Message] = []
    for _ in range(100_000):
        if stream.done:
            return told
        if stream.waiting:
            for command in answer(stream.t):
                stream.obey(command)
        told += stream.advance()
    raise AssertionError("the stream does not end")


@given(st.lists(st.floats(0, 10), max_size=6), st.floats(0.05, 20), st.booleans())
@hypothesis.settings(deadline=None)
def test_a_stream_is_sent_whole_and_in_step_however_it_is_cut(
    cuts: list[float], step: float, credit: bool
) -> None:
    a, g = whole(10.0)
    told = drained(PhoneStream(pieces(a, g, cuts), credit), lambda t: [Grant(t + step)])
    assert same(joined(told, A), a) and same(joined(told, G), g)
    assert [m for m in told if isinstance(m, Charging | Location)] == list(EVENTS)
    assert told[-1] == End(math.nextafter(max(a.t[-1], g.t[-1]), math.inf))
    heard = -math.inf
    for message in told:
        if isinstance(message, Tick):
            heard = max(heard, message.t)
        elif isinstance(message, Samples):
            assert message.t[0] >= heard


@given(
    st.lists(st.tuples(st.floats(0, 10), st.booleans(), st.floats(0, 3)), max_size=8),
    st.lists(st.floats(0, 10)),
)
def test_sleep_skips_and_sense_wakes_at_the_very_sample(
    plan: list[tuple[float, bool, float]], cuts: list[float]
) -> None:
    a, g = whole(10.0)
    plan = sorted(plan)
    on_times: list[tuple[float, Any]] = []

    def answer(t: float) -> list[Any]:
        due = [p for p in plan if p[0] <= t]
        del plan[: len(due)]
        commands: list[Any] = [Sense(math.inf) if sense else Sleep(t + nap) for _, sense, nap in due]
        on_times.append((t, commands[-1] if commands else None))
        return [*commands, Grant(plan[0][0] if plan else math.inf)]

    events: tuple[PhoneEvent, ...] = ()
    told = drained(PhoneStream(pieces(a, g, cuts, events)), answer)
    asleep: list[tuple[float, float]] = []
    for t, command in on_times:
        if asleep and command is not None and asleep[-1][1] > t:
            asleep[-1] = (asleep[-1][0], t)
        if isinstance(command, Sleep):
            asleep.append((t, command.until))
    for sent, sensor in ((a, A), (g, G)):
        off = np.zeros(len(sent), bool)
        for start, stop in asleep:
            off |= (sent.t >= start) & (sent.t < stop)
        assert joined(told, sensor).t.tolist() == sent.t[~off].tolist()
    (status,) = [m for m in told if isinstance(m, Status)][-1:]
    end = math.nextafter(max(a.t[-1], g.t[-1]), math.inf)
    begin = min(a.t[0], g.t[0])
    slept = sum(max(0.0, min(stop, end) - max(start, begin)) for start, stop in asleep)
    assert status.on_time == pytest.approx(end - begin - slept, abs=1e-9)


def test_time_stands_at_every_event_so_that_its_answer_takes_effect_there() -> None:
    a, g = whole(10.0)
    stream = PhoneStream(pieces(a, g, []))
    stream.obey(Sleep(9.0))
    stream.obey(Grant(math.inf))
    times = []
    while not stream.done:
        told = stream.advance()
        assert not stream.waiting or isinstance(told[-1], Tick)
        if stream.waiting:
            times.append(stream.t)
            stream.obey(Grant(math.inf))
        if stream.t == 7.25:
            stream.obey(Sense(8.0))
            rest = drained(stream, lambda t: [Grant(math.inf)])
            assert joined(rest, A).t[0] == a.between(7.25, 9).t[0]
    assert times == [0.5, 7.25]


def test_a_rate_thins_both_streams_evenly_however_they_are_cut() -> None:
    a, g = whole(10.0)
    kept = []
    for cuts in ([], [1.237, 1.25, 3.512, 7.0]):
        stream = PhoneStream(pieces(a, g, cuts), credit=False)
        stream.obey(Rate(20.0))
        kept.append(drained(stream, lambda t: []))
    for told in kept:
        assert joined(told, A).t.tolist() == a.t[::5].tolist()
        assert joined(told, G).t.tolist() == g.t[::4].tolist()


def test_nothing_goes_beyond_the_limit_or_without_a_grant() -> None:
    a, g = whole(5.0)
    stream = PhoneStream(pieces(a, g, [2.0], ()))
    assert stream.waiting and stream.advance() == []
    stream.obey(Grant(3.0))
    told = [*stream.advance(1.0), *stream.advance(1.0), *stream.advance(10.0), *stream.advance(10.0)]
    assert joined(told, A).t[-1] == a.between(0, 3).t[-1]
    assert told[-2:] == stream.standing() and stream.t == 3.0


def test_an_empty_stream_is_done() -> None:
    for chunks in ([], [Piece(Samples.empty(A), None)]):
        assert PhoneStream(chunks).done
