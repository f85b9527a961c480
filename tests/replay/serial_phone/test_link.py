"""A phone on a pseudo-terminal, and what the daemon's serial source hears of it."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.calib_core.streams.events import Charging, End, Location, Tick
from stillcal.daemon.sources.base import LinkDown, LinkUp, SerialSettings
from stillcal.daemon.sources.serial import SerialSource
from stillcal.daemon.wire.encoder import Form, WireSettings
from stillcal.daemon.wire.messages import Grant, Hello, Status
from stillcal.daemon.wire.sample_blocks import Coding
from stillcal.replay.serial_phone.link import LinkSettings, PhoneLink, serve_phone
from stillcal.replay.serial_phone.stream import PhoneStream
from tests.support.living import within_reason
from tests.support.phone_pieces import EVENTS, pieces, whole
from tests.support.serial_line import seen, until
from tests.support.wire_said import A, G, joined, same


@contextlib.asynccontextmanager
async def served(link: PhoneLink) -> AsyncIterator[asyncio.Task[None]]:
    async with link:
        task = asyncio.create_task(link.serve())
        yield task
        task.cancel()


def port(path: Path | str) -> SerialSettings:
    return SerialSettings(str(path), retry_s=0.001, retry_max_s=0.01)


async def heard(source: SerialSource, step: float = 0.7, end: float = math.inf) -> list[Any]:
    """Grant and listen until the phone's end, or until its time has come to `end`."""
    records: list[Any] = []
    while came := await source.take():
        records += came
        if any(isinstance(record, End) for record in came):
            source.send(Sleep(math.inf))
            return records
        for tick in (record for record in came if isinstance(record, Tick)):
            if tick.t >= end:
                return records
            source.send(Grant(tick.t + step))
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
            while not any(isinstance(record, End) for record in records):
                came = await source.take()
                records += came
                for tick in (record for record in came if isinstance(record, Tick)):
                    stop = math.floor(tick.t) + 1.0
                    source.send(Sense(stop) if stop % 2 else Sleep(stop))
                    source.send(Grant(stop))
            source.send(Sleep(math.inf))
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
                records += await heard(source, end=8.0 * life)
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
                    records += await heard(source, end=stop)
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
            await until(source, seen(Tick, 3))
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
        full_blocks = (len(a) + len(g)) / 256  # as many frames as a phone makes that is not paced
        assert source.wire.frames > 2 * full_blocks

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
