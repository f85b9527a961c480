"""What the socket endures: clients that talk nonsense, stall, flood or do not listen."""

from __future__ import annotations

import asyncio
import contextlib
import json
import select
import socket
from pathlib import Path
from typing import Any

import pytest

from stillcal.calib_core.engine.actions import Reject
from stillcal.daemon.service.subscribers import BACKLOG
from stillcal.replay.serial_phone.link import LinkSettings, serve_phone
from stillcal.replay.trials.faults.socket import nonsense
from tests.support.asking import NAME, Line, ask, connected, stored
from tests.support.living import answering, until, within_reason


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
            answer = b""
            with contextlib.suppress(ConnectionError):
                answer = await reader.read()
            assert answer == b""
            assert "parameters" in await ask(await connected(folder), "GetStatus")

    within_reason(test())


async def listening(line: Line, marked: str, heard: list[int]) -> None:
    """Listen for news, and keep the numbers that follow the mark in their reasons, until the line ends."""
    line[1].write(json.dumps({"method": f"{NAME}.Monitor", "more": True}).encode() + b"\0")
    with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
        while True:
            event = json.loads((await line[0].readuntil(b"\0"))[:-1])["parameters"]["event"]
            if event["reason"].startswith(marked):
                heard.append(int(event["reason"].split()[1]))


def hung_up(line: socket.socket) -> bool:
    """Whether the other end has closed; reads nothing."""
    poll = select.poll()
    poll.register(line, 0)
    return any(seen & select.POLLHUP for _, seen in poll.poll(0))


def test_a_listener_that_does_not_listen_is_dropped_and_holds_up_nothing(
    folder: Path, make_record: Any, lab: list[Any]
) -> None:
    """While it is told of 15 kB at a time, others hear and are answered, and the phone's samples come."""
    record = make_record(1)
    text = '[socket]\nstall_s = 0.2\ncalls_per_s = 1e6\n[engine.schedule]\nwatch = "continuous"\n'

    async def test() -> None:
        async with answering(folder, text) as service, asyncio.TaskGroup() as others:
            heard: list[int] = []
            phone = others.create_task(
                serve_phone(lab, {}, LinkSettings(speed=10.0, credit=False), folder / "tty")
            )
            others.create_task(listening(await connected(folder), "told", heard))
            await until(lambda: len(service.subscribers) == 1 and service.source.wire.samples)
            deaf = socket.socket(socket.AF_UNIX)
            deaf.connect(str(folder / "socket"))
            deaf.sendall(json.dumps({"method": f"{NAME}.Monitor", "more": True}).encode() + b"\0")
            await until(lambda: len(service.subscribers) == 2)
            asking, told, samples = await connected(folder), 0, service.source.wire.samples
            while not hung_up(deaf):
                for _ in range(16):
                    told += 1
                    service.subscribers.announce(Reject(1.0, record, f"told {told} " + "no " * 5000))
                await until(lambda last=told: last in heard)
                assert "parameters" in await ask(asking, "GetStatus")
                assert (
                    max(subscriber.queue.qsize() for subscriber in service.subscribers._subscribers)
                    <= BACKLOG
                )
            assert service.source.wire.samples > samples
            assert heard == list(range(1, told + 1)) and len(service.subscribers) == 1
            deaf.settimeout(0)
            got = b""
            with contextlib.suppress(ConnectionResetError):
                while piece := deaf.recv(65_536):
                    got += piece
            assert got.count(b"told") < told
            deaf.close()
            phone.cancel()
            service.stop()

    within_reason(test())
