"""`stillcal run --publish FILE.mcap`: read back by the library `mcap`, ROS 2's types and our own reader."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.daemon.publish import mcap_files
from stillcal.daemon.publish import publishing as publishing_module
from stillcal.daemon.publish.mcap_files import McapFiles
from stillcal.daemon.service.live_stream import Interruption, Live, LiveBlock
from stillcal.daemon.service.subscribers import Subscriber, Subscribers
from stillcal.daemon.settings import SettingsError
from stillcal.replay.formats.trace import read_all
from stillcal.replay.serial_phone.link import LinkSettings, serve_phone
from tests.support.asking import STILLCAL, asked, stored
from tests.support.living import until, within_reason

EPOCH_S = 1.7e9


def block(
    sensor: Sensor, t: np.ndarray, record: Any = None, celsius: float | None = None, late: float = 0.0
) -> LiveBlock:
    """Return samples at t, s; the last is read at t + late on the host's clock, which counts from 1000 s."""
    xyz = np.column_stack([t, t + 1.0, t + 2.0])
    temperature = None if celsius is None else frozen(np.full(len(t), celsius))
    return LiveBlock(
        Samples(sensor, frozen(t), frozen(xyz), temperature), record, 1000.0 + float(t[-1]) + late
    )


def writer(path: Path) -> McapFiles:
    return McapFiles(path, clock=lambda: 1000.0, time_of_day=lambda: EPOCH_S)


def messages(path: Path) -> dict[str, list[tuple[Any, Any, Any]]]:
    found: dict[str, list[tuple[Any, Any, Any]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((schema, channel, message))
    return found


def test_each_topic_holds_what_ros_2_reads(tmp_path: Path, make_record: Any) -> None:
    t, record = np.arange(10) * 0.01 + 50.0, make_record(1)
    files = writer(tmp_path / "live.mcap")
    files.open()
    files.take([block(Sensor.ACCELEROMETER, t), block(Sensor.ACCELEROMETER, t + 0.1, record, 31.5)])
    files.take([block(Sensor.GYROSCOPE, t + 0.1, record), block(Sensor.ACCELEROMETER, t + 0.2, record, 31.5)])
    files.close()
    found = messages(tmp_path / "live.mcap")
    counts = {topic: len(sent) for topic, sent in found.items()}
    assert counts == {
        "/imu/uncalibrated/accelerometer": 10,
        "/imu/accelerometer": 20,
        "/imu/gyroscope": 10,
        "/imu/temperature": 1,
        "/calibration": 1,
    }
    types = get_typestore(Stores.ROS2_HUMBLE)
    schema, _, message = found["/imu/gyroscope"][3]
    imu = types.deserialize_cdr(message.data, schema.name)
    assert (imu.header.stamp.sec, imu.header.stamp.nanosec) == (50, pytest.approx(130_000_000, abs=2))
    assert [imu.angular_velocity.x, imu.angular_velocity.y] == pytest.approx([50.13, 51.13])
    assert (imu.linear_acceleration_covariance[0], imu.angular_velocity_covariance[0]) == (-1.0, 0.0)
    assert message.log_time * 1e-9 == pytest.approx(EPOCH_S + 50.13, abs=1e-6)
    schema, channel, message = found["/calibration"][0]
    assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
    assert json.loads(message.data)["accelerometer"]["bias"] == record.accelerometer.bias.tolist()
    assert json.loads(schema.data)["type"] == "object"


def test_times_of_day_follow_the_sensor_and_begin_anew_after_an_interruption(tmp_path: Path) -> None:
    t = np.arange(10) * 0.01
    files = writer(tmp_path / "live.mcap")
    files.open()
    files.take([block(Sensor.ACCELEROMETER, t), block(Sensor.ACCELEROMETER, t + 0.1, late=0.1)])
    files.take([Interruption("lost"), block(Sensor.ACCELEROMETER, t + 0.2, late=3.0)])
    files.close()
    logged = [m.log_time * 1e-9 - EPOCH_S for *_, m in messages(tmp_path / "live.mcap").popitem()[1]]
    assert logged == pytest.approx([*t, *(t + 0.101), *(t + 3.2)], abs=1e-6)


def test_files_are_bounded_in_size_and_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_files, "FILE_BYTES", 20_000)
    monkeypatch.setattr(mcap_files, "FLUSH_S", 0.0)
    monkeypatch.setattr(mcap_files, "FILES", 3)
    kept = tmp_path / "live.old.mcap"
    kept.write_text("mine")
    files = writer(tmp_path / "live.mcap")
    files.open()
    for i in range(100):
        files.take([block(Sensor.ACCELEROMETER, np.random.default_rng(i).random(100).cumsum())])
    files.close()
    names = sorted(int(path.name.split(".")[1]) for path in tmp_path.glob("live.[0-9]*.mcap"))
    assert len(names) == 3 and names == list(range(names[0], names[0] + 3)) and names[0] > 2
    assert not (tmp_path / "live.mcap").exists() and kept.exists()
    sizes = [(tmp_path / f"live.{n}.mcap").stat().st_size for n in names]
    assert max(sizes) < 40_000
    later = writer(tmp_path / "live.mcap")
    later.take([block(Sensor.ACCELEROMETER, np.arange(10.0))])
    assert (tmp_path / f"live.{names[-1] + 1}.mcap").exists(), "an earlier file is never written over"
    later.close()


def test_a_daemon_that_restarts_without_end_or_meets_a_full_disk_deletes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(mcap_files.FILES + 4):
        files = writer(tmp_path / "live.mcap")
        files.open()
        files.take([block(Sensor.ACCELEROMETER, np.arange(10.0))])
        files.close()
    kept = sorted(tmp_path.iterdir())
    assert len(kept) == mcap_files.FILES + 4
    idle = writer(tmp_path / "live.mcap")
    idle.open()
    idle.take([Interruption("the phone was lost")])
    idle.close()
    monkeypatch.setattr(mcap_files, "RESERVE_BYTES", 2**60)
    with pytest.raises(OSError, match="left on the disk"):
        idle.open()
    with pytest.raises(OSError, match="left on the disk"):
        idle.take([block(Sensor.ACCELEROMETER, np.arange(10.0))])
    assert sorted(tmp_path.iterdir()) == kept


def test_files_beyond_their_number_are_deleted_however_small_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_files, "MOST_FILES", 2)
    for name in ("live.mcap", "live.2.mcap", "live.3.mcap"):
        (tmp_path / name).touch()
    (tmp_path / "live.4.mcap").mkdir()
    files = writer(tmp_path / "live.mcap")
    files.take([block(Sensor.ACCELEROMETER, np.arange(10.0))])
    files.close()
    assert {path.name for path in tmp_path.iterdir()} == {"live.3.mcap", "live.4.mcap", "live.5.mcap"}


