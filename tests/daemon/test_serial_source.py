"""The serial source against real pseudo-terminals: loss, return, garbage, back-pressure, commands."""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st
from living import within_reason

from stillcal.calib_core.events import Tick
from stillcal.calib_core.samples import Samples, Sensor
from stillcal.calib_core.stationary import Sense
from stillcal.daemon.serial_source import SerialSource
from stillcal.daemon.source_base import LinkDown, LinkUp, Record, SerialSettings
from stillcal.daemon.wire import Form, Identify, Message, WireDecoder, WireEncoder, WireSettings


class Device:
    """The other end of a serial line: a pseudo-terminal, linked to at `path`."""

    def __init__(self, path: Path) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = path
        path.symlink_to(os.ttyname(self._slave))

    def write(self, data: bytes) -> None:
        assert os.write(self.master, data) == len(data)

    async def read(self) -> bytes:
        loop, ready = asyncio.get_running_loop(), asyncio.Event()
        loop.add_reader(self.master, ready.set)
        await ready.wait()
        loop.remove_reader(self.master)
        return os.read(self.master, 65_536)

    async def commands(self, wanted: int) -> list[Message]:
        decoder, came = WireDecoder(), []
        while len(came) < wanted:
            came += decoder.feed(await self.read())
        return came

    def unplug(self) -> None:
        self.path.unlink()
        os.close(self.master)
        os.close(self._slave)


def quick(path: Path | str, **chosen: Any) -> SerialSettings:
    return SerialSettings(str(path), retry_s=0.001, retry_max_s=0.004, **chosen)


async def until(source: SerialSource, enough: Callable[[list[Record]], bool]) -> list[Record]:
    records: list[Record] = []
    while not enough(records):
        records += await source.take()
    return records


def seen(kind: type, times: int = 1) -> Callable[[list[Record]], bool]:
    return lambda records: sum(isinstance(r, kind) for r in records) >= times


def lost(records: list[Record]) -> bool:
    """Whether an open device was lost; that none could be opened does not count."""
    return any(isinstance(r, LinkDown) and r.device for r in records)


def block(start: float, n: int = 4) -> Samples:
    return Samples.checked(Sensor.ACCELEROMETER, start + np.arange(n) / 100, np.full((n, 3), start))


def starts(records: list[Record]) -> list[float]:
    return [float(r.t[0]) for r in records if isinstance(r, Samples)]


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
            assert isinstance(down, LinkDown) and "No such file" in down.reason
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
            assert [d.reason for d in downs] == ["hung up"] * 5

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


def test_a_device_that_is_open_is_locked_against_a_second_reader(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path)) as first, SerialSource(quick(device.path)) as second:
            assert isinstance((await first.take())[0], LinkUp)
            (down,) = await second.take()
            assert isinstance(down, LinkDown) and "lock" in down.reason
            first.close()
            assert isinstance((await until(second, seen(LinkUp)))[-1], LinkUp)

    within_reason(test())


def test_garbage_at_connect_costs_nothing_that_follows(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path)) as source:
            await device.read()
            encoder, noise = WireEncoder(), np.random.default_rng(3).bytes(3000)
            device.write(noise + encoder.encode(block(1.0))[100:])
            device.write(b"".join(encoder.encode(block(float(i))) for i in range(2, 12)))
            records = await until(source, lambda r: len(starts(r)) == 10)
            assert starts(records) == [float(i) for i in range(2, 12)]
            assert source.wire.resynchronisations == 1
            assert source.wire.garbage_bytes > 2900

    within_reason(test())


def test_silence_is_no_hang_up(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path)) as source:
            await device.read()
            source._read()  # as after a wake-up for nothing
            assert source.connected

    within_reason(test())


def test_a_full_queue_stops_reading_and_holds_the_sender_back(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path, queue=8)) as source:
            await device.read()
            os.set_blocking(device.master, False)
            encoder, sent, unsent = WireEncoder(), 0, b""
            frame = len(WireEncoder().encode(block(0.0)))
            while True:  # until the kernel takes no more although the loop has had its turns
                try:
                    unsent = unsent or encoder.encode(block(float(sent)))
                    unsent = unsent[os.write(device.master, unsent) :]
                    sent += not unsent
                except BlockingIOError:
                    if source.link.pauses:
                        break
                    await asyncio.sleep(0)
            assert len(source._records) <= 8 + 4096 // frame + 1
            records: list[Record] = []
            async for record in source:
                records.append(record)
                if len(starts(records)) == sent:
                    break
            assert starts(records) == [float(i) for i in range(sent)]

    within_reason(test())


