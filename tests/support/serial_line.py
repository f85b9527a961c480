"""A device on a pseudo-terminal, and what the serial source heard of it: what its tests share."""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.sources.base import LinkDown, Record, SerialSettings
from stillcal.daemon.sources.serial import SerialSource
from stillcal.daemon.wire.decoder import WireDecoder
from stillcal.daemon.wire.messages import Message


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
