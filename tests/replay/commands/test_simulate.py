"""`stillcal simulate --serial`: the simulated phone as a process of its own, heard by a daemon as another."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from stillcal.daemon.cli.exits import INTERRUPTED
from stillcal.daemon.cli.main import cli
from tests.support.forked import Forked

STILLCAL = str(Path(sys.executable).with_name("stillcal"))


def calibration(store: Path) -> object:
    kept = json.loads(store.read_text())
    return [kept[sensor][part] for sensor in ("accelerometer", "gyroscope") for part in ("scale", "bias")]


def test_a_phone_on_a_line_is_calibrated_as_its_recording_is(folder: Path) -> None:
    """The daemon opens the printed path; what it keeps is, to the bit, what replay keeps of the recording."""
    port, live, truth = folder / "phone", folder / "live.json", folder / "truth.json"
    phone = subprocess.Popen(
        [STILLCAL, "simulate", "lab", "--serial", "--port", port, "--truth", truth],
        stdout=subprocess.PIPE,
        text=True,
    )
    daemon: subprocess.Popen[bytes] | None = None
    try:
        assert phone.stdout is not None and phone.stdout.readline().strip() == str(port)
        daemon = subprocess.Popen(
            [STILLCAL, "run", f"--port={port}", f"--store={live}", f"--socket={folder / 'socket'}"],
            stderr=subprocess.DEVNULL,
        )
        assert phone.wait(120) == 0
        daemon.terminate()
        assert daemon.wait(10) == 0
    finally:
        for process in (phone, daemon):
            if process is not None:
                process.kill()
                process.wait()
    assert not port.is_symlink() and json.loads(truth.read_text())["accelerometer"]["bias"]
    recording, store = folder / "lab.csv", folder / "store.json"
    for words in (["simulate", "lab", "--out", recording], ["replay", recording, "--store", store]):
        assert CliRunner().invoke(cli, [*map(str, words), "--quiet"]).exit_code == 0
    assert calibration(live) == calibration(store)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_takes_the_phone_and_its_link_away(folder: Path, number: signal.Signals) -> None:
    port = folder / "phone"
    with Forked(["simulate", "lab", "--serial", "--port", port, "--quiet"]) as phone:
        assert phone.stdout.readline().strip() == str(port)
        assert port.is_symlink()
        phone.send_signal(number)
        said = phone.said()[1]
    assert phone.returncode == INTERRUPTED and said.strip() == "stillcal: interrupted; nothing half-written"
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "either --out"),
        (["--serial", "--out", "a.csv"], "either --out"),
        (["--out", "a.csv", "--speed", "1"], "need --serial"),
        (["--out", "a.csv", "--port", "b"], "need --serial"),
        (["--serial", "--port", "taken"], "another path"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").write_text("mine")
    result = CliRunner().invoke(cli, ["simulate", "lab", *words])
    assert result.exit_code == 2 and said in result.output
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
