"""The programs in examples/live print the corrected samples that a running daemon sends."""

from __future__ import annotations

import asyncio
import dataclasses
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.serial_phone.link import LinkSettings, serve_phone
from tests.support.asking import stored
from tests.support.living import answering, until, within_reason

LIVE = Path(__file__).parents[2] / "examples" / "live"


def command(language: str, folder: Path) -> list[str]:
    """Return the command that runs an example, compiled where it must be; skips without its compiler."""
    if language == "python":
        return [sys.executable, str(LIVE / "stream.py")]
    tool = shutil.which({"c": "cc", "javascript": "node"}[language])
    if tool is None:
        pytest.skip(f"no {'C compiler (cc)' if language == 'c' else 'node'} on this machine")
    if language == "javascript":
        return [tool, str(LIVE / "stream.js")]
    options = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror", "-o", str(folder / "stream")]
    subprocess.run([tool, *options, str(LIVE / "stream.c")], check=True)
    return [str(folder / "stream")]


@pytest.mark.parametrize("language", ["python", "c", "javascript"])
def test_it_prints_every_corrected_sample(
    language: str, folder: Path, make_record: Any, lab: list[Any]
) -> None:
    record, words = make_record(3), command(language, folder)
    uncalibrated = language != "python"
    if uncalibrated:
        record = dataclasses.replace(record, gyroscope=None)
    stored(folder, record)
    printed: list[str] = []

    async def test() -> None:
        async with answering(folder) as service:
            program = await asyncio.create_subprocess_exec(
                *words, str(folder / "socket"), stdout=subprocess.PIPE, stderr=subprocess.PIPE
            )
            reading = asyncio.create_task(program.communicate())
            await until(lambda: len(service.readers.live) == 1)
            await serve_phone(lab[:1], {}, LinkSettings(speed=60.0), folder / "tty")
            end = float(lab[0].accelerometer.t[-1])
            await until(lambda: service.saved.clock.newest >= end - 1e-6)
            await asyncio.sleep(0.3)
            service.stop()
            out, said = await reading
            assert (program.returncode, b"begun" in said, b"stopping" in said) == (0, True, True), said
            printed.extend(out.decode().splitlines())

    within_reason(test())
    for sensor, sent in ((Sensor.ACCELEROMETER, "accelerometer"), (Sensor.GYROSCOPE, "gyroscope")):
        raw: Samples = getattr(lab[0], sent)
        as_read = uncalibrated and sent == "gyroscope"
        name = f"raw_{sent}" if as_read else sent
        rows = np.array([line.split()[1:] for line in printed if line.startswith(name)], dtype=np.float64)
        assert rows[:, 0] == pytest.approx(raw.t, abs=1e-5)
        true = raw.xyz if as_read else record.apply(raw.xyz, sensor)
        assert np.abs(rows[:, 1:] - true).max() < 1e-3  # counts on the wire


def test_without_a_daemon_the_c_program_says_so(tmp_path: Path) -> None:
    words = [*command("c", tmp_path), str(tmp_path / "none")]
    found = subprocess.run(words, check=False, capture_output=True, text=True)
    assert found.returncode == 1 and found.stderr.strip().count("\n") == 0 and "none" in found.stderr


def dsu_question(kind: int, body: bytes) -> bytes:
    """Return a client's message (v1993/cemuhook-protocol)."""
    rest = struct.pack("<II", 99, kind) + body
    head = b"DSUC" + struct.pack("<HH", 1001, 4 + len(body))
    return head + struct.pack("<I", zlib.crc32(head + bytes(4) + rest)) + rest


class DsuClient(asyncio.DatagramProtocol):
    """An emulator: asks for the samples of the first controller, and keeps what comes."""

    def __init__(self) -> None:
        self.messages: list[bytes] = []

    def connection_made(self, transport: Any) -> None:
        transport.sendto(dsu_question(0x100001, struct.pack("<i4B", 4, 0, 1, 2, 3)))
        transport.sendto(dsu_question(0x100002, bytes([1, 0]) + bytes(6)))

    def datagram_received(self, data: bytes, _address: Any) -> None:
        self.messages.append(data)


def test_an_emulator_gets_gravity_and_rates_by_the_axes_of_its_protocol(
    folder: Path, make_record: Any, lab: list[Any]
) -> None:
    record = make_record(3)
    stored(folder, record)
    client = DsuClient()

    async def test() -> None:
        async with answering(folder) as service:
            words = [sys.executable, str(LIVE / "dsu.py"), str(folder / "socket"), "0"]
            program = await asyncio.create_subprocess_exec(
                *words, stdout=subprocess.PIPE, stderr=subprocess.PIPE
            )
            assert program.stdout is not None
            port = int((await program.stdout.readline()).rsplit(b":", 1)[1])
            loop = asyncio.get_running_loop()
            line, _ = await loop.create_datagram_endpoint(lambda: client, remote_addr=("127.0.0.1", port))
            await until(lambda: len(service.readers.live) == 1 and len(client.messages) == 4)
            await serve_phone(lab[:1], {}, LinkSettings(speed=60.0), folder / "tty")
            await until(lambda: len(client.messages) > 100)
            service.stop()
            _, said = await program.communicate()
            line.close()
            assert said.endswith(b"the daemon has gone\n")

    within_reason(test())
    for message in client.messages:
        sent = struct.unpack_from("<I", message, 8)[0]
        assert zlib.crc32(message[:8] + bytes(4) + message[12:]) == sent
        assert struct.unpack_from("<HH", message, 4) == (1001, len(message) - 16)
    assert [message[21] for message in client.messages[:4]] == [2, 0, 0, 0], "one controller of four"
    samples = [message for message in client.messages[4:] if len(message) == 100]
    parts = [(*struct.unpack_from("<I", m, 32), *struct.unpack_from("<Q6f", m, 68)) for m in samples]
    counts, stamps, *motion = zip(*parts, strict=True)
    assert np.all(np.diff(counts) >= 1) and len(samples) > 100
    gyroscope, force = lab[0].gyroscope, lab[0].accelerometer
    rows = np.searchsorted(gyroscope.t, np.array(stamps) * 1e-6 - 1e-5)
    wx, wy, wz = np.degrees(record.apply(gyroscope.xyz[rows], Sensor.GYROSCOPE)).T
    pitch_up, yaw_right, roll_right = np.array(motion[3:])
    for told, true in ((pitch_up, wx), (yaw_right, -wz), (roll_right, wy)):
        assert np.abs(told - true).max() < 0.1
    left, down, forward = np.array(motion[:3])[:, ::20]
    felt = record.apply(force.xyz, Sensor.ACCELEROMETER) / 9.80665
    apart = felt[:, None] - np.column_stack([-left, forward, -down])
    assert np.linalg.norm(apart, axis=2).min(axis=0).max() < 2e-4, "each is a sample of the accelerometer"
