"""What the socket endures: clients that talk nonsense, stall, flood or do not listen."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from pathlib import Path
from typing import Any

import pytest
from asking import NAME, ask, connected, stored
from living import answering, within_reason

from stillcal.calib_core.events import Reject
from stillcal.daemon.faults_socket import nonsense


def test_malformed_messages_harm_nobody(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    async def test() -> None:
        async with answering(folder) as service:
            good = await connected(folder)
            for message in nonsense(1000, seed=4):
                line = await connected(folder)
                line[1].write(message)
                line[1].write_eof()
                await line[0].read()
                line[1].close()
            assert "parameters" in await ask(good, "GetStatus")
            assert service.view.record is None

    within_reason(test())
    assert "Traceback" not in caplog.text


def test_half_of_many_clients_stall_and_the_others_are_answered(folder: Path) -> None:
    text = "[socket]\nconnections = 64\nstall_s = 0.3\n"

    async def test() -> None:
        async with answering(folder, text):
            stalled = [await connected(folder) for _ in range(40)]
            for _, writer in stalled[:20]:
                writer.write(b'{"method": "half a question')
            for _, writer in stalled[20:]:
                writer.write(json.dumps({"method": "org.varlink.service.GetInfo"}).encode() * 1 + b"\0")
            others = [await connected(folder) for _ in range(60)]
            for _ in range(3):
                answers = await asyncio.gather(*(ask(line, "GetStatus") for line in others))
                assert all("status" in answer["parameters"] for answer in answers)
            assert all([await reader.read() == b"" for reader, _ in stalled[:20]])
            for _, writer in (*stalled, *others):
                writer.close()

    within_reason(test())


def test_who_takes_no_answers_is_dropped(folder: Path, make_record: Any) -> None:
    stored(folder, make_record(1))
    many = json.dumps({"method": f"{NAME}.GetStatus"}).encode() + b"\0"

    async def test() -> None:
        async with answering(folder, "[socket]\nstall_s = 0.2\ncalls_per_s = 1e6\n"):
            line = socket.socket(socket.AF_UNIX)
            line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            line.setblocking(False)
            line.connect(str(folder / "socket"))
            loop = asyncio.get_running_loop()
            with pytest.raises((BrokenPipeError, ConnectionResetError)):
                while True:
                    await loop.sock_sendall(line, many * 100)
            line.close()
            assert "parameters" in await ask(await connected(folder), "GetStatus")

    within_reason(test())


def test_a_question_without_end_is_not_kept(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder, "[socket]\nmessage_bytes = 4096\n"):
            reader, writer = await connected(folder)
            with contextlib.suppress(ConnectionError):
                writer.write(b"x" * 1_000_000)
                await writer.drain()
            with contextlib.suppress(ConnectionError):
                assert await reader.read() == b""

    within_reason(test())


def test_a_listener_that_does_not_listen_is_dropped_and_holds_up_nothing(
    folder: Path, make_record: Any
) -> None:
    record = make_record(1)

    async def test() -> None:
        async with answering(folder, "[socket]\nstall_s = 0.2\n") as service:
            line = socket.socket(socket.AF_UNIX)
            line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            line.connect(str(folder / "socket"))
            line.sendall(json.dumps({"method": f"{NAME}.Monitor", "more": True}).encode() + b"\0")
            while not len(service.news):
                await asyncio.sleep(0.001)
            action = Reject(1.0, record, "no " * 5000)
            while len(service.news):
                service.news.tell(action)
                await asyncio.sleep(0)
            line.close()

    within_reason(test())
