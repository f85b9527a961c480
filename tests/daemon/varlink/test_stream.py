"""The live stream of corrected samples: what it sends, to how many, and what becomes of slow readers."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.calibration.terms import correct
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.app import Service
from stillcal.daemon.varlink import blocks
from stillcal.replay.serial_phone.link import LinkSettings, serve_phone
from tests.support.asking import NAME, Line, ask, connected, stored
from tests.support.living import answering, until, within_reason

IDLE = '[engine.schedule]\nwatch = "probing"\n[engine.detector]\nprobe_min_s = 3000.0\nprobe_max_s = 4000.0\n'


class Listener:
    """A client of Stream; `blocks` grows as they come."""

    def __init__(self, line: Line, **parameters: Any) -> None:
        self.blocks: list[dict[str, Any]] = []
        self.last: dict[str, Any] = {}
        self._line = line  # or its end would be closed
        question = {"method": f"{NAME}.Stream", "parameters": parameters, "more": True}
        line[1].write(json.dumps(question).encode() + b"\0")
        self.task = asyncio.create_task(self._listen(line[0]))

    async def _listen(self, reader: asyncio.StreamReader) -> None:
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                self.last = json.loads((await reader.readuntil(b"\0"))[:-1])
                if "error" not in self.last:
                    self.blocks.append(self.last["parameters"]["block"])

    def rows(self, sensor: Sensor) -> np.ndarray:
        blocks = [b["samples"] for b in self.blocks if b.get("sensor") == sensor.value]
        return np.concatenate(blocks) if blocks else np.empty((0, 4))

    def notices(self) -> list[str]:
        return [b["notice"] for b in self.blocks if "notice" in b]


async def listening(folder: Path, service: Service, **parameters: Any) -> Listener:
    before = len(service.readers.live)
    listener = Listener(await connected(folder), **parameters)
    await until(lambda: len(service.readers.live) > before)
    return listener


async def played(service: Service, folder: Path, lab: list[Any], chunks: int, speed: float = 60.0) -> None:
    await serve_phone(lab[:chunks], {"device": "p"}, LinkSettings(speed=speed), folder / "tty")
    end = float(lab[chunks - 1].accelerometer.t[-1])
    await until(lambda: service.saved.clock.newest >= end - 1e-6)
    await asyncio.sleep(0.3)


def sent(lab: list[Any], chunks: int, sensor: Sensor) -> Samples:
    name = "accelerometer" if sensor is Sensor.ACCELEROMETER else "gyroscope"
    return Samples.joined(getattr(chunk, name) for chunk in lab[:chunks])


def test_every_client_gets_every_sample_corrected_and_the_sensors_stay_on(
    folder: Path, make_record: Any, lab: list[Any]
) -> None:
    matrix = TermParameter(value=np.diag([1e-3, 0.0, 0.0]), unit="(rad/s)/(m/s^2)")
    term = Term(effect="gyro_g_sensitivity", sensor=Sensor.GYROSCOPE, parameters={"matrix": matrix})
    record = dataclasses.replace(make_record(3), terms=(term,))
    stored(folder, record)
    listeners: list[Listener] = []

    async def test() -> None:
        async with answering(folder, IDLE) as service:
            listeners.extend([await listening(folder, service, batch_s=b) for b in (0.0, 0.2, 1.0)])
            await played(service, folder, lab, 2)

    within_reason(test())
    force = correct(record, sent(lab, 2, Sensor.ACCELEROMETER))
    for listener in listeners:
        assert listener.notices()[0] == "begun" and listener.notices()[-1] == "the daemon is stopping"
        assert not listener.last.get("continues")
        assert all(b["calibrated"] for b in listener.blocks if "sensor" in b)
        accelerometer, gyroscope = (listener.rows(sensor) for sensor in Sensor)
        assert accelerometer[:, 0] == pytest.approx(force.t, abs=1e-5)
        assert np.abs(accelerometer[:, 1:] - force.xyz).max() < 1e-3  # counts on the wire
        raw = sent(lab, 2, Sensor.GYROSCOPE)
        expected = record.apply(
            raw.xyz - np.interp(raw.t, force.t, force.xyz[:, 0])[:, None] * [1e-3, 0.0, 0.0], Sensor.GYROSCOPE
        )
        assert len(gyroscope) == len(raw)
        assert np.median(np.abs(gyroscope[:, 1:] - expected)) < 1e-4
        assert np.median(np.abs(gyroscope[:, 1] - record.apply(raw.xyz, Sensor.GYROSCOPE)[:, 0])) > 5e-4


def test_without_a_calibration_raw_samples_come_and_say_so(folder: Path, lab: list[Any]) -> None:
    listeners: list[Listener] = []

    async def test() -> None:
        async with answering(folder, IDLE) as service:
            listeners.append(await listening(folder, service))
            await played(service, folder, lab, 1)

    within_reason(test())
    raw = sent(lab, 1, Sensor.ACCELEROMETER)
    assert not any(b["calibrated"] for b in listeners[0].blocks if "sensor" in b)
    assert np.abs(listeners[0].rows(Sensor.ACCELEROMETER)[:, 1:] - raw.xyz).max() < 1e-3


def test_a_phone_that_is_pulled_out_and_comes_back_is_said_between_the_samples(
    folder: Path, lab: list[Any]
) -> None:
    listeners: list[Listener] = []

    async def test() -> None:
        async with answering(folder, IDLE + "[source]\nretry_max_s = 0.1\n") as service:
            listeners.append(await listening(folder, service))
            await played(service, folder, lab, 1)
            await until(lambda: not service.source.connected)
            await serve_phone(lab[1:2], {"device": "p"}, LinkSettings(speed=60.0), folder / "tty")
            await asyncio.sleep(0.3)

    within_reason(test())
    order = [b.get("sensor") or b["notice"].split(":")[0] for b in listeners[0].blocks]
    lost = order.index("the phone was lost")
    assert "accelerometer" in order[:lost] and "accelerometer" in order[lost:]


def test_a_reader_that_does_not_read_is_told_and_the_others_miss_nothing(
    folder: Path, make_record: Any, lab: list[Any]
) -> None:
    stored(folder, make_record(3))
    got: list[Any] = []

    async def test() -> None:
        async with answering(folder, IDLE + "[socket]\nstall_s = 30.0\n") as service:
            good = await listening(folder, service)
            deaf = socket.socket(socket.AF_UNIX)
            deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            deaf.connect(str(folder / "socket"))
            deaf.sendall(json.dumps({"method": f"{NAME}.Stream", "more": True}).encode() + b"\0")
            await until(lambda: len(service.readers.live) == 2)
            await played(service, folder, lab, len(lab), speed=600.0)
            assert len(service.readers.live) == 1
            status = await ask(await connected(folder), "GetStatus")
            assert "parameters" in status
            got.append(len(good.rows(Sensor.ACCELEROMETER)))
            deaf.setblocking(False)
            loop, text = asyncio.get_running_loop(), b""
            while not text.endswith(b"\0") or b"error" not in text.split(b"\0")[-2]:
                text += await loop.sock_recv(deaf, 1 << 20)
            got.append(json.loads(text.split(b"\0")[-2])["error"])
            deaf.close()

    within_reason(test())
    assert got == [sum(len(chunk.accelerometer) for chunk in lab), f"{NAME}.TooSlow"]


def test_a_new_client_takes_the_place_of_the_longest_listening_one(folder: Path) -> None:
    async def test() -> None:
        async with answering(folder, "[socket]\nconnections = 2\n") as service:
            first = await listening(folder, service)
            await listening(folder, service)
            assert "parameters" in await ask(await connected(folder), "GetStatus")
            await first.task
            await until(lambda: len(service.readers.live) == 1)
            assert service.readers.live.patience_s == 0.02

    within_reason(test())


@pytest.mark.parametrize("batch_s", [-0.1, 1.1])
def test_a_wish_out_of_range_is_refused(folder: Path, batch_s: float) -> None:
    async def test() -> None:
        async with answering(folder) as service:
            line = await connected(folder)
            reply = await ask(line, "Stream", parameters={"batch_s": batch_s}, more=True)
            assert reply["error"] == "org.varlink.service.InvalidParameter"
            assert len(service.readers.live) == 0

    within_reason(test())


def test_a_recordings_blocks_are_made_once_for_all_who_take_them(tmp_path: Path, lab: list[Any]) -> None:
    """Twelve clients of Record: each block becomes JSON once, the same for all, with the samples."""
    clients, made = 12, blocks._samples
    made.cache_clear()

    async def taken(line: Line, wanted: int) -> list[bytes]:
        line[1].write(json.dumps({"method": f"{NAME}.Record", "more": True}).encode() + b"\0")
        answers: list[bytes] = []
        while sum(b'"accelerometer"' in answer for answer in answers) < wanted:
            answers.append((await line[0].readuntil(b"\0"))[:-1])
        return [answer for answer in answers if b'"samples"' in answer]

    results: list[list[bytes]] = []

    async def test() -> None:
        async with answering(tmp_path) as service:
            lines = [await connected(tmp_path) for _ in range(clients)]
            taking = [asyncio.create_task(taken(line, 3)) for line in lines]
            await until(lambda: len(service.readers.recorders) == clients)
            await played(service, tmp_path, lab, 2)
            results.extend(await asyncio.gather(*taking))

    within_reason(test())
    first, *others = results
    assert all(other[:4] == first[:4] for other in others)
    counts = made.cache_info()
    assert counts.hits >= (clients - 2) * counts.misses > 0
    block = next(json.loads(a)["parameters"]["block"] for a in first if b'"accelerometer"' in a)
    assert list(block) == ["sensor", "samples", "temperature_c"][: len(block)]
    times = [row[0] for row in block["samples"]]
    rows = sent(lab, 2, Sensor.ACCELEROMETER)
    expected = np.column_stack((rows.t, rows.xyz))[np.isin(rows.t, times)]
    assert block["samples"] == expected.tolist()
