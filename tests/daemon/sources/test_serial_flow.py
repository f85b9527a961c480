"""What comes and goes on an open serial line: garbage, back-pressure, rests, commands, closing."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import numpy as np
import pytest

from stillcal.calib_core.static.settings import Sense
from stillcal.calib_core.streams.events import Tick
from stillcal.daemon.sources.base import LinkDown, LinkUp
from stillcal.daemon.sources.serial import READ_BYTES, SerialSource
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.encoder import Form, WireEncoder, WireSettings
from stillcal.daemon.wire.messages import Identify
from tests.support.living import within_reason
from tests.support.serial_line import Device, block, lost, quick, seen, starts, until


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
            assert len(source._records) <= 8 + READ_BYTES // frame + 1
            records = await until(source, lambda r: len(starts(r)) == sent)
            assert starts(records) == [float(i) for i in range(sent)]

    within_reason(test())


async def resting_source(device: Device, source: SerialSource, seconds: float) -> asyncio.Task[None]:
    """Let a source that has greeted its device rest so long."""
    await device.read()
    resting = asyncio.create_task(source.let_gather(seconds))
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


@pytest.mark.slow
def test_a_flood_is_read_on_while_the_daemon_rests(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        async with SerialSource(quick(device.path)) as source:
            await device.read()
            await source.let_gather(0.001)
            frame, written = WireEncoder().encode(block(0.0, 100)), 0
            resting: asyncio.Task[None] | None = None
            for i in range(120):
                device.write(frame)
                written += len(frame)
                while source.wire.bytes < written:
                    await asyncio.sleep(0)
                if i == 60:  # 200,000 bytes at once
                    resting = asyncio.create_task(source.let_gather(60.0))
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


def test_closing_loses_no_record(tmp_path: Path) -> None:
    async def test() -> None:
        device = Device(tmp_path / "tty")
        source = SerialSource(quick(device.path))
        async with source:
            await device.read()
            device.write(b"".join(WireEncoder().encode(block(float(i))) for i in range(20)))
            while len(source._records) < 21:
                await asyncio.sleep(0)
        records = await source.take()
        assert starts(records) == [float(i) for i in range(20)]
        assert records[-1] == LinkDown(str(device.path), "closed")
        assert await source.take() == []

    within_reason(test())
