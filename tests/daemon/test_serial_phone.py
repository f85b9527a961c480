"""A phone on a pseudo-terminal, from its stream to what the daemon's serial source hears of it."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
from collections.abc import AsyncIterator, Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from living import within_reason

from stillcal.calib_core.events import Charging, End, Location, Tick
from stillcal.calib_core.samples import Samples, Sensor
from stillcal.calib_core.stationary import Sense, Sleep
from stillcal.daemon.serial_source import SerialSource
from stillcal.daemon.source_base import LinkDown, LinkUp, SerialSettings
from stillcal.daemon.wire import Coding, Form, Grant, Hello, Message, Rate, Status, WireSettings
from stillcal.replay.phone_link import LinkSettings, PhoneLink, serve_phone
from stillcal.replay.phone_stream import PhoneEvent, PhoneStream

A, G = Sensor.ACCELEROMETER, Sensor.GYROSCOPE


@dataclass(frozen=True)
class Piece:
    """A chunk as the simulated phone and recordings have them."""

    accelerometer: Samples
    gyroscope: Samples | None
    events: tuple[PhoneEvent, ...] = ()


def whole(seconds: float, seed: int = 1) -> tuple[Samples, Samples]:
    """Both sensors at their own rates, with stamps of all 53 bits."""
    rng = np.random.default_rng(seed)

    def sensor(which: Sensor, rate: float) -> Samples:
        n = int(seconds * rate)
        t = (np.arange(n) + rng.uniform(0.1, 0.9, n)) / rate
        warm = rng.normal(30, 1, n) if which is A else None
        return Samples.checked(which, t, rng.normal(0, 9, (n, 3)), warm, t + 0.01)

    return sensor(A, 100.0), sensor(G, 80.0)


EVENTS: tuple[PhoneEvent, ...] = (Location(0.5, 52.2, 0.1), Charging(7.25, True), Charging(7.25, False))


def pieces(
    a: Samples, g: Samples, cuts: Iterable[float], events: Iterable[PhoneEvent] = EVENTS
) -> list[Piece]:
    edges = [-math.inf, *sorted(cuts), math.inf]
    return [
        Piece(a.between(lo, hi), g.between(lo, hi), tuple(e for e in events if lo <= e.t < hi))
        for lo, hi in itertools.pairwise(edges)
    ]


def joined(messages: Iterable[object], sensor: Sensor) -> Samples:
    runs = [m for m in messages if isinstance(m, Samples) and m.sensor is sensor]
    return Samples.joined(runs) if runs else Samples.empty(sensor)


def same(a: Samples, b: Samples) -> bool:
    def columns(s: Samples) -> list[bytes | None]:
        return [None if c is None else c.tobytes() for c in (s.t, s.xyz, s.temperature, s.t_arrival)]

    return columns(a) == columns(b)


# The stream alone


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


# The phone and the daemon's source, on a real terminal


@contextlib.asynccontextmanager
async def served(link: PhoneLink) -> AsyncIterator[asyncio.Task[None]]:
    async with link:
        task = asyncio.create_task(link.serve())
        yield task
        task.cancel()


def port(path: Path | str) -> SerialSettings:
    return SerialSettings(str(path), retry_s=0.001, retry_max_s=0.01)


async def heard(source: SerialSource, step: float = 0.7, until: float = math.inf) -> list[Any]:
    """Grant and listen until the phone's end, or until its time has come to `until`."""
    records: list[Any] = []
    async for record in source:
        records.append(record)
        if isinstance(record, End):
            source.send(Sleep(math.inf))
            return records
        if isinstance(record, Tick):
            if record.t >= until:
                return records
            source.send(Grant(record.t + step))
    raise AssertionError("the source ended before the phone")


def test_a_day_over_the_wire_is_the_day_bit_for_bit(tmp_path: Path) -> None:
    async def test() -> None:
        a, g = whole(60.0)
        link = PhoneLink(
            PhoneStream(pieces(a, g, range(7, 60, 7))),
            Hello(session=9, flow="credit", claims={"device": "p"}),
        )
        where = link.plug(tmp_path / "ttyPHONE")
        async with served(link) as task, SerialSource(port(where)) as source:
            records = await heard(source)
            await task
            assert same(joined(records, A), a) and same(joined(records, G), g)
            assert [m for m in records if isinstance(m, Charging | Location)] == list(EVENTS)
            assert records[:2] == [
                LinkUp(str(where), 0),
                Hello(session=9, flow="credit", claims={"device": "p"}),
            ]
            assert source.wire.garbage_bytes == source.wire.lost_samples == source.wire.lost_messages == 0
            assert link.heard.bad_frames == 0
        assert not where.is_symlink()

    within_reason(test())


@pytest.mark.parametrize(
    "wire", [WireSettings(form=Form.TEXT), WireSettings(coding=Coding.FLOAT, block=32)], ids=["text", "float"]
)
def test_other_forms_bring_every_sample_too(wire: WireSettings) -> None:
    async def test() -> None:
        a, g = whole(10.0)
        link = PhoneLink(PhoneStream(pieces(a, g, [5.0])), Hello(flow="credit"), LinkSettings(wire))
        async with served(link) as task, SerialSource(port(link.plug())) as source:
            records = await heard(source, step=3.0)
            await task
            assert np.allclose(joined(records, A).t, a.t, atol=1e-6)
            assert np.allclose(joined(records, G).xyz, g.xyz, rtol=1e-6)
            assert source.wire.garbage_bytes == 0

    within_reason(test())


