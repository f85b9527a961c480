"""What is no file on a disk, given where one is read: refused in one line, and never waited for."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from stillcal.daemon.settings import load_settings
from stillcal.daemon.system import files
from stillcal.replay.formats.columns import load_map
from stillcal.replay.formats.errors import TraceError
from stillcal.replay.formats.recognition.opened import kept
from stillcal.replay.formats.trace import read_all
from stillcal.replay.phone import load_phone, load_scenario
from tests.support.log_files import rows, text

COMMAND = "from stillcal.daemon.cli.entry import main; main()"
WAITS_S = 60.0
"""After which a command is taken to wait for ever, s."""

KMSG = Path("/proc/kmsg")
MAP = '[time]\ncolumn = "t"\n[accelerometer]\ncolumns = ["ax", "ay", "az"]\nunit = "m/s^2"\n'


def ran(*words: str | Path, **more: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", COMMAND, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=WAITS_S, check=False, **more)  # type: ignore[call-overload]


def refused(said: subprocess.CompletedProcess[str], why: str) -> bool:
    return said.returncode == 2 and why in said.stderr and said.stderr.count("\n") == 1


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "walk.csv"
    path.write_text(text("t,ax,ay,az", rows()[:, :4]))
    return path


@pytest.mark.skipif(not os.access(KMSG, os.R_OK), reason="the kernel's messages are for root alone")
@pytest.mark.parametrize("words", [("convert", KMSG), ("replay", KMSG), ("diagnose", KMSG)])
def test_a_file_of_proc_that_never_ends_is_refused(words: tuple[str | Path, ...], tmp_path: Path) -> None:
    out = ("--out", tmp_path / "out.csv") if words[0] == "convert" else ()
    assert refused(ran(*words, *out), "one of the system's own files")
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.skipif(not os.access(KMSG, os.R_OK), reason="the kernel's messages are for root alone")
def test_a_fleet_goes_on_after_a_file_that_never_ends(recording: Path, tmp_path: Path) -> None:
    (tmp_path / "fleet").mkdir()
    (tmp_path / "fleet" / "endless.csv").symlink_to(KMSG)
    said = ran("fleet", tmp_path / "fleet", "--out", tmp_path / "out", "--workers", "1")
    assert "1 error" in said.stdout and "one of the system's own files" in said.stdout, said


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="needs /proc")
def test_a_file_without_size_is_no_recording_and_an_empty_one_is_empty(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="one of the system's own files, which has no size"):
        read_all("/proc/cpuinfo")
    (tmp_path / "empty.csv").touch()
    with pytest.raises(TraceError, match="is empty"):
        read_all(tmp_path / "empty.csv")


@pytest.mark.parametrize("ending", [".json", ".events.jsonl"])
def test_a_pipe_beside_a_recording_is_refused(ending: str, recording: Path, tmp_path: Path) -> None:
    os.mkfifo(recording.with_name("walk" + ending))
    assert refused(ran("convert", recording, "--out", tmp_path / "out.csv"), "is no regular file")


@pytest.mark.parametrize("read", [load_phone, load_scenario, load_map, load_settings, kept])
def test_what_may_come_through_a_pipe_waits_for_its_writer_but_not_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read: Callable[[Path], object]
) -> None:
    monkeypatch.setattr(files, "FIRST_WRITER_S", 0.1)
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises((OSError, ValueError), match="nobody writes to this pipe; start its writer"):
        read(tmp_path / "pipe.toml")


def test_a_column_map_may_come_through_a_pipe_that_somebody_writes(recording: Path, tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.write(writing, MAP.encode())
    os.close(writing)
    out = tmp_path / "out.csv"
    said = ran("convert", recording, "--format", f"/dev/fd/{reading}", "--out", out, pass_fds=[reading])
    os.close(reading)
    assert said.returncode == 0, said.stderr


def test_a_covariate_is_looked_for_in_a_recording_from_a_pipe(recording: Path) -> None:
    reading, writing = os.pipe()
    os.write(writing, recording.read_bytes())
    os.close(writing)
    said = ran("diagnose", f"/dev/fd/{reading}", "--covariate", "speed", pass_fds=[reading])
    os.close(reading)
    assert said.returncode == 2 and "it has no column 'speed'; it has t, ax, ay, az" in said.stderr
