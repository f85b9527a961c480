"""The socket, asked by the independent varlink client and by clients that mean no good."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import os
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import varlink
from living import answering, within_reason

from stillcal.calib_core.events import Reject
from stillcal.calib_core.events import Store as Keep
from stillcal.calib_core.samples import Sensor
from stillcal.daemon.faults_kill import example
from stillcal.daemon.faults_socket import nonsense
from stillcal.daemon.notify import Notifier
from stillcal.daemon.service import Service
from stillcal.daemon.service_given import Given
from stillcal.daemon.store import Store

STILLCAL = str(Path(sys.executable).with_name("stillcal"))
NAME = "io.stillcal.Calibration"


@contextlib.contextmanager
def client(folder: Path) -> Iterator[Any]:
    with varlink.Client(address=f"unix:{folder}/socket") as found, found.open(NAME) as opened:
        yield opened


async def asked(folder: Path, ask: Callable[[Any], Any]) -> Any:
    def run() -> Any:
        with client(folder) as opened:
            return ask(opened)

    return await asyncio.to_thread(run)


def stored(folder: Path, *records: Any) -> None:
    for record in records:
        Store(folder / "store.json").publish(record)


# What is answered


def test_the_interface_describes_itself(folder: Path) -> None:
    def look() -> tuple[Any, Any]:
        with varlink.Client(address=f"unix:{folder}/socket") as found:
            found.get_interfaces()
            return found.info, found.get_interface(NAME)

    async def test() -> None:
        async with answering(folder):
            info, interface = await asyncio.to_thread(look)
            assert NAME in info["interfaces"] and info["product"] == "stillcal"
            methods = {
                "GetCalibration",
                "GetStatus",
                "GetHistory",
                "GetEnergy",
                "Correct",
                "Monitor",
                "Rollback",
            }
            assert methods <= interface.members.keys()

    within_reason(test())


def test_the_current_calibration_is_the_stores(folder: Path, make_record: Any) -> None:
    record = make_record(3)
    stored(folder, make_record(2), record)

    async def test() -> None:
        async with answering(folder):
            found = (await asked(folder, lambda c: c.GetCalibration()))["calibration"]
            assert found["id"] == record.id
            assert found["accelerometer"]["bias"] == record.accelerometer.bias.tolist()
            assert found["accelerometer"]["unit"] == "m/s^2"
            assert (
                "bias_uncertainty" not in found["accelerometer"]
                or not found["accelerometer"]["bias_uncertainty"]
            )
            assert (found["temperature_min_c"], found["confidence"]) == (20.0, "unchecked")
            entries = (await asked(folder, lambda c: c.GetHistory()))["entries"]
            assert [e["what"] for e in entries] == ["current", "replaced"]
            status = (await asked(folder, lambda c: c.GetStatus()))["status"]
            assert not status["connected"] and status["calibration"] == record.id

    within_reason(test())


def test_a_calibration_says_which_attitude_would_help_most(folder: Path, make_record: Any) -> None:
    words = "lay it on its left edge (x axis up)"
    record = make_record(3)
    known = dataclasses.replace(record.accelerometer, most_helpful_attitude=words)
    stored(folder, make_record(2), dataclasses.replace(record, accelerometer=known))

    async def test() -> None:
        async with answering(folder):
            found = (await asked(folder, lambda c: c.GetCalibration()))["calibration"]
            assert found["accelerometer"]["most_helpful_attitude"] == words
            assert not found["gyroscope"].get("most_helpful_attitude")
            command = [STILLCAL, "query", "--socket", str(folder / "socket")]
            said = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True)
            assert words in said.stdout, said.stderr

    within_reason(test())


def test_samples_are_corrected_and_their_number_is_bounded(folder: Path, make_record: Any) -> None:
    record = make_record(3)
    stored(folder, record)
    raw = np.random.default_rng(2).normal(0, 9, (1000, 3))

    async def test() -> None:
        async with answering(folder):
            for sensor in Sensor:
                found = await asked(folder, lambda c, s=sensor: c.Correct(str(s), raw.tolist()))
                assert np.array_equal(found["samples"], record.apply(raw, sensor))
            for bad in ([[0.0] * 3] * 1001, [[1.0, 2.0]], [["x", 1.0, 2.0]], [[1.79e308] * 3]):
                with pytest.raises(varlink.VarlinkError, match="InvalidParameter"):
                    await asked(folder, lambda c, b=bad: c.Correct("accelerometer", b))

    within_reason(test())


def test_without_a_calibration_it_says_what_is_missing(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder):
            with pytest.raises(varlink.VarlinkError) as caught:
                await asked(folder, lambda c: c.GetCalibration())
            assert caught.value.error() == f"{NAME}.NotCalibrated"
            command = [STILLCAL, "query", "--socket", str(folder / "socket")]
            found = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True)
            assert found.returncode == 3 and "too few rests" in found.stderr

    within_reason(test())


def test_changes_are_told_until_the_daemon_stops(folder: Path, make_record: Any) -> None:
    stored(folder, make_record(1))

    def listen(told: list[Any]) -> None:
        with client(folder) as opened:
            told.extend(e["event"] for e in opened.Monitor(_more=True))

    async def test() -> None:
        told: list[Any] = []
        async with answering(folder) as service:
            listening = asyncio.create_task(asyncio.to_thread(listen, told))
            while not len(service.news):
                await asyncio.sleep(0.001)
            service.act([Keep(5.0, make_record(2), "better"), Reject(6.0, make_record(3), "not better")])
        await listening
        assert [e["what"] for e in told] == ["current", "calibrated", "rejected", "ended"]
        assert told[1]["calibration"]["id"] == make_record(2).id and told[1]["reason"] == "better"

    within_reason(test())


def test_rolling_back_is_for_root_and_the_daemons_own_user(folder: Path, make_record: Any) -> None:
    first, second = make_record(1), make_record(2)
    stored(folder, first, second)
    question = json.dumps({"method": f"{NAME}.Rollback"})
    stranger = (
        f"import socket; s = socket.socket(socket.AF_UNIX); s.connect({str(folder / 'socket')!r});"
        f"s.sendall({question!r}.encode() + bytes(1)); print(s.recv(9999).decode())"
    )

    async def test() -> None:
        async with answering(folder, "[socket]\nmode = 0o666\n") as service:
            if os.geteuid() == 0:
                python = [
                    sys.executable if os.access(sys.executable, os.X_OK) else "python3",
                    "-S",
                    "-c",
                    stranger,
                ]
                found = await asyncio.to_thread(
                    subprocess.run,
                    ["setpriv", "--reuid=65534", "--clear-groups", "/usr/bin/python3", *python[1:]],
                    capture_output=True,
                    text=True,
                )
                assert "org.varlink.service.PermissionDenied" in found.stdout, found.stderr
                assert service.document.current.id == second.id
            found = await asked(folder, lambda c: c.Rollback())
            assert found["calibration"]["id"] == first.id == service.view.record.id
            with pytest.raises(varlink.VarlinkError, match="Refused"):
                await asked(folder, lambda c: c.Rollback("ffff"))
        assert Store(folder / "store.json").load().current.id == first.id

    within_reason(test())


def test_who_may_asks_for_a_calibration_and_for_zeroing(folder: Path) -> None:
    record, rests = example()
    assert record.accelerometer is not None

    async def test() -> None:
        async with answering(folder) as service:
            with pytest.raises(varlink.VarlinkError, match="Refused"):
                await asked(folder, lambda c: c.Calibrate())
            service.mind._engine.adopt(rests)
            found = await asked(folder, lambda c: c.Calibrate())
            assert found["calibration"]["accelerometer"]["n_rests"] == record.accelerometer.n_rests
            assert (
                service.document.current is None or service.document.current.id == found["calibration"]["id"]
            )
            with pytest.raises(varlink.VarlinkError, match="Refused"):
                await asked(folder, lambda c: c.ZeroNow())  # rests without a gyroscope
            status = (await asked(folder, lambda c: c.GetStatus()))["status"]
            assert status["failed_checks"] == 0 and status["diagnosis"] == ""

    within_reason(test())


# What is endured


async def connected(folder: Path) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    return await asyncio.open_unix_connection(str(folder / "socket"))


async def ask(line: tuple[asyncio.StreamReader, asyncio.StreamWriter], method: str, **more: Any) -> Any:
    line[1].write(json.dumps({"method": f"{NAME}.{method}", **more}).encode() + b"\0")
    return json.loads((await line[0].readuntil(b"\0"))[:-1])


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


def test_a_second_daemon_on_the_same_socket_is_refused_and_a_dead_ones_place_is_taken(folder: Path) -> None:
    dead = socket.socket(socket.AF_UNIX)
    dead.bind(str(folder / "socket"))
    dead.close()

    async def test() -> None:
        given = Given(None, "none", str(folder / "other.json"), str(folder / "socket"))
        config = folder / "stillcal.toml"
        config.write_text("")
        async with answering_after(folder):
            second = Service(given.settings(), given, Notifier({}))
            second.open()
            with pytest.raises(ValueError, match="in use by another daemon"):
                await second.run()
            second.storage.close()

    within_reason(test())


@contextlib.asynccontextmanager
async def answering_after(folder: Path) -> AsyncIterator[Service]:
    """Run the daemon where a dead one's socket lies, and wait until it answers."""
    async with answering(folder) as service:
        while True:
            with contextlib.suppress(ConnectionRefusedError):
                (await connected(folder))[1].close()
                break
            await asyncio.sleep(0.001)
        yield service


@pytest.mark.parametrize("mode", ["0o600", "0o660"])
def test_the_sockets_permissions_are_the_settings(folder: Path, mode: str) -> None:
    async def test() -> None:
        async with answering(folder, f"[socket]\nmode = {mode}\n"):
            assert (folder / "socket").stat().st_mode & 0o777 == int(mode, 8)

    within_reason(test())
