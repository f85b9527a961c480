"""The serial source finds, opens, locks, loses and finds again real pseudo-terminals."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from stillcal.calib_core.streams.events import Tick
from stillcal.daemon.sources.base import LinkDown, LinkUp, Record, SerialSettings
from stillcal.daemon.sources.serial import SerialSource
from stillcal.daemon.wire.encoder import WireEncoder
from stillcal.daemon.wire.messages import Identify
from tests.support.living import within_reason
from tests.support.serial_line import Device, block, lost, quick, seen, starts, until


def test_a_device_is_opened_asked_and_heard(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path)) as source:
            assert await device.commands(2) == [Identify(), Identify()]  # one in either form
            device.write(WireEncoder().encode(Tick(5.0)))
            assert await until(source, seen(Tick)) == [LinkUp(str(device.path), 0), Tick(5.0)]
            assert source.connected and source.device == str(device.path)
        assert not source.connected
        assert await source.take() == [LinkDown(str(device.path), "closed")]
        assert await source.take() == []

    within_reason(test())


def test_a_device_that_appears_later_is_found_and_the_reason_said_once(tmp_path: Path) -> None:
    async def test() -> None:
        async with SerialSource(quick(tmp_path / "tty")) as source:
            (down,) = await source.take()
            assert down == LinkDown("", f"{tmp_path / 'tty'}: No such file or directory")
            while source.link.failed_attempts < 4:
                await asyncio.sleep(0)
            device = Device(tmp_path / "tty")
            (up,) = await until(source, seen(LinkUp))
            assert isinstance(up, LinkUp) and up.attempts >= 4
            device.unplug()

    within_reason(test())


def test_unplugged_and_replugged_it_goes_on_and_nothing_that_arrived_is_lost(tmp_path: Path) -> None:
    async def test() -> None:
        encoder = WireEncoder()
        async with SerialSource(quick(tmp_path / "tty")) as source:
            records: list[Record] = []
            written = 0
            for life in range(5):
                device = Device(tmp_path / "tty")
                await device.read()  # the daemon's question: it has opened the device
                whole = b"".join(encoder.encode(block(100.0 * life + i)) for i in range(10))
                half = encoder.encode(block(100.0 * life + 50))[:60]
                device.write(whole + half)
                written += len(whole + half)
                while source.wire.bytes < written:
                    await asyncio.sleep(0)
                device.unplug()
                records += await until(source, lost)
            assert starts(records) == [100.0 * life + i for life in range(5) for i in range(10)]
            assert (source.wire.truncated, source.wire.bad_frames) == (5, 0)
            assert source.wire.lost_samples == 4 * 4
            assert (source.link.connections, source.link.disconnections) == (5, 5)
            downs = [r for r in records if isinstance(r, LinkDown) and r.device]
            assert [d.reason for d in downs] == ["the device closed the line"] * 5

    within_reason(test())


def test_a_device_that_changes_its_name_is_found_by_its_pattern(tmp_path: Path) -> None:
    async def test() -> None:
        async with SerialSource(quick(tmp_path / "phone-*")) as source:
            names = []
            for name in ("phone-A", "phone-B", "phone-A"):
                device = Device(tmp_path / name)
                (up,) = [r for r in await until(source, seen(LinkUp)) if isinstance(r, LinkUp)]
                names.append(Path(up.device).name)
                device.unplug()
            assert names == ["phone-A", "phone-B", "phone-A"]

    within_reason(test())


def test_of_several_candidates_the_first_that_opens_is_taken(tmp_path: Path) -> None:
    async def test() -> None:
        (tmp_path / "phone-1").symlink_to(tmp_path / "gone")
        (tmp_path / "phone-2").write_text("no terminal")
        busy, free = Device(tmp_path / "phone-3"), Device(tmp_path / "phone-4")
        with serial.Serial(str(busy.path), exclusive=True):
            async with SerialSource(quick(tmp_path / "phone-*")) as source:
                assert await source.take() == [LinkUp(str(free.path), 0)]

    within_reason(test())


def test_what_is_no_serial_line_is_said_so(tmp_path: Path) -> None:
    async def test() -> None:
        (tmp_path / "file").touch()
        async with SerialSource(quick(tmp_path / "file")) as source:
            assert await source.take() == [LinkDown("", f"{tmp_path / 'file'}: it is no serial line")]

    within_reason(test())


def test_a_device_that_is_open_is_locked_against_a_second_reader(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path)) as first, SerialSource(quick(device.path)) as second:
            assert isinstance((await first.take())[0], LinkUp)
            (down,) = await second.take()
            assert down == LinkDown("", f"{device.path}: another program has locked it")
            first.close()
            assert isinstance((await until(second, seen(LinkUp)))[-1], LinkUp)

    within_reason(test())


def test_silence_is_no_hang_up(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path)) as source:
            await device.read()
            source._read()  # as after a wake-up for nothing
            assert source.connected

    within_reason(test())


def test_a_device_that_only_hangs_up_is_tried_ever_less_often(tmp_path: Path) -> None:
    async def test() -> None:
        async with SerialSource(quick(tmp_path / "tty")) as source:
            for failures in range(1, 5):
                device = Device(tmp_path / "tty")
                await until(source, seen(LinkUp))
                device.unplug()
                await until(source, lost)
                assert source._failures >= failures

    within_reason(test())


@given(st.integers(1, 10_000), st.floats(0, 1), st.text(min_size=1, max_size=8))
def test_the_wait_doubles_within_its_bounds_and_is_the_same_each_time(
    attempt: int, jitter: float, port: str
) -> None:
    chosen = SerialSettings(port, retry_s=0.1, retry_max_s=5.0, jitter=jitter)
    full = min(0.1 * 2.0 ** min(attempt - 1, 60), 5.0)
    assert full * (1 - jitter) <= chosen.wait(attempt) <= full * (1 + jitter)
    assert chosen.wait(attempt) == chosen.wait(attempt)


@pytest.mark.parametrize(
    "bad",
    [{"port": ""}, {"baud": 9}, {"retry_s": 0.0}, {"retry_max_s": 0.01}, {"jitter": 1.5}, {"queue": 0}],
    ids=lambda bad: next(iter(bad)),
)
def test_settings_out_of_range_are_refused_by_name(bad: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        SerialSettings(**{"port": "x", **bad})