def test_a_folder_that_goes_while_samples_are_published_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publishing_module, "RETRY_S", 0.01)
    monkeypatch.setattr(mcap_files, "FLUSH_S", 0.0)
    folder = tmp_path / "stick"
    folder.mkdir()
    live = Subscribers[Live]()

    @contextlib.contextmanager
    def subscribed(patience_s: float) -> Iterator[Subscriber[Live]]:
        subscriber, leave = live.subscribe()
        try:
            yield subscriber
        finally:
            leave()

    async def published_until(holds: Callable[[], Any]) -> None:
        while not holds():
            live.notify(block(Sensor.ACCELEROMETER, np.arange(10.0)))
            await asyncio.sleep(0.005)

    async def test() -> None:
        files = writer(folder / "live.mcap")
        files.open()
        job = asyncio.create_task(publishing_module.publishing(files, subscribed))
        await published_until((folder / "live.mcap").exists)
        shutil.rmtree(folder)
        await published_until(lambda: not len(live))
        folder.mkdir()
        await published_until(lambda: (folder / "live.mcap").exists() or job.done())
        assert not job.done()
        job.cancel()
        await asyncio.gather(job, return_exceptions=True)
        assert messages(folder / "live.mcap")

    within_reason(test())


def test_a_full_disk_is_an_error_that_can_be_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_files, "FLUSH_S", 0.0)
    files = writer(tmp_path / "live.mcap")
    files.open()
    files.take([block(Sensor.ACCELEROMETER, np.arange(10.0))])
    monkeypatch.setattr(mcap_files, "RESERVE_BYTES", 2**60)
    with pytest.raises(OSError, match="left on the disk"):
        files.take([block(Sensor.ACCELEROMETER, np.arange(10.0))])
    files.close()
    assert len(messages(tmp_path / "live.mcap")["/imu/uncalibrated/accelerometer"]) == 20


def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="there is no folder"):
        writer(tmp_path / "none" / "live.mcap").open()


@pytest.mark.slow
@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_a_daemon_that_ends_or_is_killed_leaves_a_file_that_is_read(
    end: signal.Signals, folder: Path, make_record: Any, lab: list[Any]
) -> None:
    record = make_record(3)
    stored(folder, record)
    words = ["run", "--port", folder / "tty", "--store", folder / "store.json", "--socket", folder / "socket"]
    settings = "from stillcal.daemon.publish import mcap_files; mcap_files.FLUSH_S = 0.05;"
    main = "from stillcal.daemon.cli.entry import main; main()"
    command = [
        sys.executable,
        "-c",
        settings + main,
        *map(str, words),
        "--publish",
        str(folder / "live.mcap"),
    ]

    sent = sum(len(s) for c in lab[:1] for s in (c.accelerometer, c.gyroscope))

    async def test() -> None:
        daemon = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        await until((folder / "socket").exists)
        await serve_phone(lab[:1], {"device": "p"}, LinkSettings(speed=60.0), folder / "tty")
        while (await asked(folder, lambda c: c.GetStatus()["status"]["wire"]["samples"])) < sent:
            await asyncio.sleep(0.02)
        await asyncio.sleep(0.5)  # ten times what lies between two flushes
        os.kill(daemon.pid, end)
        said = await asyncio.to_thread(daemon.communicate)
        assert daemon.returncode == (0 if end == signal.SIGTERM else -end), said

    within_reason(test())
    shown = subprocess.run(
        [STILLCAL, "convert", str(folder / "live.mcap"), "--out", str(folder / "whole.mcap")],
        check=True,
        capture_output=True,
        text=True,
    )
    assert ("did not complete" in shown.stderr) == (end == signal.SIGKILL)
    t, xyz = (np.concatenate([getattr(c.accelerometer, what) for c in lab[:1]]) for what in ("t", "xyz"))
    for name in ("live.mcap", "whole.mcap"):
        found = read_all(folder / name)
        n = len(found.accelerometer)
        assert n == len(t) if end == signal.SIGTERM else n > 0.75 * len(t)  # a flush is 3 s of this phone's
        assert found.accelerometer.t == pytest.approx(t[:n], abs=1e-5)
        assert np.abs(found.accelerometer.xyz - record.apply(xyz[:n], Sensor.ACCELEROMETER)).max() < 1e-3
        assert found.gyroscope is not None and len(found.gyroscope) > 0.9 * n