def test_sleep_on_the_wire_is_exact_to_the_sample() -> None:
    async def test() -> None:
        a, g = whole(20.0)
        link = PhoneLink(PhoneStream(pieces(a, g, [], ())), Hello(flow="credit"))
        async with served(link) as task, SerialSource(port(link.plug())) as source:
            records: list[Any] = []
            async for record in source:
                records.append(record)
                if isinstance(record, End):
                    source.send(Sleep(math.inf))
                    break
                if isinstance(record, Tick):
                    stop = math.floor(record.t) + 1.0
                    source.send(Sense(stop) if stop % 2 else Sleep(stop))
                    source.send(Grant(stop))
            await task
            expected = a.t[np.floor(a.t) % 2 == 0]
            assert joined(records, A).t.tolist() == expected.tolist()
            last = [r for r in records if isinstance(r, Status)][-1]
            assert last.wakeups == 10 and last.on_time == pytest.approx(10.0, abs=0.1)

    within_reason(test())


def test_pulled_out_and_plugged_in_under_another_name_it_goes_on(tmp_path: Path) -> None:
    async def test() -> None:
        a, g = whole(40.0)
        link = PhoneLink(PhoneStream(pieces(a, g, range(40), ())), Hello(session=3, flow="credit"))
        link.plug(tmp_path / "tty0")
        async with served(link) as task, SerialSource(port(tmp_path / "tty*")) as source:
            records: list[Any] = []
            for life in range(1, 5):
                records += await heard(source, until=8.0 * life)
                link.unplug()
                link.plug(tmp_path / f"tty{life % 2}")
            records += await heard(source)
            await task
            assert same(joined(records, A), a) and same(joined(records, G), g)
            assert source.link.connections == 5
            assert len([r for r in records if isinstance(r, LinkDown) and r.device]) == 4
            assert (source.wire.restarts, source.wire.lost_samples) == (0, 0)

    within_reason(test())


def test_pulled_out_in_the_middle_of_sending_what_is_lost_is_counted(tmp_path: Path) -> None:
    async def test() -> None:
        a, g = whole(120.0)
        link = PhoneLink(PhoneStream(pieces(a, g, [], ()), credit=False), Hello(session=3))
        link.plug(tmp_path / "tty0")
        async with served(link), SerialSource(port(tmp_path / "tty*")) as source:
            records: list[Any] = []
            while len(joined(records, G)) < 2000:
                records += await source.take()
            link.unplug()
            link.plug(tmp_path / "tty1")
            while not any(isinstance(r, End) for r in records):
                records += await source.take()
            for sensor, sent in ((A, a), (G, g)):
                came = joined(records, sensor)
                assert np.isin(came.t, sent.t).all() and (np.diff(came.t) > 0).all()
            arrived = len(joined(records, A)) + len(joined(records, G))
            assert arrived == source.wire.samples < len(a) + len(g)
            assert source.wire.lost_samples <= len(a) + len(g) - arrived
            assert source.wire.truncated <= 1

    within_reason(test())


def test_a_daemon_that_comes_back_finds_time_where_it_left_it(tmp_path: Path) -> None:
    async def test() -> None:
        a, g = whole(30.0)
        link = PhoneLink(PhoneStream(pieces(a, g, [], ())), Hello(session=3, flow="credit"))
        where = link.plug(tmp_path / "tty")
        async with served(link) as task:
            records: list[Any] = []
            for stop in (10.0, 20.0, math.inf):
                async with SerialSource(port(where)) as source:
                    records += await heard(source, until=stop)
                    if stop == math.inf:
                        await task
            assert same(joined(records, A), a) and same(joined(records, G), g)

    within_reason(test())


def test_a_lost_grant_is_asked_for_again() -> None:
    async def test() -> None:
        a, g = whole(3.0)
        link = PhoneLink(
            PhoneStream(pieces(a, g, [], ())), Hello(flow="credit"), LinkSettings(repeat_s=0.001)
        )
        async with served(link) as task, SerialSource(port(link.plug())) as source:
            ticks = 0
            async for record in source:
                ticks += isinstance(record, Tick)
                if ticks == 3:
                    break
            records = await heard(source, step=10.0)
            await task
            assert same(joined(records, A), a)

    within_reason(test())


def test_a_paced_phone_keeps_its_order_and_its_end(tmp_path: Path) -> None:
    async def test() -> None:
        a, g = whole(10.0)
        settings = LinkSettings(speed=200.0, credit=False)
        told: list[Path] = []
        phone = asyncio.create_task(
            serve_phone(pieces(a, g, [5.0]), {"device": "x"}, settings, tmp_path / "t", told.append)
        )
        await asyncio.sleep(0)
        async with SerialSource(port(told[0])) as source:
            records = await heard(source)
            await phone
        assert same(joined(records, A), a) and same(joined(records, G), g)
        assert next(r for r in records if isinstance(r, Hello)).flow == "free"
        assert source.wire.frames > 50

    within_reason(test())


def test_the_phone_takes_no_path_that_is_something_else(tmp_path: Path) -> None:
    async def test() -> None:
        (tmp_path / "tty").write_text("mine")
        link = PhoneLink(PhoneStream([]), Hello())
        with pytest.raises(FileExistsError, match="another path"):
            link.plug(tmp_path / "tty")
        assert (tmp_path / "tty").read_text() == "mine"

    within_reason(test())


@pytest.mark.parametrize("bad", [{"speed": 0.0}, {"step_s": -1.0}, {"repeat_s": math.nan}])
def test_settings_out_of_range_are_refused_by_name(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        LinkSettings(**bad)
