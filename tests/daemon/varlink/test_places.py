"""Places at the socket: whoever leaves gives its place back at once, and nobody keeps the others out."""

from __future__ import annotations

import asyncio
import json
import signal
import socket
import subprocess
import threading
from pathlib import Path

import pytest

from stillcal.daemon.settings import SocketSettings
from stillcal.daemon.varlink.server import OWN_DESCRIPTORS, places
from tests.support.asking import NAME, STILLCAL, Line, ask, connected
from tests.support.living import answering, until, within_reason

MONITOR = json.dumps({"method": f"{NAME}.Monitor", "more": True}).encode() + b"\0"
FEW = "[socket]\nconnections = 8\n"


async def listening(folder: Path) -> Line:
    """Listen to news; the first event has come."""
    line = await connected(folder)
    line[1].write(MONITOR)
    await line[0].readuntil(b"\0")
    return line


@pytest.mark.parametrize("how", ["closes", "half closes", "resets"])
def test_a_listener_that_leaves_gives_its_place_back(folder: Path, how: str) -> None:
    async def test() -> None:
        async with answering(folder, FEW) as service:
            for _ in range(24):
                reader, writer = await listening(folder)
                if how == "half closes":
                    writer.write_eof()
                    await reader.read()
                elif how == "resets":
                    writer.transport.abort()
                writer.close()
            assert "parameters" in await ask(await connected(folder), "GetStatus")
            await until(lambda: len(service.subscribers) == 0)

    within_reason(test())


def test_a_listener_that_leaves_before_it_is_heard_leaves_nothing_behind(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder, FEW) as service:
            for _ in range(24):
                with socket.socket(socket.AF_UNIX) as line:
                    line.connect(str(folder / "socket"))
                    line.sendall(MONITOR)
                await asyncio.sleep(0)
            assert "parameters" in await ask(await connected(folder), "GetStatus")
            await until(lambda: len(service.subscribers) == 0)

    within_reason(test())


def test_who_leaves_while_its_answer_is_computed_gives_its_place_back_at_once(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder, "[socket]\nconnections = 2\n") as service:
            over = threading.Event()
            busy = asyncio.ensure_future(service.engine_thread._run(over.wait))
            for _ in range(2):
                _, writer = await connected(folder)
                writer.write(json.dumps({"method": f"{NAME}.Calibrate"}).encode() + b"\0")
                await asyncio.sleep(0.05)  # it is asked, and waits for the engine's thread
                writer.close()
            assert "parameters" in await ask(await connected(folder), "GetStatus")
            assert not busy.done()
            over.set()
            await busy

    within_reason(test(), 5.0)


def test_as_many_listeners_as_there_are_places_keep_nobody_out(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder, FEW) as service:
            listeners = [await listening(folder) for _ in range(8)]
            assert len(service.subscribers) == 8
            assert "parameters" in await ask(await connected(folder), "GetStatus")
            assert await listeners[0][0].read() == b""  # the first to come has made room
            await until(lambda: len(service.subscribers) == 7)

    within_reason(test())


def test_idle_clients_go_before_listeners(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder, FEW) as service:
            listeners = [await listening(folder) for _ in range(4)]
            idle = [await connected(folder) for _ in range(12)]
            assert "parameters" in await ask(idle[-1], "GetStatus")
            assert len(service.subscribers) == len(listeners)

    within_reason(test())


def test_more_places_than_descriptors_lock_nobody_out(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limit = OWN_DESCRIPTORS + 8
    monkeypatch.setattr("resource.getrlimit", lambda _: (limit, limit))
    assert (places(4), places(8), places(4096)) == (4, 8, 8)

    async def test() -> None:
        async with answering(folder, "[socket]\nconnections = 4096\n") as service:
            idle = [await connected(folder) for _ in range(24)]
            assert "parameters" in await ask(idle[-1], "GetStatus")
            assert [await line[0].read() for line in idle[:16]] == [b""] * 16
            assert len(service.subscribers) == 0

    within_reason(test())


@pytest.mark.parametrize(("limit", "room"), [(1, 1), (24, 1), (OWN_DESCRIPTORS + 2, 2), (-1, 4096)])
def test_there_is_always_a_place(limit: int, room: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("resource.getrlimit", lambda _: (limit, limit))
    assert places(4096) == room  # -1: no limit


def test_query_monitor_and_ctrl_c_lock_nobody_out(folder: Path) -> None:
    command = [STILLCAL, "query", "Monitor", "--socket", str(folder / "socket")]

    async def test() -> None:
        async with answering(folder, "[socket]\nconnections = 2\n"):
            for _ in range(3):
                child = await asyncio.create_subprocess_exec(
                    *command, stdout=subprocess.PIPE, stderr=subprocess.PIPE
                )
                assert child.stdout is not None and await child.stdout.readline()
                child.send_signal(signal.SIGINT)
                _, said = await child.communicate()
                assert child.returncode == 130 and b"Traceback" not in said
            assert "parameters" in await ask(await connected(folder), "GetStatus")

    within_reason(test())


def test_who_sends_without_end_while_it_listens_is_hung_up_on(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder, FEW) as service:
            _, writer = await listening(folder)
            with pytest.raises(ConnectionError):
                while True:
                    writer.write(b"x" * 65_536)
                    await writer.drain()
            await until(lambda: len(service.subscribers) == 0)
            assert service.settings.socket.message_bytes == SocketSettings().message_bytes

    within_reason(test())
