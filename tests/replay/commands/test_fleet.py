"""`stillcal fleet` from outside: resumed, interrupted, and undisturbed by bad recordings."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.forked import Forked

pytest.importorskip("distributed", reason="needs the extra fleet")

from stillcal.daemon.cli.exits import BAD_INPUT, INTERRUPTED
from stillcal.replay.fleet import discovery, results_folder
from stillcal.replay.fleet.simulate_fleet import fleet
from stillcal.replay.fleet.worker import Task, examine


def command(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-c", "from stillcal.daemon.cli.main import main; main()", *map(str, arguments)]


def called(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(
        command(*arguments), check=False, capture_output=True, text=True, timeout=120, env=env
    )


@pytest.fixture
def phones(tmp_path: Path) -> Path:
    """Three recordings of two phones, and one that is spoilt."""
    folder = tmp_path / "phones"
    first, _ = (path.parent for path in fleet(folder, 2, bad=1))
    shutil.copytree(first, folder / "Copied" / "phone-0")
    return folder


def interrupted(call: list[str], out: Path) -> str:
    """Run the command until it has kept something, then press Ctrl-C; return what it said."""
    with subprocess.Popen(call, stderr=subprocess.PIPE, text=True, start_new_session=True) as running:
        deadline = time.monotonic() + 60
        while not list(out.glob("parts/*.recordings.parquet")) and time.monotonic() < deadline:
            time.sleep(0.05)
        os.killpg(running.pid, signal.SIGINT)  # as a terminal does: to every process of the group
        _, said = running.communicate(timeout=60)
    assert running.returncode == INTERRUPTED
    return said


@pytest.mark.slow
def test_what_is_finished_is_kept_and_a_bad_recording_is_a_row(phones: Path, tmp_path: Path) -> None:
    out = tmp_path / "results"
    said = interrupted(command("fleet", phones, "--out", out, "--workers", "1"), out)
    assert "finished and stored; repeat the command to continue" in said
    assert "Traceback" not in said
    before, _ = results_folder.read(out)
    assert 0 < len(before) < 4
    assert {row["status"] for row in before} == {"calibrated"}

    again = called("fleet", phones, "--out", out, "--workers", 1)
    assert (again.returncode, again.stderr) == (0, "")
    assert f"4 recordings, {len(before)} of them already done" in again.stdout
    assert again.stdout.count("Spoilt/phone-0000/recording.csv:3: column 'ax' holds nan") == 1
    rows, _ = results_folder.read(out)
    assert [row["status"] for row in rows].count("calibrated") == 3
    by_name = {row["name"]: row for row in rows}
    assert all(by_name[row["name"]] == row for row in before)
    bad = next(row for row in rows if row["status"] == "error")
    assert "recording.csv:3: column 'ax' holds nan" in bad["reason"]
    verdicts = {row["verdict"] for row in rows if row is not bad}
    assert verdicts <= {"match", "identified", "partly_identified", "unidentified", "not_judged"}

    path = phones / bad["name"]
    path.write_text(path.read_text().replace("nan", "0.1"))
    os.utime(phones / rows[0]["name"])  # as a copy would: another time, the same content
    results = results_folder.Results(out, bad["made_by"])
    (changed,) = results.todo([Task(found) for found in discovery.find(str(phones)).recordings])
    assert changed.recording.name == bad["name"]
    results.keep(changed, examine(changed))
    assert next(r for r in results.finish()[0] if r["name"] == bad["name"])["reason"] != bad["reason"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nowhere",), "nowhere"),
        (("nothing/*.csv",), "nothing/*.csv"),
    ],
)
def test_nothing_to_do_is_one_line(arguments: tuple[str, ...], said: str, tmp_path: Path) -> None:
    with Forked(["fleet", *arguments, "--out", tmp_path / "results"]) as found:
        complaint = found.said()[1]
    assert found.returncode == BAD_INPUT
    assert said in complaint and complaint.count("\n") == 1
    assert not (tmp_path / "results").exists()


def test_a_new_phone_is_calibrated_and_its_recording_never_written_over(phones: Path, tmp_path: Path) -> None:
    """A wide prior about a true sensor: with two dozen rests nearly all is theirs."""
    spread = [0.4] * 3 + [0.015] * 3 + [0.005] * 3
    covariance = [[spread[i] ** 2 * (i == j) for j in range(9)] for i in range(9)]
    mean = [0.0] * 3 + [1.0] * 3 + [0.0] * 3
    prior = {"model": "", "devices": 40, "mean": mean, "covariance": covariance, "scatter": 0.01}
    report, found = tmp_path / "fleet.json", tmp_path / "first.json"
    report.write_text(json.dumps({"priors": [prior]}))
    recording = next(path for path in sorted(phones.rglob("recording.csv")) if "nan" not in path.read_text())
    before = recording.read_bytes()
    with Forked(["fleet-first", recording, "--prior", report, "--json", recording]) as refused:
        assert "is read by this command" in refused.said()[1]
    assert refused.returncode == BAD_INPUT and recording.read_bytes() == before
    with Forked(["fleet-first", recording, "--prior", report, "--json", found]) as calibrated:
        said, complaint = calibrated.said()
    assert calibrated.returncode == 0 and "from the rests" in said, complaint
    told = json.loads(found.read_text())
    sds = [told["accelerometer"]["covariance"][i][i] ** 0.5 for i in range(9)]
    assert all(sd <= wide for sd, wide in zip(sds, spread, strict=True))
    shown = told["prior"]["shown_by_rests"]
    assert max(shown) > 0.9 and all(0.0 <= share <= 1.0 for share in shown)