async def resting_source(device: Device, source: SerialSource, seconds: float) -> asyncio.Task[None]:
    """Let a source that has greeted its device rest so long."""
    await device.read()
    resting = asyncio.create_task(source.rest(seconds))
    await asyncio.sleep(0)
    return resting


def test_at_rest_a_trickle_wakes_nobody_and_closing_takes_what_gathered(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path)) as source:
            resting = await resting_source(device, source, 60.0)
            for i in range(10):
                device.write(WireEncoder().encode(Tick(float(i))))
                await asyncio.sleep(0.001)
            assert source.wire.bytes == 0
            resting.cancel()
        assert [r.t for r in await source.take() if isinstance(r, Tick)] == [float(i) for i in range(10)]

    within_reason(test())


def test_after_a_rest_all_is_there_and_the_line_is_watched_again(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path)) as source:
            resting = await resting_source(device, source, 0.05)
            device.write(WireEncoder().encode(Tick(1.0)))
            await resting
            assert source.pending and Tick(1.0) in await source.take()
            device.write(WireEncoder().encode(Tick(2.0)))
            assert await source.take() == [Tick(2.0)]

    within_reason(test())


def test_a_flood_is_read_on_while_the_daemon_rests(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path)) as source:
            await device.read()
            await source.rest(0.001)
            frame, written = WireEncoder().encode(block(0.0, 100)), 0
            resting: asyncio.Task[None] | None = None
            for i in range(120):
                device.write(frame)
                written += len(frame)
                while source.wire.bytes < written:
                    await asyncio.sleep(0)
                if i == 60:  # 200,000 bytes at once
                    resting = asyncio.create_task(source.rest(60.0))
            assert resting is not None and not resting.done()
            resting.cancel()

    within_reason(test())


def test_a_line_that_is_lost_in_a_rest_comes_back(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path)) as source:
            resting = await resting_source(device, source, 0.05)
            device.unplug()
            await resting
            await until(source, lost)
            again = Device(tmp_path / "tty")
            await until(source, seen(LinkUp))
            again.write(WireEncoder().encode(Tick(1.0)))
            assert await source.take() == [Tick(1.0)]

    within_reason(test())


def test_commands_go_down_in_the_form_that_the_device_speaks(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path)) as source:
            await device.read()
            for form, expected in ((Form.TEXT, b"sense,12000000*"), (Form.BINARY, b"\0\xb1")):
                device.write(WireEncoder(WireSettings(form=form)).encode(Tick(1.0)))
                await until(source, seen(Tick))
                assert source.send(Sense(12.0))
                said = await device.read()
                assert said.startswith(expected)
                assert WireDecoder().feed(said) == [Sense(12.0)]
            assert source.link.commands_sent == 2

    within_reason(test())


def test_a_command_to_nobody_or_to_a_deaf_device_is_refused_and_counted(tmp_path: Path) -> None:
    async def test() -> None:
        async with SerialSource(quick(tmp_path / "tty")) as source:
            assert not source.send(Sense(1.0))
            Device(tmp_path / "tty")
            await until(source, seen(LinkUp))
            while source.send(Sense(1.0)):
                pass
            assert source.link.commands_dropped == 2
            assert len(source._unsent) <= 65_536

    within_reason(test())


def test_a_flood_of_commands_arrives_whole_once_the_device_reads(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path)) as source:
            await until(source, seen(LinkUp))
            sent = [Sense(float(i)) for i in range(2000)]
            assert all(source.send(command) for command in sent)
            assert await device.commands(2002) == [Identify(), Identify(), *sent]

    within_reason(test())


def test_closing_loses_no_record_and_ends_the_iteration(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        source = SerialSource(quick(device.path))
        async with source:
            await device.read()
            device.write(b"".join(WireEncoder().encode(block(float(i))) for i in range(20)))
            while len(source._records) < 21:
                await asyncio.sleep(0)
        records = [record async for record in source]
        assert starts(records) == [float(i) for i in range(20)]
        assert records[-1] == LinkDown(str(device.path), "closed")

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
