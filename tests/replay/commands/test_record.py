"""`stillcal record` with a daemon in this process and the command in one of its own."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
from collections import namedtuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from stillcal.daemon.app import Service
from stillcal.daemon.cli.main import cli
from stillcal.replay.commands import record
from stillcal.replay.formats.trace import read_all
from stillcal.replay.serial_phone.link import LinkSettings, serve_phone
from tests.support.living import given_in, running, until, within_reason

COMMAND = [str(Path(sys.executable).with_name("stillcal")), "record"]
IDLE = '[engine.schedule]\nwatch = "probing"\n[engine.detector]\nprobe_min_s = 3000.0\nprobe_max_s = 4000.0\n'


def begin(folder: Path, out: Path, *options: str) -> subprocess.Popen[str]:
    words = [*COMMAND, str(out), "--socket", str(folder / "socket"), *options]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


async def recorded(service: Service, folder: Path, lab: list[Any], *options: str) -> tuple[int, str, str]:
    """Record half a minute of a phone at sixty times its pace, and end it by Ctrl-C."""
    process = begin(folder, folder / "r.csv", *options)
    await until(lambda: len(service.readers.recorders) == 1)
    await serve_phone(lab[:3], {"device": "p"}, LinkSettings(speed=60.0), folder / "tty")
    await until(lambda: service.saved.clock.newest >= float(lab[2].accelerometer.t[-1]) - 1e-6)
    await asyncio.sleep(0.3)  # what has come is on its way to the command
    process.send_signal(signal.SIGINT)
    out, err = await asyncio.to_thread(process.communicate, timeout=30)
    await until(lambda: len(service.readers.recorders) == 0)
    return process.returncode, out, err


def sent(lab: list[Any]) -> tuple[list[float], np.ndarray]:
    accel = [chunk.accelerometer for chunk in lab[:3]]
    return np.concatenate([s.t for s in accel]).tolist(), np.concatenate([s.xyz for s in accel])


def test_ctrl_c_leaves_a_whole_file_of_all_that_came(folder: Path, lab: list[Any]) -> None:
    async def test() -> None:
        async with running(given_in(folder, IDLE)) as service:
            code, out, err = await recorded(service, folder, lab)
            assert (code, err) == (0, "") and "samples" in out

    within_reason(test())
    found, (t, xyz) = read_all(folder / "r.csv"), sent(lab)
    assert found.accelerometer.t == pytest.approx(t, abs=1e-5)
    assert np.abs(found.accelerometer.xyz - xyz).max() < 1e-3  # counts on the wire
    assert found.gyroscope is not None and len(found.gyroscope) > 0.9 * len(t)
    assert found.claims.device == "p"


def test_the_daemons_end_leaves_a_whole_file_too_and_is_said(folder: Path, lab: list[Any]) -> None:
    async def test() -> subprocess.Popen[str]:
        async with running(given_in(folder, IDLE)) as service:
            process = begin(folder, folder / "r.csv.gz")
            await until(lambda: len(service.readers.recorders) == 1)
            await serve_phone(lab[:2], {"device": "p"}, LinkSettings(speed=60.0), folder / "tty")
        return process

    process = asyncio.run(test())
    _, err = process.communicate(timeout=30)
    assert process.returncode == 4 and "the daemon has stopped" in err and err.count("\n") == 1
    assert len(read_all(folder / "r.csv.gz").accelerometer) > 1000


def test_sparing_records_only_what_the_daemon_measures(folder: Path, lab: list[Any]) -> None:
    async def test() -> None:
        async with running(given_in(folder, IDLE)) as service:
            code, _, _ = await recorded(service, folder, lab, "--sparing")
            assert code == 0

    within_reason(test())
    assert len(read_all(folder / "r.csv").accelerometer) < 0.5 * len(sent(lab)[0])


Usage = namedtuple("Usage", "total used free")


@pytest.mark.parametrize(
    ("case", "code", "said"),
    [("no daemon", 4, "no daemon answers"), ("exists", 2, "exists already"), ("name", 2, "ends in .csv")],
)
def test_what_cannot_be_recorded_is_said_in_a_line(tmp_path: Path, case: str, code: int, said: str) -> None:
    out = tmp_path / ("r.txt" if case == "name" else "r.csv")
    if case == "exists":
        out.write_text("mine")
    before = sorted(tmp_path.iterdir())
    result = CliRunner().invoke(cli, ["record", str(out), "--socket", str(tmp_path / "none")])
    assert result.exit_code == code and said in result.output and result.output.strip().count("\n") <= 3
    assert sorted(tmp_path.iterdir()) == before


def test_a_disk_that_fills_up_ends_it_with_a_whole_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lab: list[Any]
) -> None:
    rooms = iter([2**40, 2**20])
    monkeypatch.setattr(record.shutil, "disk_usage", lambda _: Usage(2**40, 0, next(rooms)))
    monkeypatch.setattr(record, "CHECK_EVERY", 3)
    monkeypatch.setattr(record._Stop, "__init__", lambda self, hours: setattr(self, "asked", False))
    rows = np.column_stack((lab[0].accelerometer.t, lab[0].accelerometer.xyz)).tolist()
    block = {"parameters": {"block": {"sensor": "accelerometer", "samples": rows}}}
    later = [[t + 100.0, *xyz] for t, *xyz in rows]
    second = {"parameters": {"block": {"sensor": "accelerometer", "samples": later}}}
    monkeypatch.setattr(record, "replies", lambda *_: iter([block, second, {}, {}, {}, {}]))
    result = CliRunner().invoke(cli, ["record", str(tmp_path / "r.csv"), "--socket", "x"])
    assert result.exit_code == 2 and "left on the disk" in result.output
    assert len(read_all(tmp_path / "r.csv").accelerometer) == 2 * len(rows)
