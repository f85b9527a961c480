"""The programs in examples/live print the corrected samples that a running daemon sends."""

from __future__ import annotations

import asyncio
import dataclasses
import shutil
import subprocess
import sys
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
