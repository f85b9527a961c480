"""`stillcal fleet` from outside: resumed, interrupted, and undisturbed by bad recordings."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("distributed", reason="needs the extra fleet")

from stillcal.daemon.exits import BAD_INPUT, INTERRUPTED
from stillcal.replay.fleet import kept
from stillcal.replay.fleet.make import fleet


def command(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-c", "from stillcal.daemon.cli import main; main()", *map(str, arguments)]


def called(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(
        command(*arguments), check=False, capture_output=True, text=True, timeout=120, env=env
    )


@pytest.fixture(scope="module")
def phones(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("phones")
    fleet(folder, 3, bad=1)
    return folder


def test_a_bad_recording_is_a_row_and_what_is_finished_is_not_done_again(
    phones: Path, tmp_path: Path
) -> None:
    out = tmp_path / "results"
    first = called("fleet", phones, "--out", out, "--workers", 1)
    assert (first.returncode, first.stderr) == (0, "")
    rows, _ = kept.read(out)
    assert [row["status"] for row in rows].count("calibrated") == 3
    bad = next(row for row in rows if row["status"] == "error")
    assert "recording.csv:3: column 'ax' holds nan" in bad["reason"]
    assert {row["verdict"] for row in rows} <= {
        "adequate",
        "explained",
        "partly_explained",
        "unexplained",
        None,
    }

    path = phones / bad["name"]
    path.write_text(path.read_text().replace("nan", "0.1"))
    touched = phones / rows[0]["name"]
    os.utime(touched)  # as a copy would: another time, the same content
    second = called("fleet", phones, "--out", out, "--workers", 1)
    assert "4 recordings, 3 of them finished before" in second.stdout
    again, _ = kept.read(out)
    assert [row["calibrate_s"] for row in again if row["status"] == "calibrated"] == [
        row["calibrate_s"] for row in rows if row["status"] == "calibrated"
    ]
    assert next(row for row in again if row["name"] == bad["name"])["reason"] != bad["reason"]


def test_ctrl_c_leaves_a_folder_that_the_next_run_goes_on_from(phones: Path, tmp_path: Path) -> None:
    good = sorted(p.parent for p in phones.rglob("recording.csv") if "Spoilt" not in str(p))
    for i in range(24):
        shutil.copytree(good[i % 3], tmp_path / "many" / "model" / f"phone-{i:03d}")
    out = tmp_path / "results"
    call = command("fleet", tmp_path / "many", "--out", out, "--no-diagnosis", "--workers", "1")
    with subprocess.Popen(call, stderr=subprocess.PIPE, text=True, start_new_session=True) as running:
        deadline = time.monotonic() + 60
        while not list(out.glob("parts/*.recordings.parquet")) and time.monotonic() < deadline:
            time.sleep(0.05)
        os.killpg(running.pid, signal.SIGINT)  # as a terminal does: to every process of the group
        _, said = running.communicate(timeout=60)
    assert running.returncode == INTERRUPTED
    assert "finished and kept: the same command goes on" in said
    assert "Traceback" not in said
    rows, _ = kept.read(out)
    assert 0 < len(rows) < 24
    assert {row["status"] for row in rows} == {"calibrated"}
    again = called("fleet", tmp_path / "many", "--out", out, "--no-diagnosis")
    assert f"24 recordings, {len(rows)} of them finished before" in again.stdout
    assert len(kept.read(out)[0]) == 24


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nowhere",), "nowhere"),
        (("nothing/*.csv",), "nothing/*.csv"),
    ],
)
def test_nothing_to_do_is_one_line(arguments: tuple[str, ...], said: str, tmp_path: Path) -> None:
    found = called("fleet", *arguments, "--out", tmp_path / "results")
    assert found.returncode == BAD_INPUT
    assert said in found.stderr and found.stderr.count("\n") == 1
    assert not (tmp_path / "results").exists()
